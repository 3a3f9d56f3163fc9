"""From evidence to a verdict: trust first, bursts before passive detections, the strongest of the newest burst."""

from __future__ import annotations

from dataclasses import replace

from afdsvc.api.evidence import Evidence, Severity
from afdsvc.diagnosis.verdict import conclude, model_gap, open_question


def said(detector="regression", statistic=10.0, burst="b1", seconds=5.0, fault="a", detected=True, trustworthy=True, **more):
    severity = Severity(-0.5, 0.1) if fault else None
    return Evidence(
        detector,
        "m",
        0,
        seconds,
        statistic,
        4.0,
        detected,
        burst,
        fault=fault,
        severity=severity,
        weights={"a": 1.0} if fault else {"a": 0.5, "b": 0.5},
        trustworthy=trustworthy,
        reason="" if trustworthy else "not white",
    )


def test_nothing_detected_is_no_fault():
    verdict = conclude([said(detected=False, fault=None)])
    assert verdict.fault is None
    assert not verdict.detected
    assert verdict.first_detected_s is None


def test_what_is_not_trustworthy_raises_nothing_and_says_why():
    verdict = conclude([said(trustworthy=False)])
    assert not verdict.detected
    assert not verdict.trustworthy
    assert verdict.reason == "not white"


def test_the_strongest_of_the_newest_burst_names_the_fault():
    old = said(burst="b1", seconds=1.0, fault="b", statistic=99.0)
    verdict = conclude([old, said(burst="b2", statistic=10, fault="c"), said(burst="b2", statistic=20, fault="a")])
    assert verdict.fault == "a"
    assert verdict.first_detected_s == 1.0


def test_what_weighs_several_faults_decides_before_what_knows_single_ones():
    """However large their margin: a detector of single faults names one of two for sure."""
    single = said("cusum", statistic=99.0, fault="b")
    pair = replace(said(statistic=8.0, fault="a+b"), weights={"a+b": 1.0}, severity=None)
    assert conclude([pair, single]).fault == conclude([single, pair]).fault == "a+b"
    for open_ in (replace(pair, fault=None, weights={"a": 0.6, "a+b": 0.4}), replace(pair, fault=None, weights={"a": 0.6, "c": 0.4}, parts={"besides.b": -0.3})):
        for order in ([open_, single], [single, open_]):
            verdict = conclude(order)
            assert (verdict.fault, verdict.weights, verdict.detected) == (None, open_.weights, True)
    known = replace(said(statistic=7.0, fault="a"), parts={"besides.b": -0.3})
    assert conclude([known, single]).fault == "a"
    assert conclude([known, pair]).fault == "a+b"  # both weigh pairs: the larger margin


def test_the_severity_is_that_of_the_surest_decision_on_the_fault():
    strong = replace(said(statistic=99.0), severity=Severity(-0.41, 0.17))
    sure = replace(said("matched_filter", statistic=50.0), severity=Severity(-0.3, 0.01))
    other = replace(said("fault_curves", statistic=20.0, fault="c"), severity=Severity(-0.9, 0.001))
    assert conclude([strong, sure, other]).severity == sure.severity


def test_a_passive_detection_never_overrides_a_burst():
    passive = said("passive_cusum", burst="", seconds=9.0, fault=None)
    assert conclude([said(), passive]).fault == "a"
    assert conclude([passive]).weights == {"a": 0.5, "b": 0.5}


def test_a_burst_that_was_cut_does_not_override_the_one_before():
    """The sequential detector alone has judged it; it alarms before the burst is over, and names nothing."""
    whole = [said("cusum", fault=None), said("regression"), said("matched_filter")]
    cut = said("cusum", burst="b2", seconds=9.0, fault=None)
    assert conclude([*whole, cut]).fault == "a"
    rest = [replace(cut, detector=name) for name in ("regression", "matched_filter")]
    assert conclude([*whole, cut, *rest]).fault is None


def test_undecided_evidence_gives_weights_and_no_name():
    verdict = conclude([said(fault=None)])
    assert verdict.fault is None
    assert verdict.detected
    assert verdict.weights == {"a": 0.5, "b": 0.5}


def test_severities_of_bursts_that_agree_are_pooled():
    """Four independent estimates: the standard error halves."""
    verdict = conclude([said(burst=f"b{i}") for i in range(4)])
    assert abs(verdict.severity.value + 0.5) < 1e-12
    assert abs(verdict.severity.sd - 0.05) < 1e-12


def test_an_estimate_that_does_not_agree_is_left_out():
    """The fault appeared in the middle of the first burst, or grows."""
    from dataclasses import replace

    early = replace(said(burst="b0"), severity=Severity(-0.1, 0.01))
    late = [replace(said(burst=f"b{i}"), severity=Severity(-0.5, 0.01)) for i in (1, 2)]
    verdict = conclude([early, *late])
    assert verdict.severity.value == -0.5
    assert abs(verdict.severity.sd - 0.01 / 2**0.5) < 1e-12


def test_a_model_gap_is_suspected_when_bursts_keep_fitting_nothing():
    from dataclasses import replace

    odd = [replace(said(burst=f"b{i}", fault=None), weights={"none_of_these": 0.9}) for i in range(3)]
    blind = [replace(said(burst=f"b{i}", fault=None, trustworthy=False, detected=False), p_white=1e-6) for i in range(3)]
    assert "model gap suspected" in model_gap(odd)
    assert "model gap suspected" in model_gap(blind)
    assert "afdsvc explain day/b.mcap" in model_gap(odd, kept=["day/a.mcap", "day/b.mcap"])
    assert model_gap(odd[:2]) == ""
    assert model_gap([*odd, said(burst="b3")]) == ""
    assert model_gap([said(burst=f"b{i}", fault=None, detected=False) for i in range(5)]) == ""
    frozen = [replace(e, p_white=None) for e in blind]
    assert model_gap(frozen) == ""


def test_a_question_is_open_when_a_fault_is_sure_and_its_name_is_not():
    question = open_question([said(fault=None)])
    assert question is not None
    assert (question.burst, dict(question.weights)) == ("b1", {"a": 0.5, "b": 0.5})
    assert open_question([said()]) is None
    assert open_question([said(fault=None), said("fault_curves")]) is None
    assert open_question([said(fault=None, detected=False)]) is None
    assert open_question([said(fault=None, trustworthy=False)]) is None


def test_one_suspect_is_no_question():
    lone = said(fault=None)
    assert open_question([replace(lone, weights={"a": 0.9, "none_of_these": 0.1})]) is None
