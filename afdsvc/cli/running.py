"""Commands that talk to a running service."""

from __future__ import annotations

import getpass
import os
from pathlib import Path
from typing import Annotated, Any, NoReturn

import typer

from afdsvc.cli.options import HERE, Json, MachineOption, SiteOption, show
from afdsvc.errors import BadInput

app = typer.Typer()


def _ask(site: Path, name: str, **arguments: Any) -> Any:
    from afdsvc.app.ask import ask_service
    from afdsvc.files.site import read_site

    return ask_service(read_site(site), name, os.environ.get("AFDSVC_USER") or getpass.getuser(), **arguments)


@app.command()
def status(site: SiteOption = HERE, as_json: Json = False) -> None:
    """Show how the service and its machines are."""
    from afdsvc.present.terminal import status_table

    found = _ask(site, "status")
    show(as_json, found, lambda: status_table(found))


@app.command()
def alarms(
    history: Annotated[bool, typer.Option("--history", help="Show the history of changes instead of the present states.")] = False,
    alarm: Annotated[str, typer.Argument(help="Only this one.")] = "",
    site: SiteOption = HERE,
    as_json: Json = False,
) -> None:
    """Show the alarms, or what happened to them."""
    from afdsvc.present.terminal import alarm_table, history_table

    if alarm.endswith(".toml"):
        raise BadInput(f"'{alarm}' is no alarm; the site file is given as --site {alarm}")
    found = _ask(site, "history", alarm=alarm) if history else _ask(site, "alarms")
    if alarm and not history:
        found = [a for a in found if a["id"] == alarm] or _no_alarm(alarm, found)
    show(as_json, found, lambda: (history_table if history else alarm_table)(found))


def _no_alarm(alarm: str, found: list[dict[str, Any]]) -> NoReturn:
    raise BadInput(f"there is no alarm '{alarm}'; there are {', '.join(a['id'] for a in found) or 'none'}")


AlarmId = Annotated[str, typer.Argument(help="Id of the alarm as shown by `afdsvc alarms`.")]
Comment = Annotated[str, typer.Option(help="Why, for the history.")]


@app.command()
def ack(
    alarm: AlarmId,
    comment: Comment = "",
    since: Annotated[int | None, typer.Option(help="`since_ns` of the occurrence to acknowledge: a later one is refused.")] = None,
    site: SiteOption = HERE,
    as_json: Json = False,
) -> None:
    """Acknowledge an alarm: somebody has seen it."""
    found = _ask(site, "ack", alarm=alarm, comment=comment, seen_ns=since)
    show(as_json, found, lambda: print(f"{found['id']} acknowledged by {found['acknowledged_by']}"))


@app.command()
def confirm(alarm: AlarmId, comment: Comment = "", site: SiteOption = HERE, as_json: Json = False) -> None:
    """Confirm an acknowledged alarm: somebody has dealt with it."""
    found = _ask(site, "confirm", alarm=alarm, comment=comment)
    show(as_json, found, lambda: print(f"{found['id']} confirmed by {found['confirmed_by']}"))


@app.command()
def reset(alarm: AlarmId, comment: Comment = "", site: SiteOption = HERE, as_json: Json = False) -> None:
    """Release a latched alarm that has ended and is acknowledged."""
    found = _ask(site, "reset", alarm=alarm, comment=comment)
    show(as_json, found, lambda: print(f"{found['id']} reset"))


@app.command()
def shelve(
    alarm: AlarmId,
    minutes: Annotated[float, typer.Option(help="For how long.")],
    reason: Annotated[str, typer.Option(help="Why, for the history.")],
    site: SiteOption = HERE,
    as_json: Json = False,
) -> None:
    """Put an alarm aside for a time."""
    found = _ask(site, "shelve", alarm=alarm, minutes=minutes, comment=reason)
    show(as_json, found, lambda: print(f"{found['id']} shelved by {found['shelved_by']} for {minutes:g} minutes"))


@app.command()
def unshelve(alarm: AlarmId, site: SiteOption = HERE, as_json: Json = False) -> None:
    """Take an alarm from the shelf."""
    found = _ask(site, "unshelve", alarm=alarm)
    show(as_json, found, lambda: print(f"{found['id']} is back"))


@app.command()
def burst(
    purpose: Annotated[str, typer.Option(help="diagnose, identify, identify_binary or identify_sweep")] = "diagnose",
    machine: MachineOption = None,
    site: SiteOption = HERE,
    as_json: Json = False,
) -> None:
    """Play a burst now; refused with its reason when a limit or rule would be broken."""
    found = _ask(site, "burst", machine=machine, purpose=purpose)
    show(as_json, found, lambda: print(f"burst {found['burst']} accepted"))


Machine = Annotated[str | None, typer.Argument(metavar="MACHINE", help="Id of the machine; not needed where there is one only.")]


@app.command()
def retune(machine: Machine = None, site: SiteOption = HERE, as_json: Json = False) -> None:
    """Accept what an alarm proposes: Q is designed for the fault that was named, proved, and let act beside the running controller.

    Refused with one sentence where nothing can be gained, or where a limit, stability or sensitivity would suffer.
    """
    from afdsvc.present.terminal import retune_table

    found = _ask(site, "retune", machine=machine)
    show(as_json, found, lambda: retune_table(found))


@app.command()
def restore(
    machine: Machine = None,
    reason: Annotated[str, typer.Option(help="Why, for the recording.")] = "asked to",
    site: SiteOption = HERE,
    as_json: Json = False,
) -> None:
    """Go back to the controller as it was, over the time that was proved to be smooth."""
    found = _ask(site, "restore", machine=machine, reason=reason)
    show(as_json, found, lambda: print(f"machine {found['machine']} is restored"))


@app.command()
def stop(
    reason: Annotated[str, typer.Option(help="Why, for the recording.")] = "asked to",
    machine: MachineOption = None,
    site: SiteOption = HERE,
    as_json: Json = False,
) -> None:
    """End the burst that plays, over its ramp; `pause` keeps others from being played."""
    _ask(site, "stop", machine=machine, reason=reason)
    show(as_json, {"stopped": True}, lambda: print("the burst ends"))


@app.command()
def pause(
    reason: Annotated[str, typer.Option(help="Why, for the log.")] = "",
    machine: MachineOption = None,
    site: SiteOption = HERE,
    as_json: Json = False,
) -> None:
    """Play no bursts on a machine until `resume`."""
    found = _ask(site, "pause", machine=machine, reason=reason)
    show(as_json, found, lambda: print(f"bursts on {found['machine']} are paused {found['paused']}"))


@app.command()
def audit(
    site: SiteOption = HERE,
    file: Annotated[Path | None, typer.Option(help="A copy of the log instead of the site's own.")] = None,
    expect: Annotated[str, typer.Option(metavar="HASH", help="The hash of a line noted earlier, which must still be there.")] = "",
    last: Annotated[int, typer.Option(help="Show so many of the newest lines.")] = 20,
    as_json: Json = False,
) -> None:
    """Check the audit log, who asked the service for what, and show its end: a line that was changed or removed is named."""
    from afdsvc.app.serve import audit_file
    from afdsvc.files.site import read_site
    from afdsvc.present.terminal import audit_table
    from afdsvc.service.audit_log import verify_chain

    path = file or audit_file(read_site(site))
    found = verify_chain(path, expect)
    value = {"file": str(path), "lines": found.number, "hash": found.hash, "entries": list(found.entries[-last:] if last > 0 else ())}
    show(as_json, value, lambda: audit_table(value))


@app.command()
def resume(machine: MachineOption = None, site: SiteOption = HERE, as_json: Json = False) -> None:
    """Play bursts again."""
    found = _ask(site, "resume", machine=machine)
    show(as_json, found, lambda: print(f"bursts on {found['machine']} are resumed"))
