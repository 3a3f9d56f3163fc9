"""`afdsvc init` and `afdsvc site check`: first files from a log, and what a site file makes of its machines."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet
import pytest
from scipy.io import savemat
from typer.testing import CliRunner

from afdsvc import load
from afdsvc.app.init import Answers, init_files
from afdsvc.app.site_check import check_site
from afdsvc.cli import app
from afdsvc.errors import BadInput
from afdsvc.files.model.model_file import read_model
from afdsvc.files.site import read_site
from afdsvc.files.tables.mapping import read_mapping

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def logs(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("motor")
    subprocess.run([sys.executable, str(ROOT / "examples" / "motor_recording.py")], cwd=folder, check=True, capture_output=True)
    return folder


def test_a_log_of_a_motor(logs: Path, tmp_path: Path):
    """The recorded motor: 115 rpm/V, 0.08 s, and 0.8 V of friction, which makes both numbers look smaller."""
    document = init_files(logs / "motor.csv", tmp_path)
    model, mapping = read_model(document["model"]), read_mapping(document["mapping"])
    assert [(v.name, v.unit) for v in (*model.inputs, *model.outputs)] == [("voltage", "V"), ("speed", "rpm")]
    assert model.states[0].unit == "rpm"
    assert mapping.signals["y_speed"].place == "speed_rpm"
    assert 80 < document["fits"]["speed"]["num"][0] < 115
    assert 0.05 < document["fits"]["speed"]["den"][0] < 0.08
    with pytest.raises(BadInput, match=r"MODEL\.toml: exists already"):
        init_files(logs / "motor.csv", tmp_path)


@pytest.mark.parametrize(
    ("header", "options", "words"),
    [
        ("t,alpha1,beta1", {}, ["is an input", "--input COLUMN", "alpha1, beta1"]),
        ("t,voltage_V,thing", {}, ["is an output", "--output COLUMN"]),
        ("t,voltage_V,thing", {"outputs": ["stuff"]}, ["no column 'stuff'", "voltage_V, thing"]),
        ("t,voltage_V,thing", {"outputs": ["thing"], "units": {"thing": "parsecs/rpm/x"}}, ["column 'thing'", "is not known"]),
    ],
)
def test_columns_that_do_not_say_what_they_are(tmp_path: Path, header, options, words):
    (tmp_path / "log.csv").write_text(header + "\n" + "".join(f"{k},{k % 7},{k % 5}\n" for k in range(100)))
    with pytest.raises(BadInput) as error:
        init_files(tmp_path / "log.csv", answers=Answers(**options))
    assert all(word in str(error.value) for word in words), str(error.value)
    assert not (tmp_path / "MODEL.toml").exists()


def test_units_say_the_role_where_names_do_not(tmp_path: Path):
    rows = "".join(f"{k / 10},{(k // 9) % 2},{(k // 9) % 2 + k % 3 / 10},20,{k}\n" for k in range(300))
    (tmp_path / "log.csv").write_text("t,U_V,n_rpm,winding_degC,aux_gap_mm\n" + rows)
    found = init_files(tmp_path / "log.csv")["columns"]
    assert [c["signal"] for c in found] == ["u_u", "y_n", "aux_winding", "aux_gap"]


def parquet(path: Path, columns: dict[str, np.ndarray], units: dict[str, str]) -> None:
    fields = [pa.field(n, pa.float64(), metadata={"units" if n == "tacho" else "unit": units[n]} if n in units else None) for n in columns]
    pyarrow.parquet.write_table(pa.table(list(columns.values()), schema=pa.schema(fields)), path)


def tdms(path: Path, columns: dict[str, np.ndarray], units: dict[str, str]) -> None:
    nptdms = pytest.importorskip("nptdms")
    with nptdms.TdmsWriter(str(path)) as writer:
        writer.write_segment([nptdms.ChannelObject("run", n, v, {"unit_string": units.get(n, "")}) for n, v in columns.items()])


@pytest.mark.parametrize("write", [parquet, tdms])
def test_units_that_the_file_states_beside_its_columns_are_used(tmp_path: Path, write):
    k = np.arange(300.0)
    columns = {"t": k / 10, "drive": (k // 9) % 2, "tacho": (k // 9) % 2 + k % 3 / 10, "heat": k % 7, "aux_gap_mm": k % 5, "index": k}
    write(path := tmp_path / f"log.{write.__name__}", columns, {"drive": "V", "tacho": "rpm", "heat": "pulses!", "aux_gap_mm": "inch"})
    found = init_files(path, answers=Answers(units={"index": "1"}))["columns"]
    assert [(c["signal"], c["unit"]) for c in found] == [("u_drive", "V"), ("y_tacho", "rpm"), ("aux_heat", ""), ("aux_gap", "mm"), ("aux_index", "1")]


def test_set_points_and_temperatures_are_kept_and_what_is_left_out_is_said(tmp_path: Path):
    rows = "".join(f"{k / 10},{(k // 9) % 2},{(k // 9) % 2 + k % 3 / 10},20,{k % 7},{k % 5},{k}\n" for k in range(300))
    (tmp_path / "log.csv").write_text("t,U_V,angle_deg,T_motor [°C],reference_deg,target speed [rpm],time_of_day\n" + rows)
    found = init_files(tmp_path / "log.csv")
    assert [c["signal"] for c in found["columns"]] == ["u_u", "y_angle", "aux_t_motor", "ref_angle", "ref_target_speed"]
    assert found["left_out"] == {"time_of_day": "its name says that it is a time"}
    said = CliRunner().invoke(app, ["init", str(tmp_path / "log.csv"), "--overwrite"]).output
    assert "time_of_day is left out: its name says that it is a time" in said


LOG_COLUMNS = (np.arange(300) // 9 % 2.0, np.convolve(np.arange(300) // 9 % 2.0, 0.5 * 0.5 ** np.arange(20))[:300])
LOG = "t,a,b\n" + "".join(f"{k / 10},{(k // 9) % 2},{(k // 9) % 2 + k % 3 / 10}\n" for k in range(300))


def test_inputs_and_outputs_that_never_change_are_left_out(tmp_path: Path):
    rows = "".join(f"{0.01 * k:.2f},{k % 7},{(k % 50) // 25},0,1013\n" for k in range(200))
    (tmp_path / "log.csv").write_text("t,command,speed_rpm,valve_command,pressure_hPa\n" + rows)
    document = init_files(tmp_path / "log.csv")
    assert document["left_out"] == dict.fromkeys(("valve_command", "pressure_hPa"), "it never changes")
    assert [c["signal"] for c in document["columns"]] == ["u_command", "y_speed"]
    with pytest.raises(BadInput, match=r"log\.csv: input valve_command never changes; expected one that does: --input COLUMN, one of command, speed_rpm"):
        init_files(tmp_path / "log.csv", tmp_path / "second", Answers(inputs=["valve_command"]))
    (tmp_path / "dead.csv").write_text("t,command,speed_rpm\n" + "".join(f"{0.01 * k:.2f},{k % 7},3\n" for k in range(200)))
    with pytest.raises(BadInput, match=r"dead\.csv: output speed_rpm never changes"):
        init_files(tmp_path / "dead.csv", tmp_path / "third")


def test_a_recording_of_the_service_needs_no_first_files(tmp_path: Path):
    with pytest.raises(BadInput, match="is a recording of afdsvc, which carries names, units and model"):
        init_files(next((ROOT / "recordings" / "shipped").glob("*.mcap")), tmp_path)


@pytest.mark.skipif(sys.platform == "win32", reason="needs a pseudo-terminal")
def test_on_a_terminal_it_asks_what_names_do_not_say(tmp_path: Path):
    (tmp_path / "log.csv").write_text(LOG)
    ours, theirs = os.openpty()
    os.write(ours, b"c\na\nb\nvolts per mile an hour\nV\nrpm\n\n-3\n2\n")  # three answers that are none: the question comes again
    done = subprocess.run([sys.executable, "-m", "afdsvc", "init", "log.csv", "--with-site"], cwd=tmp_path, stdin=theirs, capture_output=True, text=True)
    os.close(ours)
    os.close(theirs)
    assert done.returncode == 0, done.stderr
    for words in ("Which columns are inputs (a, b)?", "no column 'c'", "Which columns are outputs (b)?", "Unit of a", "is not known", "of b during a burst [rpm] [1.2]", "found '-3'"):
        assert words in done.stderr
    mapping, site = read_mapping(tmp_path / "mapping.toml"), read_site(tmp_path / "site.toml")
    assert {name: (source.place, source.unit) for name, source in mapping.signals.items()} == {"u_a": ("a", "V"), "y_b": ("b", "rpm")}
    assert len(read_model(tmp_path / "MODEL.toml").states) == 1  # a speed: a lag
    assert (site.machines[0].limits.input, site.machines[0].limits.output) == ([1.0], [2.0])


def test_a_log_without_a_time(tmp_path: Path):
    (tmp_path / "log.csv").write_text(LOG.replace("t,a,b", "n,U_V,n_rpm"))
    with pytest.raises(BadInput, match=r"no column is the time; .*--step SECONDS"):
        init_files(tmp_path / "log.csv")
    document = init_files(tmp_path / "log.csv", answers=Answers(step=0.5))
    assert document["sample_time"] == 0.5
    assert read_mapping(tmp_path / "mapping.toml").time.step == 0.5


def test_on_a_terminal_a_column_of_numbers_is_named_as_the_time(tmp_path: Path):
    (tmp_path / "log.csv").write_text(LOG.replace("t,a,b", "ticks,U_V,n_rpm"))
    answers = {"Which one is": ["clock", "ticks"], "Unit of ticks": ["min", "ms"]}

    def ask(question, default, parse):
        replies = next(r for part, r in answers.items() if part in question)
        with pytest.raises(BadInput, match=f"found '{replies[0]}'; expected one of"):
            parse(replies[0])
        return parse(replies[1])

    seconds = init_files(tmp_path / "log.csv", tmp_path / "s", Answers(units={"ticks": "s"}))["sample_time"]
    document = init_files(tmp_path / "log.csv", tmp_path / "ms", Answers(ask=ask))
    assert (document["time"], document["sample_time"]) == ("ticks", pytest.approx(seconds / 1000))
    assert read_mapping(tmp_path / "ms" / "mapping.toml").time.unit == "ms"
    none = {"Which one is": "", "Seconds between rows": "0.25"}
    document = init_files(tmp_path / "log.csv", tmp_path / "none", Answers(ask=lambda q, d, parse: parse(next(r for part, r in none.items() if part in q))))
    assert (document["time"], document["sample_time"]) == ("", 0.25)


def test_the_site_file_of_a_log_passes_site_check(logs: Path, tmp_path: Path):
    document = init_files(logs / "motor.csv", tmp_path, Answers(limits={"voltage_V": "5"}), site=True)
    (machine,) = check_site(Path(document["site"]))["machines"]
    assert (machine["problem"], machine["bursts"], machine["sample_time"]) == ("", "on request", 0.005)
    limits = read_site(Path(document["site"])).machines[0].limits
    assert limits.input == [5.0]
    assert 600 < limits.output[0] < 800


def test_roles_from_the_command_line(tmp_path: Path):
    (tmp_path / "log.csv").write_text(LOG)
    done = CliRunner().invoke(app, ["init", str(tmp_path / "log.csv"), "--input", "a", "--output", "b", "--json"])
    assert done.exit_code == 0, done.output
    assert [c["signal"] for c in json.loads(done.stdout)["columns"]] == ["u_a", "y_b"]


@pytest.mark.parametrize(
    ("line", "completed"),
    [
        ("dia", ["diagnose"]), ("identify m.toml --method p", ["pbsid", "pem"]), ("batch ex", ["explain"]), ("ack nowhere", []),
        ("inject rotor hor", ["horizontal_actuator=", "horizontal_sensor="]), ("inject stator hor", []), ("retune --fault v", ["vertical_actuator=", "vertical_sensor="]),
    ],
)  # fmt: skip
def test_the_shell_completes_commands_and_choices(line: str, completed: list[str], tmp_path: Path):
    (tmp_path / "site.toml").write_text('site = "hall"\n[[machines]]\nid = "rotor"\nplant = "gas_bearing"\n')
    words = {"COMP_WORDS": f"afdsvc {line}", "COMP_CWORD": str(len(line.split())), "_AFDSVC_COMPLETE": "complete_bash"}
    code = "from afdsvc.cli import app; app(prog_name='afdsvc')"
    done = subprocess.run([sys.executable, "-c", code], env={**os.environ, **words}, capture_output=True, text=True, cwd=tmp_path)
    assert done.stdout.split() == completed
    assert done.stderr == ""


def test_a_site_is_checked_machine_by_machine(tmp_path: Path):
    machine = '[[machines]]\nid = "{}"\nplant = "gas_bearing"\n{}'
    wrong = 'controller = {kind = "proportional", settings = {gain = 5.0}}\n'
    (tmp_path / "site.toml").write_text('site = "hall"\n' + machine.format("good", "") + machine.format("bad", wrong))
    document = check_site(tmp_path / "site.toml")
    good, bad = document["machines"]
    assert (good["problem"], good["bursts"], good["sample_time"]) == ("", "on request", 0.0002)
    assert "does not stabilise the plant" in bad["problem"]
    assert "transport.security" in document["remarks"][0]
    done = CliRunner().invoke(app, ["site", "check", str(tmp_path / "site.toml")])
    assert done.exit_code == 2
    assert "starts" in done.output


def test_a_site_that_can_keep_no_recordings_does_not_pass(tmp_path: Path):
    (tmp_path / "site.toml").write_text('site = "hall"\n[recording]\nfolder = "site.toml"\n[[machines]]\nid = "good"\nplant = "gas_bearing"\n')
    assert "recordings cannot be kept in" in check_site(tmp_path / "site.toml")["problem"]
    done = CliRunner().invoke(app, ["site", "check", str(tmp_path / "site.toml")])
    assert done.exit_code == 2
    assert "recording.folder" in done.output


def test_matrices_u_and_y_of_a_mat_file_with_their_sample_time(tmp_path: Path):
    u, y = LOG_COLUMNS
    savemat(tmp_path / "log.mat", {"u": u[:, None], "y": np.column_stack([y, 2 * y]), "Ts": 0.1})
    document = init_files(tmp_path / "log.mat")
    assert [c["signal"] for c in document["columns"]] == ["u_u", "y_1", "y_2"]
    assert document["sample_time"] == 0.1
    assert load(tmp_path / "log.mat", model=read_model(document["model"]))[0].dt == 0.1  # the matrices are the model's signals in order, without the mapping too


def test_columns_that_are_counted_get_role_time_and_unit_from_the_command_line(tmp_path: Path):
    u, y = LOG_COLUMNS
    (tmp_path / "log.csv").write_text("".join(f"{100 * k},{u[k]},{y[k]}\n" for k in range(len(u))))
    document = init_files(tmp_path / "log.csv", answers=Answers(["2"], ["3"], {"1": "ms", "2": "V", "3": "rpm"}))
    assert [c["signal"] for c in document["columns"]] == ["u_2", "y_3"]
    assert document["sample_time"] == pytest.approx(0.1)


@pytest.mark.parametrize("every", [2, 3])
def test_columns_of_two_rates_in_one_table(tmp_path: Path, every: int):
    """A logger that writes a row for every fast sample leaves the slow column's cells empty: it has times of its own."""
    u, y = (np.repeat(c, every) for c in LOG_COLUMNS)
    (tmp_path / "log.csv").write_text("t,U_V,n_rpm\n" + "".join(f"{k / 100:g},{u[k]},{'' if k % every else y[k]}\n" for k in range(len(u))))
    document = init_files(tmp_path / "log.csv")
    assert document["sample_time"] == pytest.approx(every / 100)
    assert document["fits"]["n"]["r2"] > 0.8


def test_the_first_model_is_of_the_longest_stretch_without_an_empty_cell(tmp_path: Path):
    u, y = LOG_COLUMNS
    rows = [f"{k / 10},{u[k]},{'' if k in (40, 45) else y[k]}\n" for k in range(len(u))]
    (tmp_path / "log.csv").write_text("t,U_V,n_rpm\n" + "".join(rows))
    assert init_files(tmp_path / "log.csv")["fits"]["n"]["r2"] > 0.8
    rows = [f"{k / 10},{u[k]},{y[k] if k % 40 else ''}\n" for k in range(len(u))]
    (tmp_path / "short.csv").write_text("t,U_V,n_rpm\n" + "".join(rows))
    with pytest.raises(BadInput, match=r"39 rows in a row have a number in every input and output; expected at least 50"):
        init_files(tmp_path / "short.csv", tmp_path / "short")
