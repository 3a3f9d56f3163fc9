"""An identification as a page."""

from html.parser import HTMLParser

import numpy as np
import pytest

from afdsvc.api.model import Model
from afdsvc.api.signals import Channel, Trace
from afdsvc.identify import IdentifyOptions, identify
from afdsvc.lti.python_control import factorise
from afdsvc.lti.simulate import simulate
from afdsvc.lti.statespace import StateSpace
from afdsvc.lti.yjbk import closed_loop
from afdsvc.plants.gas_bearing import gas_bearing
from afdsvc.present.html.identify_page import identify_page

PLANT = gas_bearing(0)


class Counter(HTMLParser):
    def __init__(self):
        super().__init__()
        self.count, self.words, self.outside = {}, [], []

    def handle_starttag(self, tag, attrs):
        self.count[tag] = self.count.get(tag, 0) + 1
        self.outside += [v for k, v in attrs if k in ("src", "href") and v and v.startswith("http")]

    def handle_data(self, data):
        self.words.append(data)


@pytest.fixture(scope="module")
def result():
    true, rng, samples = PLANT.discrete(), np.random.default_rng(1), 4000
    nominal = StateSpace(0.9 * true.A, true.B, true.C, true.D, true.dt)
    controller = StateSpace.gain(0.05 * np.eye(2), true.dt)
    alpha = 2 * np.repeat(rng.choice([-1.0, 1.0], size=(samples // 4, 2)), 4, axis=0)
    d = 0.35 * rng.standard_normal((samples, 2))
    loop = closed_loop(factorise(nominal, controller), true)
    out, _ = simulate(loop.system, np.hstack([d, np.zeros((samples, 4)), alpha]))
    names = [f"{role}_{v.name}" for role, side in (("y", PLANT.outputs), ("u", PLANT.inputs)) for v in side]
    trace = Trace("run.mcap", true.dt, tuple(map(Channel, names)), out[:, 2:6])
    model = Model("bearing", PLANT.inputs, PLANT.outputs, PLANT.states, nominal, controller=controller)
    return identify(model, [trace], options=IdentifyOptions(groups=4, order=8))


def test_page_is_self_contained_and_says_what_the_document_says(result):
    page = Counter()
    page.feed(identify_page(result, "new.toml"))
    assert page.count["svg"] == 2 * 4  # wide and for phones
    assert not page.outside
    text = " ".join(" ".join(page.words).split())
    assert "new.toml" in text
    for name, m in result.after.items():
        assert name in text
        assert f"{m.r2:.4f}" in text
        assert f"{m.r2_classical:.4f}" in text
    assert result.cross_check.sentence in text
    assert "run.mcap (last 25 %)" in text
    assert "The current controller stabilises the identified plant" in text


def test_what_was_not_computed_is_left_out(result):
    from dataclasses import replace

    bare = replace(result, preview=None, cross_check=None, reductions=(), full=None,
                   fit=replace(result.fit, band=None, tests=None, singular_values=np.zeros(0)))
    page = Counter()
    page.feed(identify_page(bare))
    assert page.count["svg"] == 2
    assert "Reductions compared" not in " ".join(page.words)
