"""The command line: one JSON document, one clear sentence, the exit codes that are promised."""

from __future__ import annotations

import json
import math
import os
import select
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import pytest

from afdsvc import cli
from afdsvc.present import terminal

SHIPPED = Path(__file__).parents[2] / "recordings" / "shipped"


def afdsvc(*arguments: str, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-m", "afdsvc", *arguments], cwd=cwd, capture_output=True, text=True, timeout=240)


def one_sentence(done: subprocess.CompletedProcess[str], *words: str) -> None:
    """Assert exit 2 and one sentence without a traceback."""
    assert done.returncode == 2, done.stderr
    assert "Traceback" not in done.stderr
    assert done.stdout == ""
    assert len(done.stderr.strip().splitlines()) == 1, done.stderr
    for word in words:
        assert word in done.stderr


def test_demo_names_the_fault(tmp_path: Path):
    done = afdsvc("demo", "--json", "--seconds", "12", "--fault", "vertical_sensor=-0.4@4", "--out", str(tmp_path))
    assert done.returncode == 0, done.stderr
    document = json.loads(done.stdout)
    verdict = document["recordings"][0]["verdict"]
    assert document["truth"] == [{"fault": "vertical_sensor", "severity": -0.4, "start_s": 4.0}]
    assert verdict["fault"] == "vertical_sensor"
    assert abs(verdict["severity"]["value"] + 0.4) < 4 * verdict["severity"]["sd"]
    assert Path(document["recording"]).stat().st_size > 1e6
    assert Path(document["rerun"]).stat().st_size > 1e6
    again = afdsvc("diagnose", "--json", document["recording"])
    assert json.loads(again.stdout)["recordings"] == document["recordings"]
    table = afdsvc("diagnose", document["recording"])
    assert "vertical_sensor" in table.stdout
    made = afdsvc("review", document["recording"], "--save", str(tmp_path / "again.rrd"))
    assert made.returncode == 0, made.stderr
    assert (tmp_path / "again.rrd").stat().st_size > 1e6


def test_demo_says_what_it_prepares_before_it_loads_what_runs_it(monkeypatch, capsys):
    for name in ("afdsvc.app.demo", "afdsvc.present.terminal"):
        monkeypatch.setitem(sys.modules, name, None)  # takes seconds to import; here it fails
    with pytest.raises(ImportError):
        cli.demo()
    assert "preparing a simulated gas_bearing" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("serve", "missing.toml"), ("missing.toml", "cannot be read")),
        (("serve", "wrong.toml"), ("wrong.toml", "machines[0].blok", "is not known")),
        (("serve", "plugin.toml"), ("machine 'm'", "no plugin 'fuzzy' among the controllers", "lqg, pid, proportional")),
        (("serve", "unstable.toml"), ("machine 'm'", "does not stabilise")),
        (("serve", "shape.toml"), ("machine 'm'", "gain", "(2, 2)")),
        (("serve", "setting.toml"), ("machine 'm'", "unknown setting 'gian'")),
        (("rig", "good.toml", "--machine", "x"), ("good.toml", "no machine 'x'; it has m")),
        (("status", "--site", "good.toml"), ("no service answers", "afdsvc serve")),
        (("alarms", "good.toml"), ("'good.toml' is not an alarm", "--site good.toml")),
        (("diagnose", "missing.mcap"), ("missing.mcap",)),
        (("diagnose", "wrong.toml"), ("wrong.toml", "MCAP")),
        (("diagnose", "table.csv"), ("table.csv", "--model")),
        (("diagnose", "table.csv", "--model", "model.toml"), ("column 'velocity' has no role",)),
        (("explain", "table.csv", "model.toml"), ("table.csv: is a recording", "MODEL.toml")),
        (("identify", "model.toml", "model.toml"), ("model.toml: is not a recording",)),
        (("identify", "model.toml", "other.csv"), ("no column 'u_force'", "--map u_torque=u_force")),
        (("demo", "--fault", "bearing"), ("--fault 'bearing'", "NAME=SEVERITY@SECONDS")),
        (("demo", "--fault", "a=-2@1"), ("severity -2",)),
        (("demo", "--plant", "none"), ("no plant 'none'", "gas_bearing")),
        (("import", "table.csv", "-o", "x.mcap", "--map", "velocity"), ("--map 'velocity'",)),
    ],
)
def test_bad_input_is_one_sentence(tmp_path: Path, arguments, words):
    machine = '[[machines]]\nid = "m"\nplant = "gas_bearing"\n'
    head = 'site = "t"\n[transport]\npatience_seconds = 0.5\nlisten = ["tcp/127.0.0.1:9"]\n'
    files = {
        "good.toml": "",
        "wrong.toml": "blok = 3\n",
        "plugin.toml": 'controller = {kind = "fuzzy"}\n',
        "unstable.toml": 'controller = {kind = "proportional", settings = {gain = 5.0}}\n',
        "shape.toml": 'controller = {kind = "proportional", settings = {gain = [[1.0]]}}\n',
        "setting.toml": 'controller = {kind = "proportional", settings = {gian = 0.2}}\n',
    }
    for name, more in files.items():
        (tmp_path / name).write_text(head + machine + more)
    (tmp_path / "table.csv").write_text("t,u_force,velocity\n0,1,2\n0.1,1,2\n")
    rows = "".join(f"{k},{k % 3},{k % 2}\n" for k in range(400))
    (tmp_path / "other.csv").write_text(f"t,u_torque,y_q\n{rows}")
    (tmp_path / "model.toml").write_text(
        'name = "m"\ntime = "continuous"\ninputs = [{name = "force"}]\noutputs = [{name = "q"}]\n'
        "A = [[-1]]\nB = [[1]]\nC = [[1]]\nD = [[0]]\n"
    )
    one_sentence(afdsvc(*arguments, cwd=tmp_path), *words)


def test_design_says_what_the_burst_finds(tmp_path: Path):
    site = tmp_path / "site.toml"
    site.write_text('site = "t"\n[[machines]]\nid = "m"\nplant = "gas_bearing"\nbursts = {every_seconds = 60}\n')
    done = afdsvc("design", str(site), "--json")
    assert done.returncode == 0, done.stderr
    sheet = json.loads(done.stdout)
    assert {b["input"] for b in sheet["bursts"]} == {"horizontal", "vertical"}
    assert set(sheet["thresholds"]) == {"matched_filter", "regression", "cusum", "passive_cusum"}
    half = {f["fault"]: f for f in sheet["faults"] if f["severity"] == -0.5}
    assert set(half) == {"horizontal_actuator", "vertical_actuator", "horizontal_sensor", "vertical_sensor"}
    assert all(f["p_detect"] > 0.999 and f["cramer_rao_sd"] < 0.01 for f in half.values())
    # three detectors at 1 per 1000 of 60 bursts an hour, and a passive one at 1 in 30 days
    assert abs(sheet["false_alarms_per_hour"] - (3 * 60 / 1000 + 1 / 720)) < 1e-9
    assert Path(sheet["report"]).read_text().startswith("<!")


def test_the_design_in_the_terminal_says_frequencies_in_both_units(capsys):
    loop = {"controller_gain": {"stable_from": None, "stable_to": 2.0, "least_damping": 0.5}, "nu_gap": {"margin": 0.25}, "candidates": []}
    burst = {"input": "voltage", "frequencies_rad_s": [2 * math.pi * 50.0], "seconds": 1.0, "peak_output": 0.1}
    sheet = {"machine": "m", "bursts": [burst], "faults": [], "false_alarms_per_hour": 0.1, "loop": loop, "report": "page.html"}
    terminal.design_table(sheet)
    said = capsys.readouterr().out
    assert "burst on voltage: 50 Hz (314 rad/s), 1.00 s" in said
    assert "between bursts" not in said
    terminal.design_table(sheet | {"unpromised": "no rate of alarms can be promised"})
    assert "between bursts: no rate of alarms can be promised\n" in capsys.readouterr().out


def test_plugins_list_and_version(tmp_path: Path):
    found = json.loads(afdsvc("plugins", "list", "--json").stdout)
    assert found["broken"] == {}
    families = {p["family"] for p in found["plugins"]}
    assert {"controllers", "faults", "detectors", "physics"} <= families
    assert afdsvc("--version").stdout.strip() == "0.1.0"


def test_import_is_exact(tmp_path: Path):
    (tmp_path / "run.csv").write_text(
        "t,current,y_angle\n" + "".join(f"{k / 1000!r},{k * 0.1!r},{1 / (k + 1)!r}\n" for k in range(99))
    )
    out = tmp_path / "run.mcap"
    done = afdsvc("import", str(tmp_path / "run.csv"), "-o", str(out), "--map", "current=u_current", "--json")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["channels"] == ["u_current", "y_angle"]
    from afdsvc.files.recording.reader import Recording

    (trace,) = Recording(out).traces()
    assert trace.values[:, 1].tolist() == [1 / (k + 1) for k in range(99)]


@pytest.mark.skipif(sys.platform == "win32", reason="needs a pseudo-terminal")
def test_an_explanation_shows_on_a_terminal_what_it_does_long_before_it_is_done(tmp_path: Path):
    ours, theirs = os.openpty()
    command = [sys.executable, "-m", "afdsvc", "explain", str(SHIPPED / "gas_bearing_nominal.mcap"), "--out", str(tmp_path)]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=theirs)
    try:
        said, deadline = b"", time.monotonic() + 60
        while b"explaining: " not in said:
            assert select.select([ours], [], [], max(deadline - time.monotonic(), 0))[0], said
            said += os.read(ours, 4096)
    finally:
        process.kill()
        process.wait()
        os.close(ours)
        os.close(theirs)


def test_an_unexpected_failure_is_one_sentence_that_names_the_file_of_its_traceback(monkeypatch, capsys, tmp_path):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    monkeypatch.setattr(cli, "app", lambda **_: 1 / 0)
    with pytest.raises(SystemExit) as end:
        cli.run_cli()
    (said,) = capsys.readouterr().err.splitlines()
    assert end.value.code == 1
    assert said.startswith("afdsvc: unexpected failure: ZeroDivisionError: division by zero; a report of it needs ")
    assert "1 / 0" in Path(said.rsplit(" ", 1)[1]).read_text(encoding="utf-8")


@pytest.mark.parametrize(("words", "completed"), [("afdsvc retune b", "bearing"), ("afdsvc pause --machine p", "pump"), ("afdsvc retune --site other.toml t", "turbine"), ("afdsvc retune --site none.toml t", "")])
def test_shells_complete_the_ids_of_machines_from_the_site_file(words, completed, tmp_path):
    (tmp_path / "site.toml").write_text('[[machines]]\nid = "bearing"\n[[machines]]\nid = "pump"\n')
    (tmp_path / "other.toml").write_text('[[machines]]\nid = "turbine"\n')
    asked = {"_AFDSVC_COMPLETE": "complete_bash", "COMP_WORDS": words, "COMP_CWORD": str(len(words.split()) - 1)}
    done = subprocess.run([sys.executable, "-m", "afdsvc"], cwd=tmp_path, env=os.environ | asked, capture_output=True, text=True, check=False)
    assert done.stdout.strip() == completed
