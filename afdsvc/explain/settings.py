"""Every constant that decides an answer of `explain`, with its meaning and why it has its value."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

Mapper = Callable[[Callable[[Any], Any], Iterable[Any]], Iterable[Any]]  # `map`, or what does the same in several threads


@dataclass(frozen=True, slots=True)
class Settings:
    """Constants of the search and of the verdict; see docs/explanation/explain.md for the cases behind each.

    Attributes
    ----------
    horizons : tuple of float
        Strengths of the predictor (force noise per sample over force) that a fit passes through; 0 is simulation.
    theta_sd : float
        Prior of the model's free numbers in units of the stated standard deviation; 1 where noise limits.
    offset_sd, load_sd, state_sd : float
        Prior of sensor offsets, of constant loads of integrating plants and of initial states, in rms of the output, of the nominal
        force and of the state; the last also of what effects begin with.
    drift_limit : float
        Error of an integrating plant's simulation, in rms of the output, above which a predictor is used.
    noise_limited : float
        Power of the residual over that of the noise below which the noise limits what can be seen.
    independent : float
        Independent samples a weighted residual must be worth to count as noise that limits.
    screened : int
        Samples that hypotheses are screened and first fitted on, the beginnings of four recordings; those that keep their promise are
        fitted to whole recordings.
    shown : float
        Share of the motion and of what is missed, per sample, that beginnings have to hold: else hypotheses are chosen where most of both is.
    refined, polished : int
        Hypotheses that are fitted with all numbers of the model after the linear screen, and those passed through all horizons; more
        of both, by the root of the ratio, where the recordings are shorter than ``screened``.
    blocks, correlation_times : int
        Left-out blocks of the cross-validation, and their least length in integrated correlation times (two of those
        are four time constants of exponential correlation).
    evidence : float
        Gain (twice the log-likelihood, less the price of the parameters) below which nothing is accepted.
    rounding : float
        Residual, in rms of the output, below which two computations agree and nothing is looked for.
    constant : float
        Gain asked of a constant of the model that is off, where noise limits: chi-square with one degree of freedom at 2e-4.
    surrogates : int
        Surrogates of the residual of which the largest gain by chance is expected.
    chance : float
        Gain asked for, in multiples of the largest that chance reached to first order.
    share, further : float
        Least share of the gap, and, for a further effect, of the gap or of what earlier effects leave, noise included.
    sure : float
        Share of the resamplings in which a hypothesis has to gain; a look-alike that comes first in less than the rest is not named.
    probable : float
        How sure it must be that the recordings held out are followed better, where only they can show a gap; an effect without which
        they are is dropped.
    tie : float
        Relative difference of shares below which the simpler mechanism goes first.
    likely : float
        Difference of gains below which the simpler mechanism goes first, where noise limits.
    effects : int
        Most effects named.
    resamples : int
        Resamplings of the blocks that weights rest on.
    implausible : float
        Distance of a number of the model from its stated value, in stated standard deviations, from which no name is certain.
    uncertain : float
        Largest weight of a name that is not certain.
    alike : float
        Share of what the best hypothesis closes from which another one is fitted to whole recordings, and is a look-alike; and share
        of what another one leaves that the best must leave at least for the two to fit alike, where the other is not simpler.
    """

    horizons: tuple[float, ...] = (0.01, 0.001, 0.0)
    theta_sd: float = 2.0
    offset_sd: float = 0.1
    load_sd: float = 0.2
    state_sd: float = 3.0
    drift_limit: float = 0.7
    noise_limited: float = 10.0
    independent: float = 200.0
    screened: int = 10_000
    shown: float = 0.5
    refined: int = 16
    polished: int = 5
    blocks: int = 20
    correlation_times: int = 2
    evidence: float = 10.0
    rounding: float = 2e-6
    constant: float = 13.8
    surrogates: int = 99
    chance: float = 1.5
    share: float = 0.05
    further: float = 0.25
    sure: float = 0.95
    probable: float = 0.5
    tie: float = 0.05
    likely: float = 4.0
    effects: int = 3
    resamples: int = 400
    implausible: float = 5.0
    uncertain: float = 0.8
    alike: float = 0.5
