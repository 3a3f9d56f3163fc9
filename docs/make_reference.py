"""Write the reference pages that come from the code: ``python docs/make_reference.py`` (a test says when they are out of date)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import typer.main

from afdsvc.cli import app
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


PAGES = {"commands.md": commands_page, "plugins.md": plugins_page}

if __name__ == "__main__":
    for name, page in PAGES.items():
        (HERE / name).write_text(page(), encoding="utf-8")
