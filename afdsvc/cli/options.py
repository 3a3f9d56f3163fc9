"""The arguments that many commands share, and the one way results are shown."""

from __future__ import annotations

import getpass
import json
import os
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer

from afdsvc.errors import AfdsvcError

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


def among(*words: str) -> Callable[[str], list[str]]:
    """Return what completes one of some words, for shells.

    >>> among("hansen", "pbsid", "pem")("p")
    ['pbsid', 'pem']
    """
    return lambda incomplete: [word for word in words if word.startswith(incomplete)]


def alarm_ids(ctx: typer.Context, incomplete: str) -> list[str]:
    """Return the ids of the running service's alarms that begin like this, for the completion of shells."""
    from afdsvc.app.ask import ask_service
    from afdsvc.files.site import read_site

    try:
        found = ask_service(read_site(ctx.params.get("site") or HERE), "alarms", user())
        return [a["id"] for a in found if a["id"].startswith(incomplete)]
    except AfdsvcError:
        return []


def fault_names(ctx: typer.Context, incomplete: str) -> list[str]:
    """Return the faults of the command's machine that begin like this, each with "=" for its severity, for the completion of shells."""
    from afdsvc.app.commissioning import commission
    from afdsvc.files.site import read_site
    from afdsvc.plugins.manager import load

    try:
        site = read_site(ctx.params.get("site") or HERE)
        chosen = [m for m in site.machines if m.id == (ctx.params.get("machine") or m.id)]
        names = commission(chosen[0], load()).augmented.fault_names if len(chosen) == 1 else ()
        return [f"{name}=" for name in names if name.startswith(incomplete)]
    except AfdsvcError:
        return []


MachineOption = Annotated[
    str | None, typer.Option("--machine", autocompletion=machine_ids, help="Id of the machine; needed when there are several.")
]
MappingOption = Annotated[
    Path | None, typer.Option("--mapping", metavar="FILE.toml", help="Mapping file for foreign tables and topics.")
]


def user() -> str:
    """Return who asks the service: `AFDSVC_USER`, else the account's name."""
    return os.environ.get("AFDSVC_USER") or getpass.getuser()


def show(as_json: bool, value: Any, text: Callable[[], None]) -> None:
    if as_json:
        print(json.dumps(value, indent=2, allow_nan=False, default=str))
    else:
        text()
