"""What people read in a terminal: nothing of a name, path or sentence is taken for a style."""

from __future__ import annotations

from afdsvc.present import terminal


def test_brackets_and_colons_are_printed_as_they_are():
    row = {"name": "mine", "asked": "J_K takes [y, alpha] :warning:", "failure": "found [bold], wanted [/]"}
    with terminal.OUT.capture() as seen:
        terminal.check_table([row, row | {"failure": ""}])
        terminal.plugin_table([{"family": "[red]", "name": "a[1]", "summary": "", "plugin": "p"}], {"b[2]": "no [blue] module"})
    words = " ".join(seen.get().split())
    for text in ("[y, alpha] :warning:", "[bold]", "[/]", "[red]", "a[1]", "b[2] could not be loaded: no [blue] module"):
        assert text in words


def test_an_alarm_that_follows_from_another_shows_which_in_the_place_of_its_state():
    alarm = dict.fromkeys(("acknowledged", "latched", "confirmed"), False) | dict.fromkeys(("comment", "acknowledged_by", "confirmed_by", "shelved_by", "cause"), "")
    alarm |= {"kind": "fault", "active": True, "since_ns": 0, "shelved_until_ns": 0, "count": 1, "sentence": "", "severity": {"value": -0.065, "sd": 0.003}}
    alarms = [alarm | {"id": "m/sensor", "suppressed": ""}, alarm | {"id": "m/unnamed", "suppressed": "follows from m/sensor"}]
    with terminal.OUT.capture() as seen:
        terminal.alarm_table(alarms)
    rows = [line for line in seen.get().splitlines() if line.startswith(" m/")]
    assert ["active" in row for row in rows] == [True, False]
    assert ["-6.5" in row for row in rows] == [True, False]
    assert "follows from" in rows[1]
