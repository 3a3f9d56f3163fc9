"""From files to files: the document, the page, the improved model, the Rerun file, and one sentence for whatever is wrong."""

from __future__ import annotations

import json
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest

from afdsvc.api.model import Model, Variable
from afdsvc.app.explain import ExplainOptions, aux_means, explain_files, load_library, parallel, traces
from afdsvc.errors import BadInput
from afdsvc.files.model.model_file import read_model, write_model
from afdsvc.files.open import open_model
from afdsvc.files.tables.tables import import_table, read_table
from afdsvc.lti.statespace import StateSpace
from afdsvc.present.html import explain_page
from afdsvc.present.terminal import explain_table

DT, PERIOD = 2e-3, 500
SHOWN, PAGES = explain_page.explain_page, []  # what pages were made of
PHYSICS = {"coulomb_friction", "cubic_stiffness", "dead_zone", "parameter_change", "quadratic_stiffness", "sensor_lag"}  # the way from files to files, not the search


def spring() -> Model:
    plant = StateSpace(np.array([[0, 1.0], [-1e4, -20]]), np.array([[0.0], [1e4]]), np.array([[1.0, 0]]), np.zeros((1, 1)))
    states = (Variable("q", "mm"), Variable("v", "mm/s", rate_of="q"))
    return Model("spring", (Variable("force", "N"),), (Variable("position", "mm"),), states, plant)


def record(path: Path, level: float, seed: int, cube: float) -> Path:
    """A spring that hardens, integrated by Runge-Kutta in four steps a sample, written as a table."""
    rng = np.random.default_rng(seed)
    lines = np.array([k for i, k in enumerate(range(1, 50, 2)) if i % 4 != 3])
    t = np.arange(PERIOD) * DT
    u = np.cos(2 * np.pi * np.outer(t, lines) + rng.uniform(0, 2 * np.pi, len(lines))).sum(1)
    u = np.tile(level * u / u.std(), 4)
    x, y, h = np.zeros(2), [], DT / 4

    def f(x: np.ndarray, u: float) -> np.ndarray:
        return np.array([x[1], -1e4 * x[0] - 20 * x[1] + 1e4 * u - cube * x[0] ** 3])

    for value in u:
        y.append(x[0])
        for _ in range(4):
            a = f(x, value)
            b = f(x + h / 2 * a, value)
            c = f(x + h / 2 * b, value)
            x = x + h / 6 * (a + 2 * b + 2 * c + f(x + h * c, value))
    columns = np.column_stack([np.arange(len(u)) * DT, u, np.array(y) + 0.01 * rng.standard_normal(len(u))])
    np.savetxt(path, columns, delimiter=",", header="t,current,y_position", comments="")
    return path


@pytest.fixture(scope="module", autouse=True)
def few_hypotheses():
    few = [p for p in load_library() if p.name in PHYSICS]
    assert len(few) == len(PHYSICS)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("afdsvc.app.explain.load_library", lambda: few)
        yield


@pytest.fixture(scope="module")
def files(tmp_path_factory) -> tuple[Path, list[Path]]:
    folder = tmp_path_factory.mktemp("spring")
    write_model(spring(), folder / "spring.toml")
    return folder / "spring.toml", [record(folder / f"r{k}.csv", level, k, 400.0) for k, level in enumerate((1.0, 0.5, 0.75, 0.8))]


@pytest.fixture(scope="module")
def explained(files) -> tuple[dict, Path]:
    model, tables = files
    out = model.parent / "out"
    options = ExplainOptions(out, {"current": "u_force"}, rerun=out / "why.rrd")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(explain_page, "explain_page", lambda *given: PAGES.append(given) or SHOWN(*given))
        return explain_files(model, tables[:1], tables[3:], options), out


def test_a_map_within_a_map_runs_in_its_thread():
    """Both threads are busy with the outer one: waiting for a third would never end."""
    mapper = parallel(2)

    def inner(_: int) -> list[bool]:
        here = threading.current_thread().name
        return [name == here for name in mapper(lambda _: threading.current_thread().name, range(3))]

    assert list(mapper(inner, range(4))) == [[True] * 3] * 4
    assert threading.current_thread().name not in set(mapper(lambda _: threading.current_thread().name, range(4)))


def test_document_page_model_and_rerun_file_are_there(explained):
    document, out = explained
    assert document["verdict"] == "omitted_physics"
    assert document["named"][0]["physics"] == "cubic_stiffness"
    assert document["fit"]["heldout"] == ["r3.csv"]
    fit = document["fit"]["per_output"]["position"]
    assert fit["after"]["nrmse"] < 0.3 * fit["before"]["nrmse"]
    json.dumps(document, allow_nan=False)
    assert Path(document["model"]) == out / "MODEL.toml"
    assert (out / "why.rrd").stat().st_size > 10_000
    m = read_model(out / "MODEL.toml", allow_code=True)
    assert 0.04 * 0.9 < m.parameters["stiffness of cubic_stiffness at state:v"].value < 0.04 * 1.1


def test_a_model_to_which_nothing_was_added_is_not_called_improved(explained):
    pages = [SHOWN(PAGES[0][0], document) for document in (explained[0], explained[0] | {"named": []})]
    assert ["The improved model is" in page for page in pages] == [True, False]
    assert "The model without further physics is" in pages[1]


def test_the_page_says_the_verdict_first_and_shows_everything(explained):
    page = (explained[1] / "report.html").read_text()
    words = [
        "The model leaves out physics that the recordings show: cubic stiffness (force on v)", "The gap", "Fit on recordings that were held out",
        "Named physics", "The law, drawn without a name", "Where simulation and recordings differ", "Measured and simulated", "Spectrum of the residual",
        "Rejected hypotheses", "<footer>",
    ]
    places = [page.index(word) for word in words]
    assert places == sorted(places)
    assert page.count("<svg") == 2 * 3  # wide and for phones
    assert ("the green one" in page) == ("what does not repeat" in page)
    assert "http" not in page.replace("http://www.w3.org", "").replace("https://matplotlib.org", "").replace("http://purl.org", "").replace(
        "http://creativecommons.org", "")


def test_the_improved_model_is_code_that_runs_when_allowed_and_lacks_nothing(explained, files):
    model, tables, out = explained[1] / "MODEL.toml", files[1], explained[1] / "again"
    with pytest.raises(BadInput, match="permission"):
        explain_files(model, tables[:1], [], ExplainOptions(out))
    document = explain_files(model, tables[:1], tables[3:], ExplainOptions(out, {"current": "u_force"}, allow_code=True))
    left = [n["parameters"]["stiffness"]["value"] for n in document["named"] if n["physics"] == "cubic_stiffness"]
    assert sum(left) < 0.03 * 0.04  # the fit holds a force over each step, the written code does not
    first, again = (d["fit"]["per_output"]["position"]["before"]["nrmse"] for d in (explained[0], document))
    assert again < 0.1 * first


def test_a_recording_that_carries_its_model_needs_nothing_else(files, tmp_path):
    trace = read_table(files[1][0], {"current": "u_force"})
    made = import_table(trace, tmp_path / "kept.mcap", read_model(files[0]), machine="spring")
    document = explain_files(Path(made), [], [], ExplainOptions(tmp_path / "out"))
    assert document["named"][0]["physics"] == "cubic_stiffness"
    assert document["fit"]["heldout"][0].startswith("kept.mcap, ")


def test_two_files_of_one_name_stay_apart(files, tmp_path):
    other = tmp_path / "r0.csv"
    other.write_bytes(files[1][1].read_bytes())
    names = [t.name for t in traces([files[1][0], other], spring(), ExplainOptions(mapping={"current": "u_force"}))]
    assert names == ["r0.csv", "r0.csv #2"]


def test_means_of_other_signals_come_sorted(tmp_path):
    np.savez(tmp_path / "a.npz", t=np.arange(3) * 0.1, u_force=np.zeros(3), aux_b=np.array([1.0, 2, 3]), aux_a=np.ones(3))
    assert aux_means([read_table(tmp_path / "a.npz")]) == {"a": 1.0, "b": 2.0}


CURRENT = {"current": "u_force"}


@pytest.mark.parametrize(
    ("model", "tables", "options", "words"),
    [
        ("spring.toml", [], ExplainOptions(), ["spring.toml", "no recording"]),
        ("none.toml", ["r0.csv"], ExplainOptions(), ["none.toml"]),
        ("spring.toml", ["r0.csv"], ExplainOptions(), ["r0.csv", "current"]),
        ("spring.toml", ["r0.csv"], ExplainOptions(mapping={"voltage": "u_force"}), ["voltage", "current"]),
        ("spring.toml", ["r0.csv"], ExplainOptions(mapping={"current": "u_torque"}), ["u_force", "u_torque"]),
        ("spring.toml", ["none.mcap"], ExplainOptions(), ["none.mcap"]),
    ],
)
def test_bad_input_is_one_sentence(files, model, tables, options, words):
    folder = files[0].parent
    with pytest.raises(BadInput) as refusal:
        explain_files(folder / model, [folder / t for t in tables], [], options)
    sentence = str(refusal.value)
    assert "\n" not in sentence
    assert all(word in sentence for word in words)


def test_on_the_command_line_a_refusal_is_one_sentence_and_exit_2(files):
    command = [sys.executable, "-m", "afdsvc", "explain", "spring.toml", "r0.csv", "--map", "current=u_force", "--out", "spring.toml"]
    done = subprocess.run(command, cwd=files[0].parent, capture_output=True, text=True, check=False)
    assert done.returncode == 2, done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
    assert not done.stdout
    assert "--out spring.toml" in done.stderr


SHIPPED = Path(__file__).parents[2] / "recordings" / "shipped" / "gas_bearing_vertical_sensor.mcap"


@pytest.mark.filterwarnings("ignore:logm result may be inaccurate")
def test_a_recording_of_the_service_is_explained_by_its_bursts_alone(tmp_path):
    """The service kept it with its model: nothing else is asked for. What is wrong is the vertical sensor, by half."""
    document = explain_files(SHIPPED, [], [], ExplainOptions(tmp_path))
    assert document["verdict"] == "parameter_change"
    assert document["named"][0]["site"] == "output:vertical"
    gain = document["named"][0]["parameters"]["sensor gain"]
    assert abs(gain["value"] + 0.5) < 3 * gain["sd"]
    fit = document["fit"]["per_output"]
    assert fit["vertical"]["before"]["nrmse"] > 0.9
    assert fit["vertical"]["after"]["nrmse"] < 0.7 * fit["vertical"]["before"]["nrmse"]
    assert fit["horizontal"]["after"]["nrmse"] < 1.05 * fit["horizontal"]["before"]["nrmse"]
    assert document["fit"]["heldout"]


def test_quiet_samples_between_bursts_are_left_out():
    model = open_model(SHIPPED)[0]
    (burst,) = traces([SHIPPED], model, ExplainOptions())
    assert len(burst) * burst.dt == pytest.approx(2.6, abs=0.06)
    assert not burst.role("alpha")[: round(0.09 / burst.dt)].any()
    assert burst.role("alpha")[round(0.2 / burst.dt) :].any()


@pytest.mark.parametrize("floor", [None, 0.034])
def test_the_noise_floor_is_shown_where_it_is_known(explained, capsys, floor):
    document, _ = explained
    fit = document["fit"]
    outputs = {name: {**m, "noise_floor_nrmse": floor} for name, m in fit["per_output"].items()}
    changed = {**document, "fit": {**fit, "per_output": outputs}}
    explain_table(changed)
    said, page = capsys.readouterr().out, SHOWN(PAGES[0][0], changed)
    assert ("noise floor" in said) == ("0.034" in said) == (floor is not None)
    assert (">noise floor<" in page) == ("The noise floor is" in page) == (">3.4&nbsp;%<" in page or ">3.4 %<" in page) == (floor is not None)


@pytest.mark.parametrize("jobs", [0, -2])
def test_less_than_one_job_is_refused(jobs):
    with pytest.raises(BadInput, match=f"jobs: found {jobs}; expected 1 or more"):
        parallel(jobs)
