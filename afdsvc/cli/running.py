"""Commands that run a site or talk to its running service."""

from __future__ import annotations

import logging
import math
import os
import signal
import sys
import threading
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NoReturn

import typer

from afdsvc import __version__
from afdsvc.cli.interrupt import call_on_signals
from afdsvc.cli.options import (
    HERE,
    Json,
    MachineOption,
    SiteFile,
    SiteOption,
    alarm_ids,
    among,
    fault_names,
    machine_ids,
    show,
    user,
)
from afdsvc.errors import BadInput
from afdsvc.files.unfinished import remove_unfinished

if TYPE_CHECKING:
    from afdsvc.service.notifications import History

app = typer.Typer()
site = typer.Typer(no_args_is_help=True, help="Site files.")


def _stop_on_signals(stop: threading.Event, emergency: threading.Event | None = None) -> threading.Event:
    """Let SIGTERM and SIGINT set an event, so that every `with` block is left in order; SIGUSR1 another one, where the system has it."""
    called: dict[int, Callable[[], object]] = {signal.SIGTERM: stop.set, signal.SIGINT: stop.set}
    if emergency and hasattr(signal, "SIGUSR1"):
        called[signal.SIGUSR1] = emergency.set
    call_on_signals(called)
    return stop


def _end(*_: object) -> NoReturn:
    """End the preparation at once: nothing has been started yet."""
    remove_unfinished()
    os._exit(0)


@app.command()
def serve(
    site: SiteFile,
    seconds: Annotated[float | None, typer.Option(help="Stop after so long.")] = None,
    logs: Annotated[str, typer.Option("--log", metavar="text|json", autocompletion=among("text", "json"), help="How log lines are written on stderr.")] = "text",
    standby: Annotated[bool, typer.Option("--standby", help="Be the second service of the site: listen at transport.standby once the first is gone.")] = False,
) -> None:
    """Run the service of one site until SIGTERM or Ctrl-C."""
    from afdsvc.app.serve import as_one_of_two, serving
    from afdsvc.app.supervision import collect_rarely, notify, return_memory, start_logging, supervised
    from afdsvc.files.site import read_site

    start_logging(_one_of("--log", logs, ("text", "json")))
    stop, log = threading.Event(), logging.getLogger("afdsvc")
    signal.signal(signal.SIGTERM, _end)
    found, two = as_one_of_two(read_site(site), standby)

    def turn(history: History) -> None:
        if two is not None:
            _stop_on_signals(stop)
            notify("READY=1")
            two(history).wait(stop, lambda: notify("WATCHDOG=1"))
        if stop.is_set():
            raise typer.Exit

    with serving(found, turn=turn) as hub, supervised(hub.healthy):
        _stop_on_signals(stop)  # Ctrl-C ends the preparation before at once, what follows in order
        collect_rarely()
        return_memory()
        log.info("%s: serving '%s' with %d machine(s)", __version__, hub.keys.site, len(hub.watches))
        if found.transport.security is None:
            log.warning(
                "%s: key 'transport.security' is missing: whoever reaches %s may read all signals and excite the machines",
                found.origin, ", ".join(found.transport.listen),
            )
        if two is None or hub.history is None:
            until = time.monotonic() + (math.inf if seconds is None else seconds)
            while not stop.wait(0.5) and time.monotonic() < until:
                pass  # a signal that another thread receives is handled when this one wakes
        else:
            two(hub.history).hold(stop, seconds, lambda: not any(watch.present for watch in hub.watches.values()))
    _leave()


def _one_of(option: str, value: str, allowed: tuple[str, ...]) -> str:
    if value not in allowed:
        raise BadInput(f"{option} {value}: expected {' or '.join(allowed)}")
    return value


@app.command()
def rig(
    site: SiteFile,
    machine: Annotated[str, typer.Option("--machine", autocompletion=machine_ids, help="Id of the machine in the site file.")],
    seconds: Annotated[float | None, typer.Option(help="Stop after so long.")] = None,
) -> None:
    """Run the rig agent of one machine: its control loop, its blocks, its bursts within its limits.

    SIGTERM and Ctrl-C end a burst smoothly and stop; SIGUSR1 is the emergency stop: no excitation until it is started again.
    """
    from afdsvc.app.rig import run_rig
    from afdsvc.app.supervision import start_logging
    from afdsvc.files.site import read_site

    start_logging("text")
    emergency = threading.Event()
    run_rig(read_site(site), machine, seconds, _stop_on_signals(threading.Event(), emergency), emergency)
    _leave()


def _leave() -> None:
    """End without waiting for threads that wait for a dead network: the interpreter would abort over them."""
    if any(thread.daemon for thread in threading.enumerate()):
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(0)


@app.command()
def certificates(
    site: SiteFile,
    renew: Annotated[bool, typer.Option("--renew", help="Replace certificates that end within 30 days.")] = False,
    revoke: Annotated[list[str] | None, typer.Option(metavar="NAME", help="Void the certificate of a person or rig and make a new one; may be repeated.")] = None,
    as_json: Json = False,
) -> None:
    """Make the private authority and certificates of a secured site: service, rigs, operators, viewers; what is there is kept.

    Certificates last a year. A running service takes up renewed and revoked ones by itself.
    """
    from afdsvc.files.site import read_site
    from afdsvc.transport.certificates import make_certificates

    made = [str(path) for path in make_certificates(read_site(site), renew=renew, revoke=revoke or [])]
    show(as_json, {"made": made}, lambda: print("\n".join(made) or "everything is there already"))



@site.callback()
def _site() -> None:
    """Site files."""


@site.command("check")
def site_check(
    file: SiteFile,
    allow_code: Annotated[bool, typer.Option("--allow-code", help="Permit simulators that the file names to run.")] = False,
    as_json: Json = False,
) -> None:
    """Say what a site file makes of every machine, without starting anything; exit 2 where one, or the service, could not start."""
    from afdsvc.app.site_check import check_site
    from afdsvc.present.terminal import site_table

    document = check_site(file, allow_code)
    show(as_json, document, lambda: site_table(document))
    if document["problem"] or any(m["problem"] for m in document["machines"]):
        raise typer.Exit(2)


@app.command("allow-code")
def allow_code(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="A Python file or FMI unit that models or site files name.")],
    forget: Annotated[bool, typer.Option("--forget", help="Let it run no more.")] = False,
) -> None:
    """Remember for your account that a file of user code may run as it is now; once it is changed, it may not. What it imports is not checked."""
    from afdsvc.files import allowed_code

    if forget:
        allowed_code.forget(file)
        print(f"{file} may not run any more")
    else:
        print(f"{file} may run while its SHA-256 is {allowed_code.allow(file)}")


def _ask(site: Path, name: str, **arguments: Any) -> Any:
    from afdsvc.app.ask import ask_service
    from afdsvc.files.site import read_site

    return ask_service(read_site(site), name, user(), **arguments)


@app.command()
def status(site: SiteOption = HERE, as_json: Json = False) -> None:
    """Show how the service and its machines are."""
    from afdsvc.present.terminal import status_table

    found = _ask(site, "status")
    show(as_json, found, lambda: status_table(found))


@app.command()
def console(site: SiteOption = HERE, as_json: Json = False) -> None:
    """Print a link that signs you in to the console of the running service, once: acknowledge alarms, play bursts, from a browser."""
    found = _ask(site, "console")
    show(as_json, found, lambda: print(found["url"]))


@app.command()
def alarms(
    history: Annotated[bool, typer.Option("--history", help="Show the history of changes instead of the present states.")] = False,
    alarm: Annotated[str, typer.Argument(autocompletion=alarm_ids, help="Only this one.")] = "",
    site: SiteOption = HERE,
    as_json: Json = False,
) -> None:
    """Show the alarms, or what happened to them."""
    from afdsvc.present.terminal import alarm_table, history_table

    if alarm.endswith(".toml"):
        raise BadInput(f"'{alarm}' is not an alarm; the site file is given as --site {alarm}")
    found = _ask(site, "history", alarm=alarm) if history else _ask(site, "alarms")
    if alarm and not history:
        found = [a for a in found if a["id"] == alarm] or _no_alarm(alarm, found)
    show(as_json, found, lambda: (history_table if history else alarm_table)(found))


def _no_alarm(alarm: str, found: list[dict[str, Any]]) -> NoReturn:
    raise BadInput(f"there is no alarm '{alarm}'; there are {', '.join(a['id'] for a in found) or 'none'}")


AlarmId = Annotated[str, typer.Argument(autocompletion=alarm_ids, help="Id of the alarm as shown by `afdsvc alarms`.")]
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
    purpose: Annotated[str, typer.Option(autocompletion=among("diagnose", "identify", "identify_binary", "identify_sweep"), help="diagnose, identify, identify_binary or identify_sweep")] = "diagnose",
    machine: MachineOption = None,
    site: SiteOption = HERE,
    as_json: Json = False,
) -> None:
    """Play a burst now; refused with its reason when a limit or rule would be broken."""
    found = _ask(site, "burst", machine=machine, purpose=purpose)
    show(as_json, found, lambda: print(f"burst {found['burst']} accepted"))


Machine = Annotated[str | None, typer.Argument(metavar="MACHINE", autocompletion=machine_ids, help="Id of the machine; not needed where there is one only.")]


@app.command()
def inject(
    machine: Annotated[str, typer.Argument(metavar="MACHINE", autocompletion=machine_ids, help="Id of a simulated machine that runs.")],
    fault: Annotated[str, typer.Argument(metavar="FAULT=SEVERITY", autocompletion=fault_names, help="For example horizontal_actuator=-0.3; 0 repairs it.")],
    site: SiteOption = HERE,
    as_json: Json = False,
) -> None:
    """Put a fault into a simulated machine while it runs, to see what the service makes of it; a real machine refuses."""
    name, equals, severity = fault.partition("=")
    if not equals:
        raise BadInput(f"'{fault}': expected FAULT=SEVERITY, for example horizontal_actuator=-0.3")
    found = _ask(site, "inject", machine=machine, fault=name, severity=severity)
    show(as_json, found, lambda: print(f"{found['machine']}: {found['fault']} is {100 * found['severity']:g} % from now on"))


@app.command()
def retune(
    machine: Machine = None,
    fault: Annotated[str | None, typer.Option(metavar="NAME=LOW..HIGH", autocompletion=fault_names, help="The fault and its severities as you know them, in place of what was diagnosed: horizontal_actuator=-0.55..-0.45.")] = None,
    site: SiteOption = HERE,
    as_json: Json = False,
) -> None:
    """Accept what an alarm proposes: Q is designed for the fault that was named, proved, and let act beside the running controller.

    Refused with one sentence where nothing can be gained, or where a limit, stability or sensitivity would suffer.
    """
    from afdsvc.present.progress import progress
    from afdsvc.present.terminal import retune_table

    said = "afdsvc: Q is being designed and proved; Ctrl-C does not stop that, 'afdsvc restore' does"
    with progress("designing Q"):
        found = _ask(site, "retune", waiting=partial(typer.echo, said, err=True), machine=machine, **({"fault": fault} if fault else {}))
    show(as_json, found, lambda: retune_table(found))


@app.command()
def restore(
    machine: Machine = None,
    reason: Annotated[str, typer.Option(help="Why, for the recording.")] = "asked to",
    site: SiteOption = HERE,
    as_json: Json = False,
) -> None:
    """Go back to the controller as it was, over the time that was proved to be smooth; a Q that is still being designed is withdrawn."""
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
