"""The process that renews leases: quick, only while the service is well, and replaced when it dies."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time

import numpy as np
import pytest

from afdsvc.transport.lease_keeper import PRIORITY, TRUST_SECONDS, LeaseKeeper
from afdsvc.transport.zenoh_session import Transport, configuration
from tests.transport.test_zenoh_session import Settings, free_port, wait_for

KEY = "afdsvc/t/m/lease"


@pytest.fixture
def kept():
    """Return a keeper beside a service, and the times and bytes of what a rig hears."""
    settings, heard = Settings(listen=[f"tcp/127.0.0.1:{free_port()}"]), []
    with Transport(settings, True), Transport(settings, False) as rig:
        rig.subscribe(KEY, lambda key, payload: heard.append((time.monotonic(), payload)), missed=False)
        keeper = LeaseKeeper(str(configuration(settings, False)))
        yield keeper, heard
        keeper.close()


def reported(keeper: LeaseKeeper, leases: list[tuple[str, bytes]], seconds: float = 30.0) -> bool:
    """Say the leases until the keeper renews them; return whether it does."""
    return wait_for(lambda: keeper.renew(leases), seconds)


def test_leases_are_renewed_while_no_thread_of_the_service_runs(kept):
    """One thread holds the interpreter for half a second: threads of the service wait, the keeper's renewals come all the same."""
    keeper, heard = kept
    assert reported(keeper, [(KEY, b"one"), (KEY, b"two")])
    assert wait_for(lambda: len(heard) > 4)
    assert keeper.renew([(KEY, b"one"), (KEY, b"two")])
    keeper.longest = 0.0
    began, late = time.monotonic(), []

    def tick() -> None:
        last = time.monotonic()
        while time.monotonic() < began + 0.8:
            time.sleep(0.01)
            late.append(time.monotonic() - last)
            last = time.monotonic()

    thread = threading.Thread(target=tick)
    thread.start()
    hold_the_interpreter(0.5)
    thread.join()
    assert max(late) > 0.4  # or this shows nothing
    assert wait_for(lambda: keeper.renew([(KEY, b"one"), (KEY, b"two")]) and keeper.longest > 0)
    assert keeper.longest < max(late)
    assert {payload for _, payload in heard} == {b"one", b"two"}


def test_renewals_of_many_machines_are_not_dropped(kept):
    keeper, heard = kept
    leases = [(KEY, str(i).encode()) for i in range(200)]
    assert reported(keeper, leases)
    assert wait_for(lambda: keeper.renew(leases) and {payload for _, payload in heard} >= {lease for _, lease in leases})
    before = len(heard)
    keeper.renew(leases)
    time.sleep(0.9 * TRUST_SECONDS)
    rounds = np.bincount([int(payload) for _, payload in heard[before:]], minlength=200)
    assert rounds.min() >= rounds.max() - 2  # the first and the last round may be cut


def test_renewals_go_before_other_processes_where_that_is_permitted(kept):
    keeper, _ = kept
    assert reported(keeper, [(KEY, b"one")])
    tried = subprocess.run([sys.executable, "-c", f"import os; os.setpriority(os.PRIO_PROCESS, 0, {PRIORITY})"], capture_output=True, check=False)
    assert keeper._process is not None
    assert os.getpriority(os.PRIO_PROCESS, keeper._process.pid) == (PRIORITY if tried.returncode == 0 else os.getpriority(os.PRIO_PROCESS, 0))


def hold_the_interpreter(seconds: float) -> None:
    """Run one call into C that does not let other threads run."""
    data = b"0" * 30_000_000
    end = time.perf_counter() + seconds
    before = sys.getswitchinterval()
    sys.setswitchinterval(10.0)
    try:
        while time.perf_counter() < end:
            data.count(b"1")
    finally:
        sys.setswitchinterval(before)


def test_a_service_that_hangs_renews_nothing(kept):
    keeper, heard = kept
    assert reported(keeper, [(KEY, b"one")])
    assert wait_for(lambda: heard)
    silent = time.monotonic()
    time.sleep(TRUST_SECONDS + 2.0)
    assert heard[-1][0] < silent + TRUST_SECONDS + 1.5
    assert reported(keeper, [(KEY, b"one")])


def test_what_has_ended_is_not_renewed(kept):
    keeper, heard = kept
    assert reported(keeper, [(KEY, b"one")])
    assert wait_for(lambda: heard)
    keeper.renew([])
    time.sleep(1.0)
    ended = len(heard)
    for _ in range(10):
        keeper.renew([])
        time.sleep(0.05)
    assert len(heard) == ended


def test_a_keeper_that_is_stopped_or_dead_is_said_to_be_so_and_one_with_new_keys_begins(kept):
    keeper, heard = kept
    assert reported(keeper, [(KEY, b"one")])
    os.kill(keeper._process.pid, signal.SIGSTOP)
    assert wait_for(lambda: not keeper.renew([(KEY, b"one")]))
    os.kill(keeper._process.pid, signal.SIGCONT)
    assert reported(keeper, [(KEY, b"one")])
    before = keeper._process.pid
    keeper.restart()
    assert reported(keeper, [(KEY, b"one")])
    assert keeper._process.pid != before


def test_the_longest_wait_is_reported(kept):
    keeper, _ = kept
    assert reported(keeper, [])
    assert wait_for(lambda: keeper.renew([]) and keeper.longest > 0)
    assert np.isfinite(keeper.longest)
