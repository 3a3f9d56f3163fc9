"""What people ask first is answered in words that follow from the evidence."""

from __future__ import annotations

import pytest

from afdsvc.present.rerun.log import ReviewLog


def shown(log_file, entity, rrd, component):
    return [v for _, v in rrd(log_file).rows(entity, component)]


@pytest.fixture
def answers(tmp_path, blocks, finding, rrd):
    def made(*findings):
        log = ReviewLog(tmp_path / "a.rrd")
        log.block(blocks(1)[0])
        for f in findings:
            log.finding(f)
        log.close()
        return rrd(tmp_path / "a.rrd")

    return made


def test_before_any_decision_that_is_said(answers):
    [words] = [v for _, v in answers().rows("/m1/answer", "TextDocument:text")]
    assert words.startswith("## No decision yet")


def test_a_named_fault_is_reported_with_since_part_severity_and_certainty(answers, finding):
    file = answers(finding(2.0, 3.0, burst="b1"), finding(7.0, 41.0, burst="b2", weights={"sensor": 0.999, "pump": 0.001}))
    reported = [v for _, v in file.rows("/m1/answer", "TextDocument:text")]
    assert reported[1].startswith("## Nothing is wrong")
    assert "1 burst judged" in reported[1]
    for words in (
        "## Fault: sensor",
        "**Since** 7.0 s",
        "**Which part** sensor",
        "-50.0 % (±10.0 %)",
        "sensor 99.9 %",
        "1 of 1 decisions",
        "2 bursts",
    ):
        assert words in reported[2]
    assert [(t // 10**9, v) for t, v in file.rows("/m1/severity/sensor")] == [(7, -50.0)]
    assert [v for _, v in file.rows("/m1/severity/sensor_low")] == [-70.0]
    assert [v for _, v in file.rows("/m1/sure/sensor")] == [pytest.approx(99.9)]


def test_a_cause_left_open_names_the_suspects(answers, finding):
    weights = {"pump": 0.3, "sensor": 0.6, "none_of_these": 0.1}
    file = answers(finding(2.0, 41.0, burst="b1", fault=None, weights=weights))
    reported = [v for _, v in file.rows("/m1/answer", "TextDocument:text")][-1]
    assert "## A fault, cause open" in reported
    assert "**Which part** sensor or pump" in reported
    assert "none of these 10 %" in reported


def test_what_cannot_be_trusted_is_not_called_healthy(answers, finding):
    file = answers(finding(2.0, 3.0, burst="b1", trustworthy=False, reason="the quiet residual is not white"))
    reported = [v for _, v in file.rows("/m1/answer", "TextDocument:text")][-1]
    assert reported == "## No answer\n\nthe quiet residual is not white"


def test_an_early_decision_without_a_name_does_not_shake_the_certainty(answers, finding):
    sure, early = {"sensor": 1.0}, {"sensor": 0.5, "pump": 0.5}
    file = answers(
        finding(2.0, 41.0, burst="b1", weights=sure), finding(7.0, 12.0, burst="b2", fault=None, severity=None, weights=early),
        finding(8.0, 41.0, burst="b2", weights=sure),
    )  # fmt: skip
    assert [v for _, v in file.rows("/m1/sure/sensor")] == [100.0, 100.0]
