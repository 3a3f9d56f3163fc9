"""What is said where there is no fault to design Q for."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from afdsvc.api.evidence import Evidence
from afdsvc.diagnosis.alarm_book import AlarmBook, Policy
from afdsvc.diagnosis.verdict import conclude
from afdsvc.errors import Refused
from afdsvc.service.hub import Hub
from afdsvc.service.retuning import Retuning
from afdsvc.wire.messages import Finding

OPEN = Evidence("regression", "m", 0, 1.0, 9.0, 3.0, True, burst="b", weights={"sensor": 0.52, "actuator": 0.479, "pump": 0.001})
QUIET = Evidence("regression", "m", 0, 2.0, 1.0, 3.0, False, burst="c")


@pytest.mark.parametrize(("evidence", "said"), [([OPEN], r" \(the newest decision: sensor 52 %, actuator 48 %\)"), ([OPEN, QUIET], "")])
def test_a_fault_that_is_not_singled_out_is_said_while_its_alarm_is_active(evidence, said):
    book = AlarmBook(Policy(clear_after=1))
    for e in evidence:
        book.take(Finding(e, "s", 0))
    hub = SimpleNamespace(watches={"m": SimpleNamespace(verdict=lambda: conclude(evidence))}, alarms=book)
    retuning = Retuning(SimpleNamespace(session="s", machine="m"), design=None, ready=None)
    with pytest.raises(Refused, match=f"named with its severity{said}, so there is nothing"):
        retuning.ask(Hub.standing(hub, "m"), "Ada")
