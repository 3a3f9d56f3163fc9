"""The service as a supervised process: ready, alive, stopping in time, and log lines that are JSON."""

from __future__ import annotations

import ctypes
import json
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import time
from importlib.metadata import metadata
from pathlib import Path

import pytest

from afdsvc.app.ask import ask_service
from afdsvc.files.site import read_site
from afdsvc.service.audit_log import verify_chain

PACKAGING = Path(__file__).parents[2] / "packaging"
SITE = """site = "t"
[transport]
listen = ["tcp/127.0.0.1:{port}"]
[[machines]]
id = "bearing"
plant = "gas_bearing"
bursts = {{every_seconds = 4.0, first_after_seconds = 0.5}}
"""


def heard(s: socket.socket, wanted: str, seconds: float = 180.0) -> None:
    deadline = time.monotonic() + seconds
    while time.monotonic() < deadline:
        s.settimeout(max(deadline - time.monotonic(), 0.01))
        if s.recv(200).decode() == wanted:
            return
    raise AssertionError(f"'{wanted}' was never heard")


def ended(process: subprocess.Popen) -> str:
    """End a process that has not, and return what it said."""
    if process.poll() is None:
        process.kill()
    return process.communicate()[1].decode()


@pytest.mark.skipif(not hasattr(socket, "AF_UNIX"), reason="needs Unix sockets")
def test_a_supervisor_is_notified_and_sigterm_ends_everything_in_time_even_in_a_burst(free_port, tmp_path):
    site, address = tmp_path / "site.toml", tmp_path / "notify"
    site.write_text(SITE.format(port=free_port))
    ear = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    ear.bind(str(address))
    environment = {**os.environ, "NOTIFY_SOCKET": str(address), "WATCHDOG_USEC": "300000"}
    run = [sys.executable, "-m", "afdsvc"]
    serve = subprocess.Popen([*run, "serve", str(site), "--log", "json"], stderr=subprocess.PIPE, env=environment, cwd=tmp_path)
    rig = None
    try:
        heard(ear, "READY=1")
        heard(ear, "WATCHDOG=1")
        rig = subprocess.Popen([*run, "rig", str(site), "--machine", "bearing"], stderr=subprocess.PIPE, cwd=tmp_path)
        deadline = time.monotonic() + 60
        while not ask_service(read_site(site), "status", "kim")["machines"][0]["burst"]:
            assert time.monotonic() < deadline, "no burst was ever played"
        rig.send_signal(signal.SIGTERM)
        assert rig.wait(30) == 0
        serve.send_signal(signal.SIGTERM)
        heard(ear, "STOPPING=1", 30)
        assert serve.wait(30) == 0
    finally:
        said = [ended(process) for process in (serve, rig) if process]
        ear.close()
    lines = [json.loads(line) for line in said[0].splitlines()]
    assert any("serving 't' with 1 machine" in line["message"] for line in lines)
    assert {"time", "level", "logger", "thread", "message"} <= set(lines[0])


@pytest.mark.parametrize("journal", [False, True])
def test_lines_of_the_log_begin_with_the_time_unless_the_journal_adds_it(journal):
    environment = {k: v for k, v in os.environ.items() if k != "JOURNAL_STREAM"} | ({"JOURNAL_STREAM": "8:1"} if journal else {})
    code = "import logging; from afdsvc.app.supervision import start_logging; start_logging('text'); logging.getLogger('afdsvc').warning('all is well')"
    said = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True).stderr.splitlines()[-1]
    assert re.fullmatch(("" if journal else r"\d{4}-\d\d-\d\d \d\d:\d\d:\d\d ") + "afdsvc: WARNING: all is well", said)


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="looks at /proc")
def test_sigterm_ends_the_preparation_too(free_port, tmp_path):
    site = tmp_path / "site.toml"
    machines = "".join(f'[[machines]]\nid = "m{i}"\nplant = "gas_bearing"\n' for i in range(40))
    site.write_text(f'site = "t"\n[transport]\nlisten = ["tcp/127.0.0.1:{free_port}"]\n{machines}')
    service = subprocess.Popen([sys.executable, "-m", "afdsvc", "serve", str(site)], stderr=subprocess.PIPE)
    try:
        while not handles(service.pid, signal.SIGTERM):
            assert service.poll() is None
            time.sleep(0.05)
        time.sleep(0.5)
        service.send_signal(signal.SIGTERM)
        assert service.wait(120) == 0
    finally:
        assert ended(service) == ""  # not a word of what follows the preparation


def handles(pid: int, number: int) -> bool:
    """Return whether a process has a handler of its own for a signal."""
    (mask,) = re.findall(r"SigCgt:\s*(\w+)", Path(f"/proc/{pid}/status").read_text())
    return bool(int(mask, 16) >> (number - 1) & 1)


def test_the_shipped_units_start_what_there_is():
    commands = [line for u in PACKAGING.glob("*.service") for line in u.read_text().splitlines() if line.startswith("ExecStart=")]
    assert sorted(c.split()[1] for c in commands) == ["rig", "serve"]
    assert "Type=notify" in (PACKAGING / "afdsvc.service").read_text()


@pytest.mark.parametrize(("name", "most"), [("afdsvc.service", 20), ("afdsvc-rig@.service", 30)])
def test_the_units_are_bound(name, most):
    """Below 2.0 of 10 by systemd's own count (8.5 before it was hardened), that of a rig, whose driver needs devices, below 3.0."""
    unit, analyze = PACKAGING / name, shutil.which("systemd-analyze")
    if analyze is None:
        pytest.skip("no systemd-analyze here")
    done = subprocess.run(
        [analyze, "security", "--offline=true", f"--threshold={most}", str(unit)], capture_output=True, text=True, check=False, timeout=60
    )
    assert done.returncode == 0, done.stdout[-500:] + done.stderr


def test_the_service_runs_as_the_container_runs_it(tmp_path, free_port):
    """Without capabilities on a read-only system, with the variables and the command of the container file."""
    state, site = tmp_path / "state", tmp_path / "site.toml"
    state.mkdir()
    site.write_text(SITE.format(port=free_port))
    alone = 'mount --make-rprivate / && mount --bind "$1" "$1" && mount -o remount,ro,bind / && shift && exec setpriv --no-new-privs --bounding-set=-all --inh-caps=-all "$@"'
    alone = ["unshare", "-m", "sh", "-c", alone, "sh", str(state)]
    if not shutil.which("unshare") or subprocess.run([*alone, "true"], capture_output=True, check=False).returncode:
        pytest.skip("no right to make a read-only system here")
    words = (PACKAGING / "Containerfile").read_text().replace("/var/lib/afdsvc", str(state)).splitlines()
    said = dict(line.split(maxsplit=1) for line in words if line and not line.startswith((" ", "#")))
    environment = {**os.environ, **dict(pair.split("=") for pair in said["ENV"].split())}
    arguments = [str(site) if word.endswith("site.toml") else word for word in json.loads(said["CMD"])]
    command = [*alone, sys.executable, "-m", *json.loads(said["ENTRYPOINT"]), *arguments, "--seconds", "1"]
    done = subprocess.run(command, env=environment, cwd=state, capture_output=True, text=True, check=False, timeout=120)
    assert done.returncode == 0, done.stderr
    assert "serving 't' with 1 machine" in done.stderr
    assert all(json.loads(line)["level"] in ("info", "warning") for line in done.stderr.splitlines())
    assert verify_chain(state / "recordings" / "t-audit.jsonl").entries[-1]["what"] == "stop"


def test_the_container_installs_what_there_is():
    (extras,) = re.findall(r"\.whl\)\[(.*?)\]", (PACKAGING / "Containerfile").read_text())
    assert set(extras.split(",")) <= set(metadata("afdsvc").get_all("Provides-Extra"))


def test_without_a_folder_recordings_go_to_the_state_directory_of_the_unit(tmp_path, monkeypatch):
    site = tmp_path / "site.toml"
    site.write_text(SITE.format(port=7447))
    assert read_site(site).recording.folder == tmp_path / "recordings"
    monkeypatch.setenv("STATE_DIRECTORY", "/var/lib/afdsvc")
    assert read_site(site).recording.folder == Path("/var/lib/afdsvc/recordings")
    site.write_text(SITE.format(port=7447).replace("[[machines]]", '[recording]\nfolder = "here"\n[[machines]]'))
    assert read_site(site).recording.folder == tmp_path / "here"


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="needs a place where nothing can be made")
@pytest.mark.parametrize(
    ("table", "key", "value", "what"),
    [("recording", "folder", "/proc/x", "a folder that"), ("alarms", "history", "/proc/x/alarms.sqlite", "a file in a folder that")],
)
def test_a_service_that_can_keep_nothing_says_so_and_does_not_start(tmp_path, free_port, table, key, value, what):
    site = tmp_path / "site.toml"
    site.write_text(SITE.format(port=free_port).replace("[[machines]]", f'[{table}]\n{key} = "{value}"\n[[machines]]'))
    done = subprocess.run([sys.executable, "-m", "afdsvc", "serve", str(site)], capture_output=True, text=True, check=False, timeout=120)
    assert done.returncode == 2
    assert done.stderr.splitlines()[-1].endswith(f"key '{table}.{key}' is '{value}': No such file or directory; expected {what} can be made and written")
    assert "Traceback" not in done.stderr


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="looks at /proc")
def test_sigterm_ends_the_service_whichever_of_its_threads_receives_it(free_port, tmp_path):
    site, address = tmp_path / "site.toml", tmp_path / "notify"
    site.write_text(SITE.format(port=free_port))
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as ear:
        ear.bind(str(address))
        command = [sys.executable, "-m", "afdsvc", "serve", str(site)]
        serve = subprocess.Popen(command, stderr=subprocess.DEVNULL, env={**os.environ, "NOTIFY_SOCKET": str(address)}, cwd=tmp_path)
        try:
            heard(ear, "READY=1")
            time.sleep(1.0)
            other = next(int(t) for t in os.listdir(f"/proc/{serve.pid}/task") if int(t) != serve.pid)
            assert ctypes.CDLL(None).tgkill(serve.pid, other, signal.SIGTERM) == 0
            assert serve.wait(10) == 0
        finally:
            serve.kill()


OUTAGES = """
import sys, time
from queue import SimpleQueue
from threading import Thread
from afdsvc.app.supervision import return_memory

def resident():
    return int(open("/proc/self/statm").read().split()[1]) * 4096 / 1e6

def receive():
    for i in range(500):
        queue.put(bytes(20_000))
        if i % 10 == 0:
            kept.append(bytes(700))

return_memory(float(sys.argv[1]))
queue, kept, began = SimpleQueue(), [], resident()
for _ in range(3):
    threads = [Thread(target=receive) for _ in range(16)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    while not queue.empty():
        queue.get()
until = time.monotonic() + 5 * float(sys.argv[1])
while resident() - began > 40 and time.monotonic() < until:
    time.sleep(0.05)
print(resident() - began)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="the C library of Linux")
def test_what_the_queues_of_outages_took_is_given_back():
    left = subprocess.run([sys.executable, "-c", OUTAGES, "2"], capture_output=True, text=True, check=True)
    assert float(left.stdout) < 40.0  # MB; 8000 blocks of 20 kB were queued three times


CYCLES = """
import sys, time, weakref
from afdsvc.app.supervision import collect_rarely, return_memory

class Cycle:
    def __init__(self):
        self.itself, self.data = self, bytes(10_000_000)

collect_rarely()
return_memory(float(sys.argv[1]))
left = [weakref.ref(Cycle()) for _ in range(5)]
until = time.monotonic() + 20 * float(sys.argv[1])
while any(w() for w in left) and time.monotonic() < until:
    time.sleep(0.05)
print(sum(w() is not None for w in left))
"""


@pytest.mark.skipif(sys.platform != "linux", reason="the C library of Linux")
def test_what_cycles_hold_is_given_back_though_they_are_looked_for_rarely():
    assert int(subprocess.run([sys.executable, "-c", CYCLES, "0.5"], capture_output=True, text=True, check=True).stdout) == 0
