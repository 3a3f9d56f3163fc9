"""What blocks drawn anew say of a gain."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from afdsvc.explain.search.evidence import HypothesisEvidence, noise_times

BEFORE = np.full((20, 1), 1.0)


def evidence(after: np.ndarray, fixed: float = 0.0) -> HypothesisEvidence:
    return HypothesisEvidence({0.0: 1.0}, 0.5, BEFORE, after, 100.0, fixed)


def test_a_gain_in_every_block_holds_in_every_resampling():
    assert evidence(np.full((20, 1), 0.9)).improves(400) == 1.0
    assert evidence(np.full((20, 1), 1.1)).improves(400) == 0.0


def test_a_gain_of_one_block_alone_is_lost_as_often_as_that_block_is_not_drawn():
    """It outweighs the others whenever it is drawn: 1 - (1 - 1/20)^20 of the resamplings."""
    after = np.full((20, 1), 1.02)
    after[3] = 0.05
    assert evidence(after).improves(4000) == pytest.approx(1 - 0.95**20, abs=0.03)


def test_losses_with_and_without_the_effect_are_drawn_together():
    """A tenth less in every block is a gain in every resampling, however unlike the blocks are."""
    losses = 10.0 ** np.arange(-5, 5)[:, None]
    assert replace(evidence(0.9 * losses), before=losses).improves(400) == 1.0


def test_every_output_counts_by_what_is_left_of_it():
    """A position is followed four times better in power, a pressure twice as badly: the likelihood of both rises, though the sum of their losses does not fall."""
    both = replace(evidence(np.tile([0.25, 2.0], (20, 1))), before=np.ones((20, 2)))
    assert both.resampled(np.arange(20)[None]) == pytest.approx([100 * np.log(4 / 2) / 2])
    assert both.improves(400) == 1.0
    assert replace(both, after=np.tile([0.5, 2.5], (20, 1))).improves(400) == 0.0


def test_the_price_of_the_parameters_counts():
    gain = evidence(np.full((20, 1), 0.9))
    assert replace(gain, fixed=-100 * np.log(1 / 0.9) - 0.1).improves(400) == 0.0


def test_hypotheses_are_compared_by_the_correlation_time_of_what_the_best_one_leaves():
    """The fit that leaves less has the longer-lived residual: it is the nearer to the noise."""
    poor, good = SimpleNamespace(deviance=100.0, own_tau=2.0), SimpleNamespace(deviance=-50.0, own_tau=9.0)
    assert noise_times([{0.0: poor}, {0.0: good}]) == {0.0: 9.0}
