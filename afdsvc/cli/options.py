"""The arguments that many commands share, and the one way results are shown."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer

Json = Annotated[bool, typer.Option("--json", help="Exactly one JSON document on stdout.")]
SiteFile = Annotated[Path, typer.Argument(metavar="SITE.toml", help="The site file.")]
SiteOption = Annotated[Path, typer.Option("--site", metavar="SITE.toml", help="The site file the service runs with.")]
HERE = Path("site.toml")


def machine_ids(ctx: typer.Context, incomplete: str) -> list[str]:
    """Return the ids of machines in the site file that begin like this, for the completion of shells."""
    try:
        machines = tomllib.loads(Path(ctx.params.get("site") or HERE).read_text(encoding="utf-8"))["machines"]
        return [m["id"] for m in machines if m["id"].startswith(incomplete)]
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return []


MachineOption = Annotated[
    str | None, typer.Option("--machine", autocompletion=machine_ids, help="Id of the machine; needed when there are several.")
]
MappingOption = Annotated[
    Path | None, typer.Option("--mapping", metavar="FILE.toml", help="Mapping file for foreign tables and topics.")
]


def show(as_json: bool, value: Any, text: Callable[[], None]) -> None:
    if as_json:
        print(json.dumps(value, indent=2, allow_nan=False, default=str))
    else:
        text()
