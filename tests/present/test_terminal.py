"""What people read in a terminal: nothing of a name, path or sentence is taken for a style."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from afdsvc.present import terminal


def test_brackets_and_colons_are_printed_as_they_are():
    row = {"name": "mine", "asked": "J_K takes [y, alpha] :warning:", "failure": "found [bold], wanted [/]"}
    with terminal.OUT.capture() as seen:
        terminal.check_table([row, row | {"failure": ""}])
        terminal.plugin_table([{"family": "[red]", "name": "a[1]", "summary": "", "plugin": "p"}], {"b[2]": "no [blue] module"})
    words = " ".join(seen.get().split())
    for text in ("[y, alpha] :warning:", "[bold]", "[/]", "[red]", "a[1]", "b[2] could not be loaded: no [blue] module"):
        assert text in words


@pytest.mark.parametrize(("trustworthy", "words"), [(True, "verdict: no fault"), (False, "verdict: not trustworthy: nothing was tested")])
def test_where_nothing_was_tested_no_fault_is_no_verdict(trustworthy, words):
    verdict = {"fault": None, "first_detected_s": None, "severity": None, "weights": {}, "trustworthy": trustworthy, "reason": "" if trustworthy else "nothing was tested"}
    with terminal.OUT.capture() as seen:
        terminal.diagnosis_table({"recordings": [{"recording": "r", "machine": "m", "bursts": [], "passive": [], "promised_alarms": {}, "watched_s": 3.0, "notes": [], "remarks": [], "verdict": verdict}]})
    assert words in " ".join(seen.get().split())


ALARM = (
    dict.fromkeys(("acknowledged", "latched", "confirmed"), False)
    | dict.fromkeys(("comment", "acknowledged_by", "confirmed_by", "shelved_by", "cause", "suppressed", "sentence"), "")
    | {"machine": "m", "kind": "fault", "active": True, "since_ns": 0, "shelved_until_ns": 0, "count": 1, "severity": {"value": -0.065, "sd": 0.003}}
)


def table_of(alarms: list) -> str:
    with terminal.OUT.capture() as seen:
        terminal.alarm_table(alarms)
    return seen.get()


def test_an_alarm_that_follows_from_another_shows_which_in_the_place_of_its_state():
    rows = table_of([ALARM | {"id": "m/sensor"}, ALARM | {"id": "m/unnamed", "suppressed": "follows from m/sensor", "cause": "m/sensor"}]).splitlines()
    rows = [line for line in rows if line.startswith(" m/")]
    assert ["active" in row for row in rows] == [True, False]
    assert ["-6.5" in row for row in rows] == [True, False]
    assert "follows from" in rows[1]


def test_an_output_is_shown_about_the_means_with_what_lies_between_them_and_times_of_another_day_from_the_start():
    t = 1.79e9 + 0.01 * np.arange(300)
    y = np.sin(t)
    shown = SimpleNamespace(
        output="speed", unit="rpm", t=t, measured=y, simulated=y, offset=500.0, r2=-4.7e7, gain=1.0, delay=0.0, how="simulated from the inputs"
    )
    document = {"data": [], "identify": {"sentence": ""}, "explain": {"axes": [], "tried": [], "not_tried": {}}, "report": "page.html"}
    with terminal.OUT.capture() as seen:
        terminal.show_check(SimpleNamespace(findings=(), outputs=(shown,)), document)
        terminal.show_check(SimpleNamespace(findings=(), outputs=(SimpleNamespace(**{**vars(shown), "offset": 0.0, "r2": 0.5, "t": t - 1.79e9}),)), document)
    far, near = (line for line in seen.get().splitlines() if line.startswith("speed [rpm]"))
    assert far.endswith("s, simulated from the inputs: R2 below -1000, gain 1, means 500 rpm apart (left out of both)")
    assert float(far.split()[2]) < 3
    assert far.split()[2:5] == near.split()[2:5]
    assert near.endswith("R2 0.500, gain 1")


@pytest.mark.parametrize("width", [40, 80, 120])
def test_the_state_of_an_alarm_says_what_people_did_and_names_are_not_broken_or_cut_off(width, monkeypatch):
    monkeypatch.setattr(terminal.OUT, "width", width)
    machine = ALARM | {"machine": "bearing"}
    cause = {"suppressed": "follows from bearing/horizontal_actuator", "cause": "bearing/horizontal_actuator"}
    done = ({"acknowledged": True, "shelved_until_ns": 5}, {"acknowledged": True}, {"acknowledged": True, "confirmed": True}, {}, cause)
    names = ("shelved", "horizontal_actuator", "confirmed", "vertical_sensor", "unnamed")
    said = table_of([machine | {"id": f"bearing/{name}"} | what for name, what in zip(names, done, strict=True)])
    table = said.partition("\nbearing/")[0]
    if width >= 80:
        rows = [line.split() for line in table.splitlines() if line.startswith(" bearing/")]
        assert [row[:2] for row in rows] == [
            ["bearing/vertical_sensor", "active"], ["bearing/unnamed", "follows"], ["bearing/horizontal_actuator", "acknowledged"],
            ["bearing/confirmed", "confirmed"], ["bearing/shelved", "shelved"],
        ]  # fmt: skip
        assert table.split().count("horizontal_actuator") == 1  # what 'unnamed' follows from
        assert {"1970-01-01", "-6.5"} <= set(table.split())
    else:  # a name that fits nowhere is folded
        assert "".join(row[1:].split("  ")[0].strip() for row in table.splitlines()[4:]).count("bearing/horizontal_actuator") == 1
