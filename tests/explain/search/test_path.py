"""The fits along the horizons: where they begin, which hypotheses go on to the next, in finer steps."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np

from afdsvc.api.physics import Hypothesis
from afdsvc.dataset.experiment import prepare
from afdsvc.explain.search import path
from afdsvc.explain.search.base import settled
from afdsvc.explain.search.build import build
from afdsvc.explain.search.fit import fit
from afdsvc.explain.search.machine import hypotheses, machine
from afdsvc.explain.search.path import Trial, bases, kept_promises, promising, trial
from afdsvc.explain.search.screen import Screened, Start
from afdsvc.explain.settings import Settings
from afdsvc.explain.simulate.effects import PlacedEffect
from afdsvc.explain.simulate.nominal import nominal
from afdsvc.plugins.physics.coulomb_friction import CoulombFriction
from tests.explain import motor


def problem(friction):
    runs = prepare(motor.model(), [motor.recording(friction, s, name=f"r{s}") for s in (1, 2)])
    return build(nominal(motor.model(), runs[0].dt), runs, Settings())


def test_where_the_model_was_bent_hypotheses_begin_at_the_stated_numbers_too():
    p = problem(60.0)
    bent = fit(p, replace(p.start(), theta=np.full(len(p.start().theta), 20.0)), 0.0, 5.0, iterations=0)
    h = next(iter(hypotheses([CoulombFriction()], machine(p, bent, 0.0, [], [], "model"))))
    start = Start(PlacedEffect(h, np.array(h.starts[0], float)), 0.0, np.zeros(0), np.zeros(len(bent.H)))
    screened = {0.0: Screened(h, (start,))}
    begin = [bases(replace(p, settings=Settings(implausible=s)), {0.0: bent}, {0.0: 5.0}) for s in (5.0, np.inf)]
    falls = [trial(p, b, {0.0: 5.0}, screened, 1).falls[0] for b in begin]
    assert falls[0] > falls[1] + 10.0


def tried(name, *falls, shape=""):
    return Trial(Hypothesis(name, "machine", "", "force", None, (), (), (), (), notes={"variant": shape, "of": shape}), (), falls)


def test_what_chance_cannot_separate_on_the_beginnings_is_fitted_to_whole_recordings():
    chosen = promising([tried("a", 10.0), tried("b", 8.5), tried("c", 7.9)], 1, 4.0)
    assert [t.hypothesis.physics for t in chosen] == ["a", "b"]


def test_shapes_of_one_law_do_not_crowd_out_others():
    """The second number is the fall that decides; of the strongest correction half as many are added."""
    shapes = [tried("drift", 1.0, 50.0 - k, shape=f"of {k}") for k in range(6)]
    lag, late, last = tried("lag", 2.0, 30.0), tried("delay", 9.0, 1.0), tried("mode", 8.0, 2.0)
    chosen = promising([*shapes, lag, late, last], 2, 4.0)
    assert chosen == [*shapes[:2], lag, late]
    apart = [tried("drift", 1.0, 50.0 - 10 * k, shape=f"of {k}") for k in range(3)]  # the second is beyond chance of the first
    assert promising([*apart, lag, late], 2, 4.0) == [*apart[:2], lag, late]


def test_the_runner_up_of_another_mechanism_is_fitted_to_whole_recordings_however_far_behind_it_is():
    def fitted(key, cost, shape=""):
        hypothesis = Hypothesis(key, "machine", "", "force", None, (), (), (), (), notes={"variant": shape, "of": ""})
        return {0.0: SimpleNamespace(cost=cost, point=SimpleNamespace(effects=(SimpleNamespace(hypothesis=hypothesis),)))}

    paths = [fitted("first", 0.0), fitted("first", 20.0, "of another shape"), fitted("first", 95.0, "of a third"), fitted("second", 90.0), fitted("third", 99.0)]
    base = {0.0: SimpleNamespace(cost=100.0)}
    assert kept_promises(base, paths, 0.5, "model") == [*paths[:2], paths[3]]
    assert kept_promises(base, paths[:3], 0.5, "model") == paths[:2]
    assert kept_promises(base, [], 0.5, "model") == []


def test_in_finer_steps_a_fit_begins_where_the_one_before_it_ended_if_it_is_lost(monkeypatch):
    """The last fit has friction so large that the motor sticks; the one that is corrected strongly has the right one."""
    p = problem(60.0)
    (alone,) = settled(p).start.values()
    start = {0.01: alone, 0.0: alone}
    (h,) = [h for h in hypotheses([CoulombFriction()], machine(p, start[0.0], 0.0), False) if h.key == "coulomb_friction@state:speed"]
    begun = []

    def only_begun(problem, point, horizon, tau, **rest):
        begun.append((horizon, problem.substeps, point.effects[0].values[0]))
        return replace(start[horizon], point=point)

    monkeypatch.setattr(path, "fit", only_begun)
    rough = {k: replace(f, point=f.point.added(PlacedEffect(h, np.array([60.0 if k else 1e5, 1.0])))) for k, f in start.items()}
    finer = replace(p, substeps=path.FINER)
    path.refined(finer, finer, dict.fromkeys(start, 1.0), {0.0: rough[0.0]}, rough)
    assert begun == [(k, path.FINER, 60.0) for k in (*start, 0.0)]
