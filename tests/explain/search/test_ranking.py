"""Which hypothesis comes first, and what a weight counts."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from afdsvc.explain.search.evidence import HypothesisEvidence
from afdsvc.explain.search.ranking import Candidate, is_reason, look_alikes, vote_shares, winner
from afdsvc.explain.settings import Settings

BLOCKS, COUNT = 20, 400.0
S = Settings()


def candidate(physics: str, closed: float, parameters: int = 1, site: str = "input:u", variant: str = "", share: float = 0.5, reads: int = 1) -> Candidate:
    """Return a candidate that leaves the share ``1 - closed`` of the loss in every block."""
    after = np.full((BLOCKS, 1), 1 - closed)
    coefficients = tuple(SimpleNamespace(free=True, nuisance=False) for _ in range(parameters))
    words = {"physics": physics, "site": site, "key": f"{physics}@{site}#{variant}", "notes": {"variant": variant}}
    hypothesis = SimpleNamespace(**words, parameters=coefficients, reads=("u",) * reads)
    gain = -COUNT * np.log(1 - closed)
    return Candidate(hypothesis, {}, HypothesisEvidence({0.0: gain}, share, np.ones((BLOCKS, 1)), after, COUNT, 0.0))


def test_hypotheses_that_fit_alike_share_the_vote_and_the_simplest_goes_first():
    many, few, other = candidate("curve", 0.900, 3), candidate("friction", 0.895, 1), candidate("lag", 0.5, 1)
    assert vote_shares([many, few, other], S, "model") == pytest.approx([0.5, 0.5, 0.0])
    assert winner([many, few, other], S, "model") is few
    coil, lag = candidate("coil", 0.9, reads=2), candidate("lag", 0.899)
    assert winner([coil, lag], S, "model") is lag


def test_the_shapes_of_one_mechanism_share_one_vote():
    """However many shapes a curve is offered in, a simpler lag that fits as well comes first."""
    curves = [candidate("curve", 0.9, 2, variant=v) for v in ("square", "cube", "power")]
    lag = candidate("lag", 0.9, 1)
    assert vote_shares([*curves, lag], S, "model") == pytest.approx([1 / 6, 1 / 6, 1 / 6, 1 / 2])
    assert winner([*curves, lag], S, "model") is lag


def test_what_gains_as_much_and_is_in_no_doubt_goes_before_a_first_name_that_blocks_doubt():
    """A lag gets most votes, by blocks as they are fitted; left out, few blocks gain, but much."""
    lag, eddy = candidate("lag", 0.9), candidate("eddy", 0.8, 2)
    after = np.where(np.arange(BLOCKS) < 2, 0.01, 1.2)[:, None]
    doubtful = replace(lag, evidence=replace(lag.evidence, after=after, fitted=(lag.evidence.before, lag.evidence.after)))
    assert doubtful.evidence.improves(S.resamples) < S.sure < eddy.evidence.improves(S.resamples)
    assert winner([doubtful, eddy], S, "model") is doubtful  # what is in no doubt gains less
    less = replace(eddy, evidence=replace(eddy.evidence, gains={0.0: doubtful.evidence.gain - S.likely - 0.1}))
    assert winner([doubtful, less], S, "model") is doubtful
    better = replace(eddy, evidence=replace(eddy.evidence, gains={0.0: doubtful.evidence.gain - S.likely + 0.1}))
    assert winner([doubtful, better], S, "model") is better
    assert winner([doubtful, replace(better, evidence=replace(better.evidence, after=after))], S, "model") is doubtful


def test_a_hypothesis_that_is_never_best_is_not_first_however_simple():
    assert winner([candidate("curve", 0.9, 3), candidate("friction", 0.8, 1)], S, "model").hypothesis.physics == "curve"


def test_votes_count_blocks_as_they_are_fitted():
    """One block alone shows a limit: left out, the limit is unknown, and the block speaks against it."""
    limit, curve = candidate("limit", 0.99), candidate("curve", 0.9)
    after = limit.evidence.after.copy()
    after[0] = 5.0
    left_out = replace(limit, evidence=replace(limit.evidence, after=after, fitted=(limit.evidence.before, limit.evidence.after)))
    assert vote_shares([left_out, curve], S, "model") == pytest.approx([1.0, 0.0])
    assert left_out.evidence.improves(S.resamples) < 1


def test_what_leaves_more_than_twice_as_much_and_is_not_simpler_does_not_fit_alike():
    """All close more than 95 % of what the best closes."""
    cubic, cogging = candidate("cubic", 0.997), candidate("cogging", 0.991)
    assert vote_shares([cubic, cogging], S, "model") == pytest.approx([1.0, 0.0])
    assert vote_shares([cubic, candidate("cogging", 0.995)], S, "model") == pytest.approx([0.5, 0.5])


def test_what_is_simpler_may_leave_twice_as_much_more_with_every_parameter_less():
    mode, friction = candidate("mode", 0.999, 3), candidate("friction", 0.9925, 1)
    assert winner([mode, friction], S, "model") is friction
    assert vote_shares([mode, candidate("friction", 0.9915, 1)], S, "model") == pytest.approx([1.0, 0.0])


def test_residual_power_is_compared_above_the_noise_where_that_is_known():
    """Two laws leave 0.2 and 0.6 % of the loss, the simpler one more: with 0.15 % of noise that is nine times as much above it."""
    mode, friction = candidate("mode", 0.998, 3), candidate("friction", 0.994, 1)
    assert winner([mode, friction], S, "model") is friction
    noisy = replace(mode, evidence=replace(mode.evidence, noise=0.75))
    assert winner([noisy, friction], S, "model") is noisy
    assert vote_shares([noisy, friction], S, "model") == pytest.approx([1.0, 0.0])
    assert vote_shares([noisy, candidate("friction", 0.9965, 3)], S, "model") == pytest.approx([1.0, 0.0])
    quiet = replace(mode, evidence=replace(mode.evidence, noise=1e-6))
    assert vote_shares([quiet, candidate("friction", 0.9965)], S, "model") == pytest.approx([0.5, 0.5])


def test_where_noise_limits_only_the_likelihood_counts():
    """The shares differ by less than a twentieth, the gains by 18."""
    one, two = candidate("curve", 0.900, 3), candidate("friction", 0.895, 1)
    assert winner([one, two], S, "noise") is one


def test_a_constant_is_a_reason_where_it_closes_nearly_all_or_noise_limits():
    some, most = candidate("parameter_change", 0.5, share=0.5), candidate("parameter_change", 0.9, share=0.9)
    assert not is_reason(some, "model")
    assert is_reason(most, "model")
    assert is_reason(some, "noise")


def test_look_alikes_close_half_of_what_the_first_one_closes():
    first, near, far = candidate("curve", 0.9), candidate("friction", 0.6), candidate("lag", 0.3)
    assert look_alikes([first, near, far], S) == [first, near]


def test_of_every_mechanism_one_shape_is_a_look_alike():
    first, shape, near = candidate("curve", 0.9, variant="cube"), candidate("curve", 0.89, variant="square"), candidate("friction", 0.8)
    assert look_alikes([first, shape, near], S) == [first, near]
    asymmetric, even = candidate("friction", 0.85, 2, variant="asymmetric"), candidate("friction", 0.849)
    assert look_alikes([first, asymmetric, even], S) == [first, even]  # the simplest of those that fit alike
