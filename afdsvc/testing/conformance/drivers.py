"""Drivers: opened with their ``example`` settings on a gas bearing; blocks must be whole, and every exit leaves the plant at rest."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from afdsvc.api.bursts import Burst, Limits, Line
from afdsvc.api.port import DrivablePort, Port
from afdsvc.app import commissioning
from afdsvc.files.site import DriverSection, MachineSection
from afdsvc.hal.control_loop import LoopSettings
from afdsvc.plugins.manager import load
from afdsvc.service.clock import RealClock
from afdsvc.testing.conformance.named import settings_of

BLOCKS = 4


@contextmanager
def _opened(thing: Any) -> Iterator[Port]:
    """Open a driver as the rig agent does, and close it whatever happens."""
    config = MachineSection(id="example", plant="gas_bearing", driver=DriverSection(kind=thing.name, settings=dict(settings_of(thing))))
    parts = commissioning.commission(config, load())
    port = thing.open(parts, LoopSettings("example", "session", 100), RealClock(), settings_of(thing))
    try:
        yield port
    finally:
        port.close()


def blocks_are_whole(thing: Any) -> None:
    """Blocks follow each other without a hole, with the machine's channels and finite numbers."""
    with _opened(thing) as port:
        k = None
        for _ in range(BLOCKS):
            block = port.read()
            assert block is not None, "no block came; a driver waits for its next sample"
            assert block.channels == port.channels, "a block has other channels than its port"
            assert block.dt == port.dt, f"a block has sample time {block.dt}, its port {port.dt}"
            assert k is None or block.k0 == k, f"a block begins at sample {block.k0}; expected {k}"
            assert np.isfinite(block.role("u")).all(), "an input is not finite"
            k = block.k0 + len(block)


def closing_twice_is_harmless(thing: Any) -> None:
    """Closing twice does no harm."""
    with _opened(thing) as port:
        port.read()
        port.close()


def every_exit_leaves_the_plant_at_rest(thing: Any) -> None:
    """After leaving `arm`, by an exception in the middle of a burst too, alpha is zero again."""
    with _opened(thing) as port:
        if not isinstance(port, DrivablePort):
            return
        m = len([c for c in port.channels if c.role == "u"])
        p = len([c for c in port.channels if c.role == "y"])
        limits = Limits(np.full(p, 1e3), np.full(m, 1e3), np.full(m, 1.0), 5.0)
        burst = Burst("example", m, 400, 40, (Line(0, 600.0, 1e-3),))
        port.read()
        try:
            with port.arm(limits) as drive:
                drive.play(burst)
                port.read()
                raise KeyError("a mishap")
        except KeyError:
            pass
        tail = [port.read() for _ in range(3)][-1]
        assert tail is not None, "no block came after the exit; a driver waits for its next sample"
        assert not np.abs(tail.role("alpha")).max(initial=0.0), "alpha is not zero after the exit"


CHECKS = (blocks_are_whole, closing_twice_is_harmless, every_exit_leaves_the_plant_at_rest)
