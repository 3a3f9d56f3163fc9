"""`diagnose` of tables: the controller and the noise the model states, bursts in the alpha columns."""

import json

import numpy as np
import pytest

import afdsvc
from afdsvc.api.bursts import Burst, Line
from afdsvc.app import commissioning
from afdsvc.app.diagnose import diagnose_recordings, import_recording
from afdsvc.errors import BadInput
from afdsvc.files.model.model_file import parse_model
from afdsvc.files.site import DriverSection, MachineSection
from afdsvc.lti.lft import star
from benchmarks.detection.truth import machines

TRUTH = next(m for m in machines() if m.name == "direct feedthrough")
BURST = Burst("played", 2, 2500, 125, tuple(Line(i, w + 60.0 * i, 4.0) for i in range(2) for w in (200.0, 520.0)))


def rows(a) -> str:
    return json.dumps(np.asarray(a).tolist())


def model_text(controller: bool = True) -> str:
    """MODEL.toml of the true machine."""
    K = TRUTH.A + TRUTH.B @ TRUTH.F + TRUTH.L @ (TRUTH.C + TRUTH.D @ TRUTH.F), -TRUTH.L, TRUTH.F, np.zeros((2, 2))
    keys = "".join(f"{name} = {rows(a)}\n" for name, a in zip("ABCD", K, strict=True))
    return f"""name = "truth"
time = "discrete"
sample_time = {TRUTH.dt}
inputs = [{{name = "a"}}, {{name = "b"}}]
outputs = [{{name = "c"}}, {{name = "d"}}]
A = {rows(TRUTH.A)}
B = {rows(TRUTH.B)}
C = {rows(TRUTH.C)}
D = {rows(TRUTH.D)}
[noise]
output_sd = {rows(np.sqrt(np.diag(TRUTH.R)))}
process_cov = {rows((TRUTH.Q + TRUTH.Q.T) / 2)}
""" + (f'[controller]\ntime = "discrete"\nsample_time = {TRUTH.dt}\n{keys}' if controller else "")


@pytest.fixture(scope="module")
def tables(tmp_path_factory):
    """A folder with the model, with and without its controller, and a table with two bursts on a machine whose first actuator is weak."""
    folder = tmp_path_factory.mktemp("tables")
    (folder / "stated.toml").write_text(model_text())
    (folder / "unstated.toml").write_text(model_text(controller=False))
    rest = np.zeros((3000, 2))
    alpha = np.vstack([rest, rest, rest, BURST.play(TRUTH.dt), rest, BURST.play(TRUTH.dt), rest])
    run = TRUTH.run(np.random.default_rng(4), alpha, np.array([-0.3, 0, 0, 0]))
    columns = {"t": TRUTH.dt * np.arange(len(alpha))}
    for role, names in (("u", "ab"), ("y", "cd"), ("alpha", "ab"), ("beta", "cd")):
        columns |= {f"{role}_{name}": run[role][:, i] for i, name in enumerate(names)}
    np.savez(folder / "run.npz", **columns)
    np.savez(folder / "half.npz", **{name: v for name, v in columns.items() if name != "alpha_b"})
    return folder


def decisions(document) -> dict[str, dict]:
    return {d["detector"]: d for d in document["recordings"][0]["bursts"][-1]["decisions"]}


def test_bursts_in_a_table_are_judged_in_the_stated_loop(tables):
    document = diagnose_recordings([tables / "run.npz"], tables / "stated.toml")
    found = decisions(document)
    assert [b["seconds"] for b in document["recordings"][0]["bursts"]] == [2.5, 2.5]
    assert {name: (d["detected"], d["fault"]) for name, d in found.items()} == dict.fromkeys(("matched_filter", "regression", "cusum"), (True, "a_actuator"))
    assert abs(found["regression"]["severity"]["value"] + 0.3) < 4 * found["regression"]["severity"]["sd"]


def test_an_imported_table_is_judged_like_the_table(tables, tmp_path):
    import_recording(tables / "run.npz", tmp_path / "run.mcap", tables / "stated.toml", {})
    first, second = (diagnose_recordings([p], m) for p, m in ((tables / "run.npz", tables / "stated.toml"), (tmp_path / "run.mcap", None)))
    assert decisions(first) == decisions(second)


def test_data_in_memory_are_judged_like_the_table(tables):
    """A dict of arrays and traces, with the model as an object or as a path."""
    wanted, model = decisions(diagnose_recordings([tables / "run.npz"], tables / "stated.toml")), tables / "stated.toml"
    with np.load(tables / "run.npz") as file:
        columns = dict(file)
    for data, given in ((columns, afdsvc.load(model)), (afdsvc.load(tables / "run.npz"), model)):
        found = afdsvc.diagnose(data, model=given)
        assert decisions(found.document) == wanted
    assert decisions(afdsvc.diagnose(tables / "run.npz", model=afdsvc.load(model)).document) == wanted


def test_without_the_controller_lines_are_refused_in_words_and_regression_judges(tables):
    document = diagnose_recordings([tables / "run.npz"], tables / "unstated.toml")
    found = decisions(document)
    assert "states no controller" in found["matched_filter"]["reason"]
    assert "states no controller" in found["cusum"]["reason"]
    assert (found["regression"]["fault"], document["recordings"][0]["verdict"]["fault"]) == ("a_actuator", "a_actuator")


def referenced(ref, folder, name, plain=0.0):
    """Write a table of the true machine, its first actuator weak, whose set points move by ``ref`` around ``plain``."""
    run = TRUTH.run(np.random.default_rng(4), np.zeros((len(ref), 2)), np.array([-0.3, 0, 0, 0]), ref=ref)
    columns = {"t": TRUTH.dt * np.arange(len(ref))} | {f"{role}_{c}": run[role][:, i] for role, names in (("u", "ab"), ("y", "cd")) for i, c in enumerate(names)}
    np.savez(folder / name, **columns, ref_c=run["ref"][:, 0] + plain, ref_d=run["ref"][:, 1])
    return folder / name


def test_bursts_in_the_set_points_are_found_and_judged(tables, tmp_path):
    rest = np.zeros((3000, 2))
    play = BURST.play(TRUTH.dt)
    path = referenced(np.vstack([rest, rest, rest, play, rest, play, rest]), tmp_path, "run.npz")
    (document,) = diagnose_recordings([path], tables / "stated.toml")["recordings"]
    assert [(b["input"], b["seconds"]) for b in document["bursts"]] == [("c, d", 2.5)] * 2
    found = decisions({"recordings": [document]})
    assert {name: (d["detected"], d["fault"]) for name, d in found.items()} == dict.fromkeys(("matched_filter", "regression", "cusum"), (True, "a_actuator"))
    assert abs(found["regression"]["severity"]["value"] + 0.3) < 4 * found["regression"]["severity"]["sd"]
    import_recording(path, tmp_path / "run.mcap", tables / "stated.toml", {})
    assert decisions(diagnose_recordings([tmp_path / "run.mcap"])) == found


def test_set_points_that_wander_are_no_burst(tables, tmp_path):
    ref = np.vstack([np.zeros((3000, 2)), np.cumsum(np.random.default_rng(1).normal(size=(6000, 2)), axis=0)])
    path = referenced(ref, tmp_path, "wander.npz")
    (document,) = diagnose_recordings([path], tables / "stated.toml")["recordings"]
    assert document["bursts"] == []


def test_half_of_the_excitation_is_refused(tables):
    with pytest.raises(BadInput, match="alpha_a; expected alpha_a, alpha_b"):
        diagnose_recordings([tables / "half.npz"], tables / "stated.toml")


def test_a_watched_machine_has_the_controller_and_the_noise_its_model_states(plugins):
    model = parse_model(model_text(), "model.toml")
    columns = tuple(commissioning._channels(model.inputs, model.outputs, "alpha", False))
    config = MachineSection(id="m", model="model.toml", driver=DriverSection(kind="replay", recording="run.npz"))
    made = commissioning.commission(config, plugins, commissioning.RecordedMachine(model, TRUTH.dt, columns))
    problem = commissioning.problem(made, made.noise, commissioning.FalseAlarms())
    loop = star(problem.plant, problem.interconnection, 2, 2)
    A = np.block([[TRUTH.A, TRUTH.B @ TRUTH.F], [-TRUTH.L @ TRUTH.C, TRUTH.A + TRUTH.B @ TRUTH.F + TRUTH.L @ TRUTH.C]])
    fastest = np.sort(np.abs(np.linalg.eigvals(A)))[::-1]
    assert np.sort(np.abs(loop.poles()))[::-1][:4] == pytest.approx(fastest[:4], rel=1e-6)
    assert problem.loop_known
    assert np.allclose(problem.process_cov, TRUTH.Q)
    other = parse_model(model_text().replace(f"D = {rows(np.zeros((2, 2)))}", f"D = {rows(1e3 * np.ones((2, 2)))}"), "model.toml")
    with pytest.raises(BadInput, match=r"\[controller\].*state the controller that ran"):
        commissioning.commission(config, plugins, commissioning.RecordedMachine(other, TRUTH.dt, columns))


@pytest.mark.parametrize(("detectors", "samples", "tested"), [((), 9000, True), (("regression",), 9000, False), ((), 500, False)])
def test_a_healthy_machine_without_a_burst_is_tested_where_a_passive_detector_had_quiet_data(tables, tmp_path, detectors, samples, tested):
    run = TRUTH.run(np.random.default_rng(5), np.zeros((samples, 2)), np.zeros(4))
    columns = {f"{role}_{name}": run[role][:, i] for role, names in (("u", "ab"), ("y", "cd")) for i, name in enumerate(names)}
    np.savez(tmp_path / "quiet.npz", t=TRUTH.dt * np.arange(samples), **columns)
    (found,) = diagnose_recordings([tmp_path / "quiet.npz"], tables / "stated.toml", detectors=detectors)["recordings"]
    assert (found["passive"], found["verdict"]["fault"], found["verdict"]["trustworthy"]) == ([], None, tested)
    assert found["verdict"]["reason"].startswith("nothing was tested") is not tested
