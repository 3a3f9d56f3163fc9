"""From an MCAP recording to a Rerun file with its layout, and the viewer opened on it."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from afdsvc.errors import BadInput
from afdsvc.files.open import TABLES
from afdsvc.files.recording import mcap_file
from afdsvc.files.recording.foxglove import Level, decode_log
from afdsvc.files.recording.reader import RecordedMessage, Recording
from afdsvc.present.rerun.log import LOOPBACK, QUIET_HERTZ, ReviewLog
from afdsvc.present.rerun.plane import Plane
from afdsvc.present.rerun.signals import by_group
from afdsvc.wire import codec
from afdsvc.wire.messages import Finding, RigEvent

Planes = Callable[[Recording, str], Sequence[Plane]]


def review_recording(
    path: str | Path, save: str | Path | None = None, every_sample: bool = False, planes: Planes | None = None
) -> Path:
    """Write a Rerun file of a recording and return its path; without ``save`` it goes to a temporary folder.

    Quiet stretches are thinned to their extremes unless ``every_sample`` is True; bursts never are. ``planes(recording,
    machine)`` returns the complex planes of its bursts. Raises `BadInput` for a recording without samples, or a file that
    cannot be written.
    """
    return review_recordings([path], save, every_sample, planes)


def review_recordings(
    recordings: Sequence[str | Path], save: str | Path | None = None, every_sample: bool = False, planes: Planes | None = None
) -> Path:
    """Write one Rerun file of several recordings, side by side, each from its own beginning; see `review_recording`."""
    table = next((path for path in recordings if Path(path).suffix.lower() in TABLES), None)
    if table is not None:
        raise BadInput(f"{table}: is a table; expected a recording, which 'afdsvc import {table} -o {Path(table).stem}.mcap' makes of it")
    opened = [Recording(path) for path in recordings]
    for recording in opened:
        if not recording.machines:
            raise BadInput(f"{recording.path}: holds no samples of any machine; {', '.join(recording.counts) or 'nothing'} is in it")
    name = opened[0].path.stem + (f"-and-{len(opened) - 1}" if len(opened) > 1 else "")
    target = Path(save) if save else Path(tempfile.mkdtemp(prefix="afdsvc-review-")) / f"{name}.rrd"
    reported = all(any(mcap_file.parts(name)[1] == mcap_file.LOG for name in recording.counts) for recording in opened)
    log = ReviewLog(target, batch_seconds=5.0, quiet_hertz=0.0 if every_sample else QUIET_HERTZ, tell=not reported)
    for recording, label in zip(opened, _labels(opened), strict=True):
        if len(opened) > 1:
            log.begin(label)
        _one(log, recording, planes)
    log.close()
    return target


def _labels(opened: Sequence[Recording]) -> list[str]:
    """Return names that differ, short where they can be."""
    stems = [recording.path.stem for recording in opened]
    return [stem if stems.count(stem) == 1 else f"{i}. {stem}" for i, stem in enumerate(stems, 1)]


def _one(log: ReviewLog, recording: Recording, planes: Planes | None) -> None:
    for machine in recording.machines:
        log.span(machine, _extremes(recording, machine))
    for entry in recording.messages():
        _show(log, entry)
    for machine in recording.machines if planes else ():
        log.planes(machine, planes(recording, machine) if planes else ())


def open_viewer(file: Path) -> int:
    """Open the viewer on a file and wait until it is closed; return its exit code. It listens on loopback only.

    Raises `BadInput` where there is no display.
    """
    if sys.platform == "linux" and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise BadInput(f"there is no display for the viewer; expected --save FILE.rrd, to be opened elsewhere (this review is in {file})")
    rerun = [sys.executable, "-m", "rerun"]
    # It would report its use to its makers otherwise.
    subprocess.run([*rerun, "analytics", "disable"], check=False, capture_output=True)
    return subprocess.run([*rerun, "--bind", LOOPBACK, "--port", "auto", str(file)], check=False).returncode


def _extremes(recording: Recording, machine: str) -> dict[str, tuple[float, float]]:
    """Return the least and greatest value of every view."""
    found: dict[str, tuple[float, float]] = {}
    for block in recording.blocks(machine):
        for name, roles in by_group(block.channels).items():
            values = np.concatenate([block.role(role).reshape(-1) for role in roles])
            low, high = float(np.fmin.reduce(values)), float(np.fmax.reduce(values))
            before = found.get(name, (np.inf, -np.inf))
            found[name] = (np.fmin(before[0], low), np.fmax(before[1], high))
    for block in recording.residuals(machine):
        low, high = float(np.fmin.reduce(block.values, axis=None)), float(np.fmax.reduce(block.values, axis=None))
        before = found.get("whitened", (np.inf, -np.inf))
        found["whitened"] = (np.fmin(before[0], low), np.fmax(before[1], high))
    return found


def _show(log: ReviewLog, entry: RecordedMessage) -> None:
    """Pass a message on; one that cannot be decoded is noted in the event log of its machine."""
    machine, what = mcap_file.parts(entry.topic)
    try:
        match what:
            case mcap_file.BLOCK:
                log.block(codec.decode_block(entry.data))
            case mcap_file.RESIDUAL:
                log.residual(codec.decode_block(entry.data))
            case mcap_file.EVENT:
                log.event(codec.decode(RigEvent, entry.data))
            case mcap_file.FINDING:
                log.finding(codec.decode(Finding, entry.data))
            case mcap_file.LOG:
                log.note(*decode_log(entry.data))
    except BadInput as error:
        log.note(entry.t_ns, Level.WARNING, f"a message cannot be read: {error}", machine)
