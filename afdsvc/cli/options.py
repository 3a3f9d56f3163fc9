"""The arguments that many commands share, and the one way results are shown."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer

Json = Annotated[bool, typer.Option("--json", help="Exactly one JSON document on stdout.")]
SiteFile = Annotated[Path, typer.Argument(metavar="SITE.toml", help="The site file.")]
SiteOption = Annotated[Path, typer.Option("--site", metavar="SITE.toml", help="The site file the service runs with.")]
MachineOption = Annotated[str | None, typer.Option("--machine", help="Id of the machine; needed when there are several.")]
MappingOption = Annotated[
    Path | None, typer.Option("--mapping", metavar="FILE.toml", help="Mapping file for foreign tables and topics.")
]
HERE = Path("site.toml")


def show(as_json: bool, value: Any, text: Callable[[], None]) -> None:
    if as_json:
        print(json.dumps(value, indent=2, allow_nan=False, default=str))
    else:
        text()
