"""What many tests start from: the gas bearing with one of its controllers, in closed loop."""

from __future__ import annotations

import contextlib
import os
import signal
from collections.abc import Callable
from pathlib import Path

import afdsvc  # noqa: F401  # isort: skip  # before numpy: one thread for linear algebra
import numpy as np
import pytest

from afdsvc.api.port import DrivablePort
from afdsvc.app import commissioning, ports
from afdsvc.files.site import FaultInjection, MachineSection, PluginSection
from afdsvc.lti.statespace import StateSpace
from afdsvc.plugins.manager import Plugins, load
from afdsvc.service.clock import FastClock

# Files of few and long tests, first what compiles for the others; a long file that comes last leaves every other worker idle.
LONG = ("testing", "explain", "compatibility", "system", "app", "trial", "service", "retune", "transport")


def pytest_configure(config: pytest.Config) -> None:
    """Hand files out as they are collected: pytest-xdist would begin with those of the most tests. Take SIGINT as on a terminal.

    What a shell starts in the background ignores it, and so would every process that a test starts and means to end by it.
    """
    config.option.loadscopereorder = False
    signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_auto_num_workers() -> int:
    """Return two workers more than there are processors: tests of services wait for their clocks."""
    return (os.cpu_count() or 1) + 2


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with the rooms whose tests are long."""
    ranks = {room: rank for rank, room in enumerate(LONG)}
    items.sort(key=lambda item: ranks.get(item.path.relative_to(Path(__file__).parent).parts[0], len(LONG)))


@pytest.fixture(scope="session")
def plugins() -> Plugins:
    """Everything installed."""
    return load()


@pytest.fixture(scope="session")
def measured() -> Path:
    """The folder of measured recordings named by AFDSVC_DATA; the test is skipped where there is none."""
    folder = os.environ.get("AFDSVC_DATA")
    if not folder:
        pytest.skip("AFDSVC_DATA names no folder of measured recordings")
    return Path(folder)


def controller_settings(name: str) -> PluginSection:
    """Return one of the two controllers of the thesis."""
    return PluginSection(kind="proportional", settings={"gain": 0.2}) if name == "proportional" else PluginSection(kind="lqg")


def machine_config(controller: str = "lqg", rpm: int = 0, seed: int = 1, faults: dict | None = None, **more) -> MachineSection:
    """Return a gas bearing as a site file would describe it; ``faults`` maps names to (severity, second)."""
    injected = [FaultInjection(name=n, severity=s, at_seconds=t) for n, (s, t) in (faults or {}).items()]
    driver = {"kind": "simulator", "real_time": False, "seed": seed, "faults": injected}
    return MachineSection(
        id="bearing",
        plant="gas_bearing",
        options={"rpm": rpm},
        controller=controller_settings(controller),
        driver=driver,
        **more,
    )


@pytest.fixture(scope="session")
def bearing(plugins: Plugins) -> Callable[..., commissioning.Commissioned]:
    """Return commissioned gas bearings by controller, speed, seed, faults."""
    return lambda *args, **kwargs: commissioning.commission(machine_config(*args, **kwargs), plugins)


@pytest.fixture(scope="session")
def simulated(bearing, plugins: Plugins) -> Callable[..., DrivablePort]:
    """Return simulators of gas bearings, as fast as they go."""

    def make(*args, session: str = "test", **kwargs) -> DrivablePort:
        return ports.open_port(bearing(*args, **kwargs), session, FastClock(), plugins)

    return make


@pytest.fixture(scope="session")
def oscillators() -> Callable[[int, int, int, int], StateSpace]:
    """A stable system of well separated modes, from a seed and (order, inputs, outputs)."""

    def make(seed: int, order: int = 6, inputs: int = 2, outputs: int = 2) -> StateSpace:
        rng = np.random.default_rng(seed)
        A = np.zeros((order, order))
        for i in range(0, order - 1, 2):
            radius, angle = rng.uniform(0.75, 0.95), (i + 1 + rng.uniform(-0.4, 0.4)) * 2.6 / order
            block = [[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]]
            A[i : i + 2, i : i + 2] = radius * np.array(block)
        if order % 2:
            A[-1, -1] = rng.uniform(0.3, 0.8)
        B, C = rng.standard_normal((order, inputs)), rng.standard_normal((outputs, order))
        return StateSpace.of(A, B, C, np.zeros((outputs, inputs)), 1.0)

    return make


def stack(blocks: list) -> np.ndarray:
    """Return the samples of blocks in one array."""
    return np.vstack([b.values for b in blocks])


@pytest.fixture
def free_port() -> int:
    """Return a loopback port that is free and the next one, too; below the range from which connections take theirs."""
    import random
    import socket

    while True:
        port = random.SystemRandom().randrange(20000, 32000)
        with socket.socket() as one, socket.socket() as other:
            with contextlib.suppress(OSError):
                one.bind(("127.0.0.1", port))
                other.bind(("127.0.0.1", port + 1))
                return port


@pytest.fixture
def browser(tmp_path):
    """Return a browser without a screen; without one on this computer the test is skipped."""
    from benchmarks.support.browser import CHROMIUM, NO_CHROMIUM, Browser

    if CHROMIUM is None:
        pytest.skip(NO_CHROMIUM)
    opened = Browser(tmp_path / "browser")
    yield opened
    opened.close()
