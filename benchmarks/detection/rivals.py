"""Change detectors from the shelf: `ruptures` and `river`, given every chance.

Each sees a healthy reference as long as the burst, then the burst, and where it needs to know what to look at, both the
raw residual (a fault makes it wilder) and the residual times sine and cosine of the excited lines (a fault moves its mean).
Their own alarm settings are replaced by a threshold on their statistic, calibrated on healthy data like everybody's.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from bursts import Played, Player
from scores import Scorer

from afdsvc.lti.statespace import Array

JUMP = 250  # samples between the candidate change points of ruptures; the true one is among them
DELTAS = np.logspace(-1, -14, 16)  # confidences tried with ADWIN


def rivals(player: Player, thin: int, seed: int = 5) -> list[Scorer]:
    """Return the rivals that are installed."""
    found: list[Scorer] = []
    rng = np.random.default_rng(seed)

    def each(name: str, statistic: Callable[[Array], float], signal: Callable[[Array, Array], Array]) -> Scorer:
        def score(played: Played) -> Array:
            reference = rng.normal(size=played.E.shape)  # the healthy residual is white: nothing else can be known of it
            return np.array([statistic(signal(a, b)) for a, b in zip(reference, played.E, strict=True)])

        return Scorer(name, score, None, thin)

    t = np.arange(player.burst.samples) * player.problem.plant.dt
    waves = np.concatenate([[np.sin(w * t), np.cos(w * t)] for w in player.basis.omega]).T

    def plain(a: Array, b: Array) -> Array:
        return np.concatenate([a, b])

    def turned(a: Array, b: Array) -> Array:
        return np.concatenate([(waves[:, :, None] * e[:, None, :]).reshape(len(e), -1) for e in (a, b)])

    def energy(a: Array, b: Array) -> Array:
        return np.asarray(np.sum(plain(a, b) ** 2, axis=1))

    def strongest(a: Array, b: Array) -> Array:
        """Return the one turned channel that ends farthest from zero: PageHinkley takes one number at a time."""
        both = turned(a, b)
        return both[:, int(np.argmax(np.abs(both[len(a) :].mean(axis=0))))]

    if ruptures_installed():
        found.append(each("ruptures normal", _ruptures("normal"), plain))
        found.append(each("ruptures l2, demodulated", _ruptures("l2"), turned))
    if river_installed():
        found.append(each("river PageHinkley, energy", page_hinkley, energy))
        found.append(each("river PageHinkley, demodulated", page_hinkley, strongest))
        found.append(each("river ADWIN, energy", adwin, energy))
    return found


def ruptures_installed() -> bool:
    """Whether `ruptures` can be imported."""
    try:
        import ruptures  # noqa: F401
    except ImportError:
        return False
    return True


def river_installed() -> bool:
    """Whether `river` can be imported."""
    try:
        import river  # noqa: F401
    except ImportError:
        return False
    return True


def _ruptures(model: str) -> Callable[[Array], float]:
    import warnings

    import ruptures

    warnings.filterwarnings("ignore", message="New behaviour in v1.1.5")  # says so at every start

    def statistic(signal: Array) -> float:
        search = ruptures.Binseg(model=model, jump=JUMP).fit(signal)
        found = search.predict(n_bkps=1)
        return float(search.cost.sum_of_costs([len(signal)]) - search.cost.sum_of_costs(found))

    return statistic


def page_hinkley(signal: Array) -> float:
    """Return the largest statistic of the Page-Hinkley test, either direction."""
    return float(page_hinkley_path(signal).max())


def page_hinkley_path(signal: Array) -> Array:
    """Return the statistic after every sample, either direction, with river's defaults for delta and alpha."""
    from river.drift import PageHinkley

    test = PageHinkley(threshold=1e300)
    path = np.zeros(len(signal))
    for k, x in enumerate(signal.tolist()):
        test.update(x)
        up = test._sum_increase - test._min_increase  # noqa: SLF001 - river keeps its statistic to itself
        down = test._max_decrease - test._sum_decrease  # noqa: SLF001
        path[k] = up if up > down else down
    path[: test.min_instances] = 0.0
    return path


def adwin(signal: Array) -> float:
    """Return minus the logarithm of the smallest confidence parameter at which ADWIN still sees a change, by bisection."""
    low, high = 0, len(DELTAS)  # alarms at DELTAS[:low], none at DELTAS[high:]
    while low < high:
        middle = (low + high) // 2
        if _adwin_alarms(signal, float(DELTAS[middle])):
            low = middle + 1
        else:
            high = middle
    return float(low)


def _adwin_alarms(signal: Array, delta: float) -> bool:
    from river.drift import ADWIN

    test = ADWIN(delta=delta)
    for x in signal.tolist():
        test.update(x)
        if test.drift_detected:
            return True
    return False
