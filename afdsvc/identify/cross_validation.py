"""Choice of method, horizon, feedthrough, order and noise model by samples left out of the fit.

The recordings are cut into `FOLDS` stretches. A candidate is fitted without each of them in turn and simulated over it from the recorded
inputs, initial state and operating point fitted; its loss is the mean squared error relative to the power of the outputs, and its level the mean of
the logarithms of its losses, so that the stretch with most noise does not decide alone. Where the plant cannot be
simulated in open loop, one-step prediction errors take the place of simulation errors, for every candidate alike. Orders grow from one
until the loss has not fallen for `PATIENCE` orders, whatever a nominal model says, for PBSIDopt and for the subspace method (CVA). The best
are refined by output errors and by prediction errors. Chosen is the candidate with the smallest level plus the penalty of the Bayesian information
criterion for its parameters (Schwarz, Annals of Statistics 6, 1978). Where past outputs predict the inputs, feedback may be at work, and methods
that it does not bias are preferred as long as one of them is within one standard error of it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy import linalg, stats

from afdsvc.dataset.arrays import InputOutputData, scale_recordings, scales
from afdsvc.errors import AfdsvcError, BadInput
from afdsvc.identify.fit import without_group
from afdsvc.identify.methods.black_box_pem import best_black_box
from afdsvc.identify.methods.pbsid import decompose_predictor, realise_predictor
from afdsvc.identify.methods.subspace import Weighting, decompose, realise
from afdsvc.identify.numerics.compression import triangle
from afdsvc.identify.numerics.innovations_form import InnovationsForm, fitted_errors
from afdsvc.lti.statespace import Array

#: Stretches left out in turn.
FOLDS = 3
#: Orders without a smaller loss after which none higher is tried (two modes).
PATIENCE = 4
#: Block rows that are tried; past windows of PBSIDopt are twice as long.
HORIZONS = (10, 30)
#: Loss (multiple of the outputs' power) that counts as a failure.
HOPELESS = 1e6
ROUNDING = 1e-20  # loss below which it is that of the arithmetic, of recordings without noise
#: Samples beyond which the choice rests on a part of the recordings; the fit uses all.
MOST_SAMPLES = 20_000
#: Steps of a refinement, in the fit and where candidates are compared.
STEPS, FEW_STEPS = 40, 6


@dataclass(frozen=True, slots=True)
class _Candidate:
    """One way to a model: ``method`` "subspace" (with ``weighting``) or "pbsid", then ``refined`` "", "output_error" or "pem"."""

    method: str
    horizon: int
    feedthrough: bool
    order: int = 1
    weighting: Weighting = "cva"
    refined: str = ""

    @property
    def consistent(self) -> int:
        """2 where feedback does no harm, 1 where it does none if it takes a sample or more, 0 where it biases the estimate."""
        return 0 if self.refined == "output_error" or (self.method == "subspace" and self.refined != "pem") else 2 - self.feedthrough

    def parameters(self, inputs: int, outputs: int) -> int:
        """Number of parameters of the plant."""
        return self.order * (inputs + outputs) + inputs * outputs * self.feedthrough

    @property
    def sentence(self) -> str:
        """The candidate in words."""
        name = f"subspace ({self.weighting})" if self.method == "subspace" else "PBSIDopt"
        how = {"": "", "output_error": ", refined by output errors", "pem": ", refined by prediction errors"}[self.refined]
        return f"{name}, horizon {self.horizon}, {'with' if self.feedthrough else 'without'} feedthrough{how}"


@dataclass(frozen=True, slots=True, eq=False)
class Choice:
    """The candidate chosen, its relative loss (power unexplained on samples left out), why it was chosen, and the others, best first."""

    candidate: _Candidate
    loss: float
    sentence: str
    others: tuple[_Candidate, ...] = ()


def fitted_candidate(candidate: _Candidate, recordings: Sequence[InputOutputData], starts: Sequence[InnovationsForm] = ()) -> InnovationsForm:
    """Return the model of a candidate; ``starts`` are further starting points of a refinement, of which the lowest objective is kept."""
    return _Fitter(recordings, STEPS).model(candidate, starts)


class _Fitter:
    """Models of candidates from the same recordings; a decomposition serves every order."""

    def __init__(self, recordings: Sequence[InputOutputData], steps: int) -> None:
        self.recordings, self.steps = list(recordings), steps
        self._held: dict[tuple[str, int, str | bool], Any] = {}  # decompositions

    def model(self, candidate: _Candidate, starts: Sequence[InnovationsForm] = ()) -> InnovationsForm:
        c = candidate
        if c.refined:
            first = self.model(replace(c, refined=""))
            return best_black_box([first, *starts], self.recordings, c.refined == "pem", self.steps)
        key = (c.method, c.horizon, c.weighting if c.method == "subspace" else c.feedthrough)
        if key not in self._held:
            if c.method == "subspace":
                self._held[key] = decompose(self.recordings, c.horizon, c.weighting)
            else:
                self._held[key] = decompose_predictor(self.recordings, c.horizon, feedthrough=c.feedthrough)
        found = self._held[key]
        return realise(found, c.order, stable=True, feedthrough=c.feedthrough) if c.method == "subspace" else realise_predictor(found, c.order)


class _Folds:
    """Losses of candidates on stretches left out, each computed once."""

    def __init__(self, recordings: Sequence[InputOutputData], simulated: bool) -> None:
        self.fitters = [_Fitter(without_group(recordings, k, FOLDS), FEW_STEPS) for k in range(FOLDS)]
        self.left_out = [_group(recordings, k, FOLDS) for k in range(FOLDS)]
        self.power = sum((r.y**2).sum(axis=0) for r in recordings) / sum(map(len, recordings))
        self.samples = sum(map(len, recordings))
        self.shape = recordings[0].u.shape[1], recordings[0].y.shape[1]
        self.simulated = simulated
        self.losses: dict[_Candidate, Array] = {}

    def loss(self, candidate: _Candidate) -> Array:
        """Return the loss on each stretch, shape ``(FOLDS,)``; infinite where the fit fails."""
        if candidate not in self.losses:
            self.losses[candidate] = np.array([self._loss(candidate, k) for k in range(FOLDS)])
        return np.asarray(self.losses[candidate])

    def _loss(self, candidate: _Candidate, k: int) -> float:
        try:
            model = self.fitters[k].model(candidate)
            with np.errstate(all="ignore"):
                errors = np.vstack([self._errors(model, r) for r in self.left_out[k]])
                found = float(np.mean((errors**2).mean(axis=0) / np.where(self.power > 0, self.power, 1.0)))
        except (AfdsvcError, linalg.LinAlgError, ValueError):
            return float("inf")
        return max(found, ROUNDING) if found < HOPELESS else float("inf")

    def _errors(self, model: InnovationsForm, r: InputOutputData) -> Array:
        offset = np.zeros(r.y.shape[1])
        for _ in range(3):  # operating point and initial state in turn: without the former, a mode at 1 is added for it
            errors = fitted_errors(model.system, r.u, r.y - offset) if self.simulated else model.errors(r.u, r.y - offset)
            offset = offset + errors.mean(axis=0)
        return np.asarray(errors - errors.mean(axis=0))

    def level(self, candidate: _Candidate) -> float:
        """Return the mean over the stretches of the logarithm of the loss."""
        return float(np.mean(np.log(self.loss(candidate))))

    def criterion(self, candidate: _Candidate) -> float:
        """Return the level with the penalty of the parameters."""
        price = np.log(self.samples) / (self.samples * self.shape[1])
        return self.level(candidate) + candidate.parameters(*self.shape) * float(price)

    def grown(self, candidate: _Candidate, largest: int) -> None:
        """Try orders from 1 until the level has not fallen for `PATIENCE` orders."""
        best, at = float("inf"), 0
        for order in range(1, largest + 1):
            level = self.level(replace(candidate, order=order))
            best, at = (level, order) if level < best else (best, at)
            if order - at >= PATIENCE and at:
                return

    def best(self, measure: Callable[[_Candidate], float] | None = None) -> _Candidate:
        """Return the candidate with the smallest level, or other ``measure``; raises `BadInput` where every fit failed."""
        found = min(self.losses, key=measure or self.level)
        if not np.isfinite(self.level(found)):
            raise BadInput("no model of any order could be fitted to the recordings and simulated; record longer, or give method and order")
        return found

    def chosen(self, feedback: bool) -> _Candidate:
        """Return the candidate with the smallest criterion; with ``feedback``, of those within one standard error of it that it biases least."""
        found = self.best(self.criterion)
        if not feedback:
            return found
        least = self.losses[found]
        near = [c for c, v in self.losses.items() if float(v.mean() - least.mean()) <= min(_spread(v - least), _spread(least)) / np.sqrt(FOLDS)]
        most = max(c.consistent for c in near)
        return min((c for c in near if c.consistent == most), key=self.criterion)


def choose_candidate(
    recordings: Sequence[InputOutputData], largest: int, feedback: bool = False, closed_loop: bool = False, simulated: bool = True,
    order: int | None = None, horizon: int | None = None, feedthrough: bool | None = None,
) -> Choice:  # fmt: skip
    """Return the candidate that the samples left out speak for.

    ``largest`` bounds the order. ``feedback`` prefers methods that it does not bias, ``closed_loop`` allows no others. ``simulated`` judges by
    simulation errors, else by one-step prediction errors. ``order``, ``horizon`` and ``feedthrough`` fix what they name (None: chosen).
    Raises `BadInput` when the recordings are too short for any candidate.
    """
    m, p = recordings[0].u.shape[1], recordings[0].y.shape[1]
    part = _at_most(recordings, MOST_SAMPLES)
    folds = _Folds(part, simulated)
    direct = [feedthrough] if feedthrough is not None else [False] if closed_loop else [False, True] if feedback else [True]
    for family in _families([horizon] if horizon else _horizons(part, m + p), direct, closed_loop, horizon is None):
        top = max(2, family.horizon // 3) * p if family.method == "pbsid" else (family.horizon - 1) * p
        if order is None:
            folds.grown(family, min(largest, top))
        elif order <= top:
            folds.loss(replace(family, order=order))
    if not folds.losses:
        samples = sum(map(len, recordings))
        raise BadInput(f"{samples} samples are too few to leave some out in choosing a model of {m} inputs and {p} outputs; record longer, or give order and method")
    _refinements(folds, feedback, closed_loop, True in direct and feedthrough is None)
    found, best = folds.chosen(feedback), folds.best()
    loss, least = (float(folds.losses[c].mean()) for c in (found, best))
    rest = (
        f"the least of {len(folds.losses)} candidates"
        if found == best
        else f"the least of {len(folds.losses)} candidates is {100 * least:.3g} % (order {best.order} by {best.sentence}), which does not pay for its parameters"
        f"{' or is biased by feedback' if feedback or closed_loop else ''}"
    )
    sentence = (
        f"order {found.order} by {found.sentence} leaves {100 * loss:.3g} % of the outputs' power unexplained in "
        f"{'simulations' if simulated else 'one-step predictions'} of {FOLDS} stretches left out in turn; {'that is ' if found == best else ''}{rest}"
    )
    others = sorted((c for c in folds.losses if c != found), key=folds.criterion)
    return Choice(found, loss, sentence, tuple(others))


def _refinements(folds: _Folds, feedback: bool, closed_loop: bool, either: bool) -> None:
    """Refine the candidate chosen so far and the best, without feedthrough too where ``either`` is allowed, and at lower orders."""
    for chosen in dict.fromkeys((folds.chosen(feedback), folds.best())):
        for refined in ("pem",) if closed_loop else ("output_error", "pem"):
            folds.loss(replace(chosen, refined=refined))
    for chosen in (folds.chosen(feedback), folds.best()) if either else ():
        folds.loss(replace(chosen, feedthrough=False))
    order, refined = 0, "pem" if feedback or closed_loop else "output_error"
    while (chosen := folds.chosen(feedback)).order != order:  # a refined model may need a state, or a mode, less than the start did
        order = chosen.order
        for fewer in (n for n in (order - 1, order - 2) if n > 0):
            folds.loss(replace(chosen, order=fewer, refined=refined))


def _families(horizons: Sequence[int], direct: Sequence[bool], closed_loop: bool, doubled: bool) -> list[_Candidate]:
    """Return the candidates whose orders are to be grown."""
    found = [_Candidate("pbsid", 2 * h if doubled else h, d) for d in direct for h in horizons]
    return found + [_Candidate("subspace", h, direct[-1]) for h in ([] if closed_loop else horizons[-1:])]


def _horizons(recordings: Sequence[InputOutputData], channels: int) -> list[int]:
    """Return the horizons that the samples of `FOLDS` - 1 stretches can fill."""
    affordable = sum(map(len, recordings)) * (FOLDS - 1) // FOLDS // (4 * channels + 2)
    return sorted({min(h, affordable) for h in HORIZONS if min(h, affordable) >= 3})


@dataclass(frozen=True, slots=True)
class Feedback:
    """Whether past outputs predict an input (``p``, small where they do), and the largest ``share`` of an input's power that comes from them."""

    p: float
    share: float


def feedback_of(recordings: Sequence[InputOutputData], lags: int = 20) -> Feedback:
    """Return what an autoregression of inputs and outputs says of feedback, without any model of the plant.

    ``p``: F test of "past outputs say nothing about an input that past inputs do not" (Granger, Econometrica 37, 1969; Caines and Chan, IEEE
    Trans. Automatic Control 20, 1975), Bonferroni over the inputs. ``share``: relative power contribution of the outputs' innovations to an
    input (Akaike, Annals of the Institute of Statistical Mathematics 20, 1968), what happens within a sample counted as feedthrough.
    """
    m, p = recordings[0].u.shape[1], recordings[0].y.shape[1]
    c = m + p
    lags = max(1, min(lags, sum(map(len, recordings)) // (10 * c)))
    relative = [np.hstack([r.u, r.y]) for r in scale_recordings(recordings, *scales(recordings)) if len(r) > lags]
    rows = [np.lib.stride_tricks.sliding_window_view(w, lags + 1, axis=0)[:, :, ::-1] for w in relative]  # (N - lags, c, lags + 1), now first
    windows: Array = np.concatenate(rows)
    inputs, outputs, now = (w.reshape(len(windows), -1) for w in (windows[:, :m, 1:], windows[:, m:, 1:], windows[:, :, 0]))
    own, both = lags * m, lags * c
    freedom = len(now) - both
    if freedom < both:
        return Feedback(1.0, 0.0)
    R = triangle(np.hstack([inputs, outputs, now]))
    weights = linalg.lstsq(R[:both, :both], R[:both, both:], cond=1e-9)[0]
    rest = R[:, both:] - R[:, :both] @ weights
    alone = R[:, both : both + m] - R[:, :own] @ linalg.lstsq(R[:, :own], R[:, both : both + m], cond=1e-9)[0]
    left, more = (rest[:, :m] ** 2).sum(axis=0), (alone**2).sum(axis=0)
    free = left > 1e-12 * len(now)  # an input that its own past predicts exactly answers to nothing
    F = (more - left)[free] / (lags * p) / (left[free] / freedom)
    found = float(min(1.0, m * stats.f.sf(F, lags * p, freedom).min(initial=1.0)))
    return Feedback(found, _power_share(weights, rest.T @ rest / freedom, m, lags))


def _power_share(weights: Array, innovations: Array, m: int, lags: int) -> float:
    c = len(innovations)
    per_lag = np.concatenate([weights[: lags * m].reshape(m, lags, c), weights[lags * m :].reshape(c - m, lags, c)]).transpose(1, 2, 0)  # (lags, to, from)
    root = linalg.cholesky(innovations + 1e-12 * np.eye(c), lower=True)
    turn = np.exp(-1j * np.outer(np.linspace(1e-3, np.pi, 400), np.arange(1, lags + 1)))
    response = np.linalg.solve(np.eye(c) - np.tensordot(turn, per_lag, axes=1), root.astype(complex))
    power = (np.abs(response[:, :m]) ** 2).sum(axis=0)
    return float((power[:, m:].sum(axis=1) / np.maximum(power.sum(axis=1), 1e-300)).max())


def _spread(differences: Array) -> float:
    return float(differences.std(ddof=1)) if np.isfinite(differences).all() else 0.0


def _group(recordings: Sequence[InputOutputData], k: int, groups: int) -> list[InputOutputData]:
    """Return the stretch that `without_group` leaves out."""
    total, offset, found = sum(map(len, recordings)), 0, []
    start, stop = k * total // groups, (k + 1) * total // groups
    for r in recordings:
        a, b = max(start - offset, 0), min(stop - offset, len(r))
        if b > a:
            found.append(r.span(a, b))
        offset += len(r)
    return found


def _at_most(recordings: Sequence[InputOutputData], samples: int) -> list[InputOutputData]:
    """Return the first part of every recording, so many samples in all."""
    share = min(1.0, samples / sum(map(len, recordings)))
    return [r.span(0, round(share * len(r))) for r in recordings]


__all__ = ["FOLDS", "Choice", "Feedback", "_Candidate", "choose_candidate", "feedback_of", "fitted_candidate"]
