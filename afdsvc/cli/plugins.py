"""Commands about plugins."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from afdsvc.cli.options import Json, show
from afdsvc.errors import BadInput

app = typer.Typer(no_args_is_help=True, help="What is installed.")


@app.command("list")
def plugins_list(as_json: Json = False) -> None:
    """Show what is installed, by family, and what could not be loaded and why."""
    from afdsvc.plugins.manager import load
    from afdsvc.present.terminal import plugin_table

    found = load()
    rows = [{"family": o.family, "name": o.name, "summary": o.summary, "plugin": o.plugin} for o in found.offers]
    show(as_json, {"plugins": rows, "broken": found.broken}, lambda: plugin_table(rows, found.broken))


@app.command("new")
def plugins_new(
    kind: Annotated[str, typer.Argument(help="controller, detector, driver, fault, notifier or physics")],
    name: Annotated[str, typer.Argument(help="Lower-case letters, digits and _.")],
    out: Annotated[Path, typer.Option(help="Where the package goes.")] = Path("."),
    as_json: Json = False,
) -> None:
    """Write a new plugin as a package that installs, conforms and works."""
    from afdsvc.testing.plugin_package import write_plugin

    files = [str(path) for path in write_plugin(kind, name, out)]
    said = [*files, f"next: pip install -e '{out / name}[test]' && afdsvc plugins check {name}"]
    show(as_json, {"files": files}, lambda: print("\n".join(said)))


@app.command("check")
def plugins_check(
    package: Annotated[str, typer.Argument(help="Name of an installed plugin, of a module, or a folder with one.")],
    as_json: Json = False,
) -> None:
    """Run the conformance suite on everything a plugin offers; exit 2 when something does not hold."""
    from afdsvc.present.terminal import check_table
    from afdsvc.testing.plugin_package import examine_package

    rows = examine_package(package)
    show(as_json, {"checks": rows}, lambda: check_table(rows))
    failed = [r for r in rows if r["failure"]]
    if failed:
        raise BadInput(f"{len(failed)} of {len(rows)} checks of '{package}' failed; the first: {failed[0]['failure']}")
