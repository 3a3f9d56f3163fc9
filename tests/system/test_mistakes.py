"""The mistakes a new user is likeliest to make: one sentence each, with the way out, from the command that was typed."""

from __future__ import annotations

import logging
import math
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

from afdsvc import cli
from afdsvc.cli import app
from afdsvc.errors import AfdsvcError
from afdsvc.files.model.model_file import parse_model

MODEL = """name = "motor"
time = "continuous"
inputs = [{name = "voltage", unit = "V"}]
outputs = [{name = "speed", unit = "rad/s"}]
num = [3.0]
den = [0.2, 1.0]
"""
SITE = '[transport]\nlisten = ["tcp/127.0.0.1:28997"]\npatience_seconds = 0.3\n[[machines]]\nid = "bearing"\nplant = "gas_bearing"\n'
TIMES = [f"{0.01 * k + (1.0 if k > 50 else 0.0):.2f}" for k in range(100)]
ROWS = "".join(f"{0.01 * k:.2f},{math.sin(k):.3f},{math.cos(k):.3f}\n" for k in range(100))
FILES = {
    "MODEL.toml": MODEL, "typo.toml": MODEL.replace("num =", "nun ="), "site.toml": f'site = "hall"\n{SITE}', "number.toml": MODEL.replace("3.0", '"three"'),
    "fast.toml": f'site = "hall"\n{SITE}options = {{rpm = "fast"}}\n', "hours.csv": "t\n" + "".join(f"{k}\n" for k in range(100)),
    "log.csv": "Time_ms,Voltage [V],speed_rpm\n" + ROWS, "bare.csv": ROWS, "words.csv": "t,u_voltage,y_speed\n0.00,1,2\n0.01,off,2\n",
    "MODEL.json": '{"num": [3.0]}', "commas.csv": "t,u_voltage,y_speed\n0,00,1,2,3,4\n0,01,1,2,3,4\n",
    "thrice.csv": "t,u_voltage,u_voltage,u_voltage\n0,1,2,3\n", "gap.csv": "t,u_voltage,y_speed\n" + "".join(f"{t},1,2\n" for t in TIMES), "book.xlsx": "PK",
    "torn.csv": "t,u_voltage,y_speed\n" + "".join(f"{0.01 * k + k // 30:.2f},{k % 7},{k % 5}\n" for k in range(100)),
}  # fmt: skip


@pytest.fixture(autouse=True)
def logging_as_it_was():
    """`rig` sends log lines to a stream that ends with the command."""
    root = logging.getLogger()
    handlers, level = root.handlers[:], root.level
    yield
    root.handlers[:] = handlers
    root.setLevel(level)


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    place = tmp_path_factory.mktemp("mistakes")
    for name, content in FILES.items():
        (place / name).write_text(content)
    return place


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ("check MODEL.toml log.csv", ["log.csv: has no column 't'", "--map COLUMN=t (rename=), or let afdsvc init write a mapping file"]),
        ("check MODEL.toml bare.csv", ["bare.csv: the first row holds numbers", "--map 1=t --map 2=u_force"]),
        ("explain log.csv MODEL.toml", ["log.csv: is a recording; expected the model (MODEL.toml) here, recordings after it"]),
        ("check typo.toml gap.csv", ["typo.toml: key 'nun' is not known; is 'num' meant?"]),
        ("check MODEL.toml book.xlsx", ["book.xlsx: is a spreadsheet; expected the sheet saved as CSV"]),
        ("init book.xlsx --out new", ["book.xlsx: is a spreadsheet; expected the sheet saved as CSV"]),
        ("check MODEL.toml MODEL.json", ["is not an MCAP file: it begins with b'{", "expected an MCAP file, or a table with its own ending"]),
        ("check MODEL.toml commas.csv", ["row 1 has 6 cells; expected 3, as many as the header (commas as decimal signs need ';' between cells)"]),
        ("check MODEL.toml thrice.csv", ["column 'u_voltage' comes 3 times; expected once"]),
        ("check MODEL.toml words.csv", ["words.csv: column 'u_voltage', row 2 holds 'off'; expected a number"]),
        ("identify MODEL.toml torn.csv", ["torn.csv: the longest stretch without a gap has 30 samples", "expected at least 50"]),
        ("check MODEL.toml nowhere.csv", ["nowhere.csv: cannot be read: No such file or directory"]),
        ("check MODEL.toml", ["MODEL.toml: the model '", "(from voltage to ", "; poles ", " rad/s) is in order, but no recording is given to compare it with"]),
        ("check site.toml gap.csv", ["site.toml: is a site file; expected a model (MODEL.toml)"]),
        ("design MODEL.toml", ["MODEL.toml: is a model (MODEL.toml); expected a site file"]),
        ("diagnose gap.csv", ["gap.csv: a table carries no model; give one with --model MODEL.toml (model=)"]),
        ("review log.csv", ["log.csv: is a table; expected a recording, which 'afdsvc import log.csv -o log.mcap' makes of it"]),
        ("design fast.toml", ["plant 'gas_bearing': option 'rpm' is 'fast'; expected a number"]),
        ("init hours.csv --step 1 --out new", ["expected --input COLUMN, but it has no column beside the time"]),
        ("check number.toml gap.csv", ["number.toml: key 'num[0]' is 'three'; expected a number"]),
        ("recover nowhere.mcap", ["nowhere.mcap: cannot be read: No such file or directory; expected a recording"]),
        ("status", ["no service answers at tcp/127.0.0.1:28997; start it with 'afdsvc serve'"]),
        ("alarms site.toml", ["'site.toml' is not an alarm; the site file is given as --site site.toml"]),
        ("rig site.toml --machine bering", ["site.toml: no machine 'bering'; it has bearing"]),
        ("demo --plant gasbearing", ["there is no plant 'gasbearing'; there are amb_turboexpander, gas_bearing"]),
        ("demo --fault actuator=50%", ["--fault 'actuator=50%': expected NAME=SEVERITY@SECONDS, for example horizontal_actuator=-0.5@12"]),
        ("inject bearing horizontal_actuator", ["expected FAULT=SEVERITY, for example horizontal_actuator=-0.3"]),
    ],
)  # fmt: skip
def test_a_mistake_is_named_with_the_way_out(folder, monkeypatch, arguments, words):
    monkeypatch.chdir(folder)
    found = CliRunner().invoke(app, arguments.split()).exception
    assert isinstance(found, AfdsvcError), found
    assert "\n" not in str(found)
    assert all(word in str(found) for word in words), str(found)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (('[{name = "voltage", unit = "V"}]', '["voltage"]'), "key 'inputs[0]' is 'voltage'; expected a table such as {name = \"voltage\", unit = \"V\"}"),
        (('[{name = "voltage", unit = "V"}]', '"voltage"'), "key 'inputs' is 'voltage'; expected a list, each entry a table such as {name = "),
        (("[3.0]", "100"), "key 'num' is 100; expected a list of coefficients, highest power first, such as [0.08, 1]"),
        (("[3.0]", '["a"]'), "key 'num[0]' is 'a'; expected a number"),
        (("[0.2, 1.0]\n", '[0.2, 1.0]\n[parameters]\nm = "heavy"\n'), "key 'parameters.m' is 'heavy'; expected a number, text such as \"1.2 kg +- 5 %\", or a table such as {value = 1.2, unit = \"kg\"}"),
        (("[0.2, 1.0]\n", "[0.2, 1.0]\n[noise]\noutput_sd = 0.1\n"), "key 'noise.output_sd' is 0.1; expected a list of numbers, one for each output"),
        (("[0.2, 1.0]\n", "[0.2, 1.0]\n[noise]\noutput_sd = [0]\n"), "key 'noise.output_sd[0]' is 0; expected a number above 0"),
        (("[0.2, 1.0]\n", "[0.2, 1.0]\n[perturbation]\nsamples = 3.5\n"), "key 'perturbation.samples' is 3.5; expected a whole number"),
        (("[0.2, 1.0]\n", "[0.2, 1.0]\nnoise = 3\n"), "key 'noise' is 3; expected a table with the keys output_sd, process_cov"),
        (('"motor"', "3"), "key 'name' is 3; expected text"),
        (("num = [3.0]\nden = [0.2, 1.0]", "A = 3\nB = [[1]]\nC = [[1]]"), "key 'A' is 3; expected a list of rows, such as [[0, 1], [-4, -2]]"),
        (("num = [3.0]\nden = [0.2, 1.0]", "A = [[1]]\nB = [1250]\nC = [[1]]"), "expected rows: [[1250]] is one row and one column, [[1250, 0]] is one row, [[1250], [0]] one column"),
        (("num = [3.0]\nden = [0.2, 1.0]", "poles = [[1]]\ngain = 1"), "key 'poles[0]' is [1]; expected a number"),
    ],
)  # fmt: skip
def test_a_wrong_kind_of_value_is_named_without_the_words_of_the_parser(change, words):
    with pytest.raises(AfdsvcError) as error:
        parse_model(MODEL.replace(*change), "MODEL.toml")
    assert f"MODEL.toml: {words}" in str(error.value) or (words.startswith("expected") and words in str(error.value)), str(error.value)


def test_a_path_that_cannot_be_used_is_one_sentence(monkeypatch, capsys):
    """Whatever part of a command meets it."""

    def missing(**_: object) -> None:
        Path("/nowhere/at/all").read_text()

    monkeypatch.setattr(cli, "end_on_interrupt", lambda: None)
    monkeypatch.setattr(cli, "app", missing)
    with pytest.raises(SystemExit) as end:
        cli.run_cli()
    assert end.value.code == 2
    assert capsys.readouterr().err == "afdsvc: /nowhere/at/all: no such file or directory; expected a path that can be read or written\n"


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("explain --nosuch", "no such option: --nosuch (Possible options: --out); 'afdsvc explain --help' says what is expected"),
        ("explain", "missing argument 'MODEL.toml'; 'afdsvc explain --help' says what is expected"),
        ("explian", "no such command 'explian'"),
        ("status a b", "got unexpected extra argument"),
        ("explain m.toml --jobs x", "invalid value for '--jobs': "),
        ("explain m.toml a.csv --jobs 0", "invalid value for '--jobs': "),
    ],
)
def test_wrong_usage_is_one_sentence(monkeypatch, capsys, words, said):
    monkeypatch.setattr(cli, "end_on_interrupt", lambda: None)
    monkeypatch.setattr(sys, "argv", ["afdsvc", *words.split()])
    with pytest.raises(SystemExit) as end:
        cli.run_cli()
    assert end.value.code == 2
    (sentence,) = capsys.readouterr().err.splitlines()
    assert sentence.startswith(f"afdsvc: {said}")


def test_no_words_at_all_show_the_help(monkeypatch, capsys):
    monkeypatch.setattr(cli, "end_on_interrupt", lambda: None)
    monkeypatch.setattr(sys, "argv", ["afdsvc"])
    with pytest.raises(SystemExit) as end:
        cli.run_cli()
    assert end.value.code == 2
    assert "Usage: afdsvc" in capsys.readouterr().out


def test_a_batch_in_which_every_recording_fails_fails(folder):
    done = CliRunner().invoke(app, ["batch", "diagnose", str(folder / "book.xlsx"), "-o", str(folder / "found.parquet")])
    assert done.exit_code == 2
