"""Write the reference pages that come from the code: ``python docs/make_reference.py`` (a test says when they are out of date)."""

from __future__ import annotations

import inspect
import re
from pathlib import Path
from typing import Any

import typer.main

import afdsvc
from afdsvc.cli import app
from afdsvc.files.model import schema
from afdsvc.plugins.manager import FAMILIES, load

HERE = Path(__file__).parent / "reference"
GENERATED = "<!-- Written by docs/make_reference.py; edit the code instead. -->\n\n"


def commands_page() -> str:
    """Return the page of every command, its arguments and options."""
    group: Any = typer.main.get_command(app)
    parts = [GENERATED + "# Commands\n"]
    for name, command in sorted(_flat("afdsvc", group)):
        parts.append(f"\n## {name}\n\n{(command.help or '').strip()}\n\n")
        rows = [_row(p) for p in command.params if p.name != "help"]
        parts.append("| | | default |\n|---|---|---|\n" + "".join(rows) if rows else "")
    return "".join(parts)


def _flat(prefix: str, group: Any) -> list[tuple[str, Any]]:
    found = []
    for name, command in group.commands.items():
        inner = f"{prefix} {name}"
        found += _flat(inner, command) if hasattr(command, "commands") else [(inner, command)]
    return found


def _row(p: Any) -> str:
    argument = not p.opts[0].startswith("-")
    name = (p.metavar or p.name.upper()) if argument else " ".join([", ".join(p.opts), p.metavar or ""]).strip()
    default = "required" if p.required else "" if p.default in (None, False, [], (), "") or callable(p.default) else f"`{p.default}`"
    return f"| `{_cell(name)}` | {_cell(getattr(p, 'help', '') or '')} | {_cell(default)} |\n"


def _cell(text: str) -> str:
    return text.replace("|", "\\|")


def plugins_page() -> str:
    """Return the page of every plugin that is shipped."""
    parts = [GENERATED + "# Plugins that are shipped\n"]
    for family in FAMILIES:
        offers = [o for o in load().family(family) if type(o.thing).__module__.startswith("afdsvc.")]
        parts.append(f"\n## {family}\n\n" + ("| name | what it is |\n|---|---|\n" if offers else "None; a laboratory brings its own.\n"))
        parts += [f"| `{o.name}` | {o.summary} |\n" for o in offers]
    return "".join(parts)


MODEL_KEYS = {
    "name": "of the machine, input, output or state",
    "time": '`"continuous"` or `"discrete"`',
    "sample_time": "seconds, of a discrete model",
    "A": "rows: `[[0, 1], [-4, -2]]`; a column is `[[0], [1]]`", "B": "states by inputs; left out where there are none", "C": "outputs by states", "D": "outputs by inputs; zero where left out",
    "num": "numerator, highest power first; for several inputs or outputs a list for each output of a list for each input",
    "den": "denominator, likewise; one list serves all",
    "zeros": "of one input and output; a complex root is `[re, im]`", "poles": "likewise, conjugates both", "gain": "of zeros and poles",
    "inputs": '`[{name = "force", unit = "N"}]`', "outputs": '`[{name = "position", unit = "mm"}]`',
    "states": "names and units; `rate_of` names the state that this one is the rate of. Left out: a state that is an output, or the rate of one, is known as that",
    "dynamics": "instead of matrices: `file.py:object`, a Python simulator, or an FMI unit `file.fmu`; it runs only with `--allow-code`",
    "parameters": 'physical numbers: `mass = "95.1 kg +- 2 %"`, `mass = 95.1`, or `{value, unit, relative_sd}`',
    "uncertainty": "how well entries of the matrices are known", "noise": "of outputs and states",
    "controller": "the one that ran, in positive feedback `u = K (y - ref)`; the same keys for its matrices, num and den, or roots",
    "perturbation": "how the linear part of a simulator that only steps is looked for",
    "value": "", "unit": "text, as pint knows it: `mm`, `N`, `rad/s`", "relative_sd": "standard deviation as a share of the value",
    "relative": "standard deviation of every entry that is not 0 or +-1, as a share of it", "output_sd": "one per output, in its unit",
    "process_cov": "covariance of the noise on the states", "rate_of": "the state that this one is the rate of",
    "amplitude": "pushes, one per input, in its unit", "samples": "of each push", "order": "of the linear part",
}  # fmt: skip
MODEL_TABLES = (
    ("The file", "ModelTable"), ("`inputs`, `outputs`", "VariableTable"), ("`states`", "StateTable"), ("`[parameters]`", "ParameterTable"),
    ("`[uncertainty]`", "UncertaintyTable"), ("`[noise]`", "NoiseTable"), ("`[controller]`", "ControllerTable"), ("`[perturbation]`", "PerturbationTable"),
)  # fmt: skip
MODEL_INTRODUCTION = """# MODEL.toml

What the simulation believes of a machine. Three ways to state the same motor, whose speed is measured:

```toml
name = "motor"
time = "continuous"
inputs = [{name = "voltage", unit = "V"}]
outputs = [{name = "speed", unit = "rad/s"}]
num = [12.0]            # 12 / (0.08 s + 1)
den = [0.08, 1]
```

with `poles = [-12.5]` and `gain = 150` instead of `num` and `den`, or with `A = [[-12.5]]`, `B = [[150]]`, `C = [[1]]`. Results name
numbers of the first two as coefficients (`den of speed`) and show a model that a fit moved as a ratio of polynomials; those of the third as entries
(`A[speed, speed]`). No position is needed beside a speed: its unit (`m/s`, `rad/s`, `rpm`) says that forces act on it. Units say
more: forces that the model leaves out reach an output in `m/s^2` at once, and an angle (`deg`, `rad`, `turn`) may be read within one turn. `afdsvc init TABLE` writes a first file from a recording, `afdsvc check` compares
one with recordings. An input acts from its row of a recording to the next; `explain` also tries straight
lines between rows. The states that a recording begins with are fitted, of recordings held out too. An unknown key, a missing one or a wrong shape is one sentence with file, key, what was found and what was expected.
"""


def model_page() -> str:
    """Return the page of every key of MODEL.toml."""
    parts = [GENERATED + MODEL_INTRODUCTION]
    for title, name in MODEL_TABLES:
        schema_class = getattr(schema, name)
        parts.append(f"\n## {title}\n\n{' '.join((schema_class.__doc__ or '').split())}\n\n| key | meaning | default |\n|---|---|---|\n")
        parts += [_key_row(key, field) for key, field in schema_class.model_fields.items()]
    return "".join(parts)


def _key_row(key: str, field: Any) -> str:
    default = "required" if field.is_required() else "" if field.default in (None, "") or field.default_factory else f"`{field.default}`"
    return f"| `{key}` | {_cell(MODEL_KEYS[key])} | {default} |\n"


def api_page() -> str:
    """Return the page of every name of the Python interface, from its docstring."""
    parts = [GENERATED + "# Python, every name\n\n[Python](python.md) leads through these functions; the examples here run in the tests.\n"]
    for name in afdsvc.__all__:
        thing = getattr(afdsvc, name)
        parts.append(_entry(f"afdsvc.{name}", thing))
        methods = [m for m, f in vars(thing).items() if isinstance(f, classmethod)] if inspect.isclass(thing) else []
        parts += [_entry(f"afdsvc.{name}.{m}", getattr(thing, m)) for m in methods]
    return "".join(parts)


def _entry(name: str, thing: Any) -> str:
    title = f"\n## {name}\n\n"
    if not inspect.isclass(thing):  # without types, which the list of parameters states
        signature = inspect.signature(thing)
        bare = [p.replace(annotation=p.empty) for p in signature.parameters.values()]
        title += f"`{name}{signature.replace(parameters=bare, return_annotation=signature.empty)}`\n\n"
    opening, *sections = re.split(r"^(\w+)\n-+\n", inspect.getdoc(thing) or "", flags=re.MULTILINE)
    return title + opening.strip() + "\n" + "".join(_section(*pair) for pair in zip(sections[::2], sections[1::2], strict=True))


def _section(title: str, text: str) -> str:
    if title == "Examples":
        blocks = re.split(r"\n\n(?=\S)", text.strip())
        return "\n**Examples**\n" + "".join(f"\n```pycon\n{b}\n```\n" if b.startswith(">>>") else f"\n{b}\n" for b in blocks)
    items = re.findall(r"^(\S.*)\n?((?:    .*\n?)*)", text.strip(), re.MULTILINE)
    return f"\n**{title}**\n\n" + "".join(_item(head, " ".join(body.split())) for head, body in items)


def _item(head: str, body: str) -> str:
    name, _, kind = head.partition(" : ")
    return f"- `{name}`" + (f" ({kind})" if kind else "") + (f": {body}" if body else "") + "\n"


PAGES = {"api.md": api_page, "commands.md": commands_page, "plugins.md": plugins_page, "model-file.md": model_page}

if __name__ == "__main__":
    for name, page in PAGES.items():
        (HERE / name).write_text(page(), encoding="utf-8")
