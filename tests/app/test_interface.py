"""The Python interface: every name has a docstring whose example runs, and the page of the interface runs as it is printed."""

from __future__ import annotations

import doctest
import importlib
import inspect
import io
import re
import subprocess
import sys
from contextlib import redirect_stdout
from pathlib import Path
from types import SimpleNamespace

import control
import numpy as np
import pandas as pd
import pytest
import scipy.signal

import afdsvc
from afdsvc.app.answers import Checked, Diagnosed, Explained, Identified
from afdsvc.errors import BadInput

ROOT = Path(__file__).parents[2]
RECORDING = str(next(iter(sorted((ROOT / "recordings" / "shipped").glob("*.mcap")))))
WITH_EXAMPLES = ("afdsvc.app.interface", "afdsvc.api.model", "afdsvc.api.signals", "afdsvc.errors", "afdsvc.lti.transfer_function", "afdsvc.present.text_plot")


@pytest.mark.parametrize("module", WITH_EXAMPLES)
def test_examples_of_docstrings_run(module, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    said = io.StringIO()
    with redirect_stdout(said):
        done = doctest.testmod(importlib.import_module(module), extraglobs={"RECORDING": RECORDING, "np": np}, optionflags=doctest.ELLIPSIS)
    assert done.attempted > 0
    assert done.failed == 0, said.getvalue()


@pytest.mark.parametrize("name", afdsvc.__all__)
def test_every_name_is_documented_the_numpy_way(name):
    thing = getattr(afdsvc, name)
    said = inspect.getdoc(thing) or ""
    error = inspect.isclass(thing) and issubclass(thing, Exception)  # made from a message
    for section in ("Examples",) if error else ("Parameters", "Examples") if inspect.isclass(thing) else ("Parameters", "Returns", "Examples"):
        assert re.search(rf"^{section}\n-+$", said, re.MULTILINE), f"{name} lacks {section}"
    for parameter in () if error else inspect.signature(thing).parameters:
        assert re.search(rf"^(\*\*?)?(\w+, )*{parameter}\b", said, re.MULTILINE), f"{name}: {parameter}"


def test_help_of_the_package_begins_with_its_use():
    use, _, packages = (inspect.getdoc(afdsvc) or "").partition("The packages below")
    assert set(re.findall(r"^    (?:\w+ = )?afdsvc\.(\w+)", use, re.MULTILINE)) == set(afdsvc.__all__) - {"BadInput", "Trace", "load"}
    assert "- `lti`" in packages
    assert "`lti`" not in use


def test_the_page_runs_as_it_is_printed(tmp_path, monkeypatch):
    """Every block is run in order; what follows `#>` is what the line before prints."""
    monkeypatch.chdir(tmp_path)
    text = (ROOT / "docs" / "reference" / "python.md").read_text(encoding="utf-8")
    place: dict[str, object] = {"RECORDING": RECORDING}
    blocks = re.findall(r"^```python\n(.*?)^```", text, re.MULTILINE | re.DOTALL)
    assert len(blocks) > 5
    for block in blocks:
        said = io.StringIO()
        with redirect_stdout(said):
            exec(compile(block, "python.md", "exec"), place)
        printed = [line.removeprefix("#> ") for line in block.splitlines() if line.startswith("#> ")]
        assert said.getvalue().splitlines() == printed


def test_importing_the_packages_leaves_the_functions():
    code = "import afdsvc.identify.pipeline, afdsvc.explain.pipeline, afdsvc; print(callable(afdsvc.identify), callable(afdsvc.explain))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["True", "True"]


def test_an_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="no attribute 'identfy'"):
        _ = afdsvc.identfy


SYSTEMS = {
    "control tf": control.tf([12.0], [0.08, 1]),
    "control ss": control.ss([[-12.5]], [[2.0]], [[75.0]], [[0.0]]),
    "control zpk": control.zpk([], [-12.5], 150.0),
    "scipy lti": scipy.signal.lti([12.0], [0.08, 1]),
    "scipy zpk": scipy.signal.ZerosPolesGain([], [-12.5], 150.0),
    "scipy ss": scipy.signal.StateSpace([[-12.5]], [[150.0]], [[1.0]], [[0.0]]),
    "num, den": ([12.0], [0.08, 1]),
    "zpk": ([], [-12.5], 150.0),
    "abcd": ([[-12.5]], [[150.0]], [[1.0]], [[0.0]]),
    "abc": ([[-12.5]], [[150.0]], [[1.0]]),
}


@pytest.mark.parametrize("kind", SYSTEMS)
def test_models_from_systems(kind):
    """Whatever the realisation, the state that makes the speed is the speed, so friction has a place."""
    model = afdsvc.Model.from_system(SYSTEMS[kind], {"voltage": "V"}, {"speed": "rad/s"})
    np.testing.assert_allclose([model.plant.A, model.plant.B, model.plant.C], [[[-12.5]], [[150.0]], [[1.0]]])
    assert [v.name for v in model.states] == ["speed"]


def test_a_discrete_system_keeps_its_sample_time():
    assert afdsvc.Model.from_system(scipy.signal.dlti([12.0], [1, -0.5], dt=0.1)).plant.dt == 0.1


@pytest.mark.parametrize(("system", "words"), [
    (control.tf([1.0], [1, -0.5], True), "sample time unspecified \\(dt=True\\); give dt in seconds"), (scipy.signal.dlti([1.0], [1, -0.5]), "dt=True"), ("motor", "is a str"), (([1.0, 2, 3], [1.0]), "degree 2")])
def test_what_is_no_system_is_named(system, words):
    with pytest.raises(BadInput, match=words):
        afdsvc.Model.from_system(system)


def test_too_many_names_are_counted():
    with pytest.raises(BadInput, match="inputs a, b: 2 names; expected 1"):
        afdsvc.Model.from_system(SYSTEMS["num, den"], ["a", "b"])


@pytest.fixture(scope="module")
def run():
    rng = np.random.default_rng(1)
    u = np.repeat(rng.uniform(-5, 5, 200), 20)
    y = scipy.signal.lfilter([0.0, 0.735], [1, -np.exp(-0.0625)], u) + 0.1 * rng.standard_normal(len(u))
    return u, y


@pytest.mark.parametrize("index", ["column", "seconds", "dates", "timedelta"])
def test_frames_of_every_kind_of_time(run, index):
    t = np.arange(len(run[0])) * 5e-3
    frame = pd.DataFrame({"voltage": run[0], "speed": run[1]})
    if index == "column":
        frame["t"] = t
    else:
        times = pd.to_timedelta(t, unit="s")
        frame.index = {"seconds": pd.Index(t), "dates": pd.Timestamp("2026-10-25T00:30Z") + times, "timedelta": times}[index]
    model = afdsvc.Model.from_system(SYSTEMS["num, den"], {"voltage": "V"}, {"speed": "rad/s"})
    found = afdsvc.check(model, frame)
    assert found.rows()[0]["r2"] > 0.99
    assert "<svg" in found._repr_html_()
    assert list(found.to_pandas()["output"]) == ["speed"]


def test_a_table_without_rows_has_its_columns():
    """Explained and consistent, diagnosed without bursts; the columns are those of rows."""
    for kind in (Explained, Diagnosed, Checked):
        empty = kind({"recordings": []}, *[SimpleNamespace(named=(), outputs=(), courses=())][: kind is not Diagnosed])
        assert tuple(empty.to_pandas().columns) == kind.COLUMNS
        assert len(empty.to_pandas()) == 0
    assert tuple(afdsvc.diagnose(RECORDING).rows()[0]) == Diagnosed.COLUMNS


def test_a_bare_system_takes_the_names_of_the_columns(run):
    data = {"t": np.arange(len(run[0])) * 5e-3, "u_voltage": run[0], "y_speed": run[1]}
    assert afdsvc.check(SYSTEMS["control tf"], data).rows()[0]["output"] == "speed"


def test_identify_in_one_line_each(run):
    one = afdsvc.identify(*run, dt=5e-3)
    several = afdsvc.identify([run[0][:2000], run[0][2000:]], [run[1][:2000], run[1][2000:]], dt=5e-3)
    kept = afdsvc.identify(run[0][:3000], run[1][:3000], dt=5e-3, holdout=(run[0][3000:], run[1][3000:]))
    frame = afdsvc.identify({"t": np.arange(len(run[0])) * 5e-3, "u_a": run[0], "y_b": run[1]})
    for found in (one, several, kept, frame):
        assert found.rows()[0]["r2"] > 0.99
        np.testing.assert_allclose(found.system.dcgain(), 12.1, rtol=0.05)
        assert "r2_before" not in found.rows()[0]
    assert frame.rows()[0]["output"] == "b"


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((np.zeros(500), np.zeros(500)), "dt is None"),
        ((np.zeros(500), np.zeros(500), "5 ms"), "dt is 5 ms; expected the sample time in seconds"),
        ((np.zeros(500), np.zeros(400), 0.1), "u has 500 samples and y 400"),
        ((np.zeros((1, 500)), np.zeros(500), 0.1), r"u is an array \(1, 500\); expected \(samples,\) or \(samples, signals\)"),
        ((["on"] * 500, np.zeros(500), 0.1), "u holds 'on'; expected real numbers"),
        (("abc", np.zeros(500), 0.1), "u holds 'abc'; expected real numbers"),
        ((np.zeros(500), np.zeros(500) + 1j, 0.1), "y holds 1j; expected real numbers"),
        (([], [], 0.1), "u is empty"),
        (([np.zeros(500)] * 2, [np.zeros(500)] * 3, 0.1), "u has 2 experiments and y 3"),
        ((3,), "recordings are a int"),
        (([],), "no recording was given"),
    ],
)
def test_what_identify_cannot_use_is_named(arguments, words):
    with pytest.raises(BadInput, match=words):
        afdsvc.identify(*arguments)


@pytest.mark.parametrize("order", ["two", 1.5, 0, -1])
def test_an_order_is_a_whole_number(run, order):
    with pytest.raises(BadInput, match=r"option order = .*; expected a whole number of at least 1"):
        afdsvc.identify(*run, dt=5e-3, order=order)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda model, frame: afdsvc.check(model, []), "no recording was given"),
        (lambda model, frame: afdsvc.check(SYSTEMS["num, den"], []), "no recording was given"),
        (lambda model, frame: afdsvc.check(model, frame.assign(operator="Jo")), "column 'operator' holds 'Jo'; expected real numbers"),
        (lambda model, frame: afdsvc.load(frame), "a recording or model is a DataFrame; expected the path of a file"),
        (lambda model, frame: afdsvc.diagnose(), "no recording was given"),
        (lambda model, frame: afdsvc.diagnose(frame), "a DataFrame carries no model; give one with model="),
        (lambda model, frame: afdsvc.diagnose(3, model=model), "recordings are a int"),
        (lambda model, frame: afdsvc.diagnose("a.csv", model=model), r"a\.csv: cannot be read"),
        (lambda model, frame: afdsvc.diagnose({"t": frame["t"], "speed": frame["speed"]}, model=model), "model 'model': the samples have no column u_voltage"),
        (lambda model, frame: afdsvc.design(3), "site is a int; expected the path of a file"),
        (lambda model, frame: afdsvc.Model.from_system(([np.nan], [1, 1])), "the system holds nan or inf"),
    ],
)
def test_what_is_no_recording_or_path_is_named(run, call, words):
    frame = pd.DataFrame({"t": np.arange(len(run[0])) * 5e-3, "voltage": run[0], "speed": run[1]})
    with pytest.raises(BadInput, match=words):
        call(afdsvc.Model.from_system(SYSTEMS["num, den"], {"voltage": "V"}, {"speed": "rad/s"}), frame)


def test_times_as_pandas_reads_them_from_a_csv_file(run):
    """`pandas.read_csv` leaves ISO times as text."""
    times = [(pd.Timestamp("2026-10-25T00:30+02:00") + pd.Timedelta(5 * k, "ms")).isoformat(timespec="milliseconds") for k in range(len(run[0]))]
    model = afdsvc.Model.from_system(SYSTEMS["num, den"], "voltage", {"speed": "rad/s"})
    assert afdsvc.check(model, pd.DataFrame({"timestamp": times, "voltage": run[0], "speed": run[1]})).rows()[0]["r2"] > 0.99


def test_a_frame_without_time_is_refused(run):
    with pytest.raises(BadInput, match="no column 't'"):
        afdsvc.check(SYSTEMS["num, den"], pd.DataFrame({"u_a": run[0], "y_b": run[1]}))


def test_where_nothing_was_tested_nothing_is_said(run):
    """No burst, and too little quiet data: that is no "no fault"."""
    found = afdsvc.diagnose({"t": 0.01 * np.arange(300), "u_a": run[0][:300], "y_b": run[1][:300]}, model=SYSTEMS["num, den"])
    assert not found.document["recordings"][0]["verdict"]["trustworthy"]
    assert "not trustworthy: nothing was tested" in repr(found)


def test_design_and_diagnosis_show_themselves():
    found = afdsvc.diagnose(RECORDING)
    assert "bearing" in found.to_pandas()["machine"].unique()
    assert "<svg" in found._repr_html_()
    assert RECORDING in repr(found)


def test_names_of_the_interface_are_listed_and_a_model_is_shown_in_a_line():
    assert {"Model", "check", "design", "diagnose", "explain", "identify", "load"} <= set(dir(afdsvc))
    motor = afdsvc.Model.from_system(([12.0], [0.08, 1]), {"voltage": "V"}, {"speed": "rad/s"})
    assert repr(motor) == "<Model 'model': inputs voltage [V]; outputs speed [rad/s]; linear of order 1, continuous>"


def test_answers_say_what_limits_them_and_what_was_done_to_the_data():
    nearest, limit = SimpleNamespace(sentence="friction would close 82 %"), "no name is certain"
    explained = Explained({}, SimpleNamespace(verdict="unexplained", named=(), candidates=(nearest,), sentences=(limit,)))
    assert explained.sentences == ("explain: unexplained", "not claimed: friction would close 82 %", limit)
    fit = SimpleNamespace(method="pem", order=1, order_reason="stated", notes=())
    result = SimpleNamespace(fit=fit, data=("samples are missing",), warnings=("samples are missing", "worse than the model given"))
    for given, said in ((True, result.warnings), (False, result.data)):
        assert Identified({}, result, given).sentences[1:] == said
