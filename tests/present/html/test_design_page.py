"""The design sheet as a page."""

from html.parser import HTMLParser

import numpy as np

from afdsvc.api.detection import FalseAlarms
from afdsvc.excite.design_sheet import design_sheet
from afdsvc.excite.diagnosis_burst import default_burst
from afdsvc.excite.loop_sheet import loop_sheet
from afdsvc.lti.statespace import StateSpace
from afdsvc.present.html.design_page import design_page
from afdsvc.testing.machines import bearing_problem


class Counter(HTMLParser):
    def __init__(self):
        super().__init__()
        self.count, self.words, self.outside = {}, [], []

    def handle_starttag(self, tag, attrs):
        self.count[tag] = self.count.get(tag, 0) + 1
        self.outside += [v for k, v in attrs if k in ("src", "href") and v and v.startswith("http")]

    def handle_data(self, data):
        self.words.append(data)


def test_the_page_is_self_contained_and_says_what_the_sheet_says():
    problem = bearing_problem("proportional")
    burst = default_burst(problem, problem.limits, output_amplitude=0.2)
    sheet = design_sheet(problem, [burst], {"matched_filter": FalseAlarms(1e-3)}, 60.0)
    page = Counter()
    K = StateSpace.gain(0.2 * np.eye(2), problem.plant.dt)
    whole = sheet | {"loop": loop_sheet(problem, burst, K)}
    page.feed(design_page(problem, burst, whole, controller=K))
    assert "Between bursts: no rate can be promised." in design_page(problem, burst, whole | {"unpromised": "no rate can be promised"}, controller=K)
    assert page.count["svg"] == 2 * 9  # wide and for phones
    assert not page.outside
    assert "Stable from -0.66 to 2.04 times" in " ".join(" ".join(page.words).split())
    text = " ".join(" ".join(page.words).split())
    assert "This burst does not distinguish" in text
    assert "Between bursts:" not in text
    smallest = {f["fault"]: f["smallest_detectable"] for f in sheet["faults"]}
    for fault in problem.fault_names:
        assert f"{fault} from {100 * abs(smallest[fault]):.2g} %" in text
    for fault in problem.fault_names:
        assert text.count(fault) >= 4
    assert f"{sheet['thresholds']['matched_filter']:.3f}" in text
