"""Every number that decides whether there is a gap."""

from __future__ import annotations

from dataclasses import dataclass

from afdsvc.errors import BadInput


@dataclass(frozen=True, slots=True)
class GapSettings:
    """Settings of the gap test; the defaults were chosen on simulated controls (`benchmarks/explain/gap_rates.py`).

    Attributes
    ----------
    level : float
        Probability of a false gap [1], shared by the tests that apply. 0.02 needs 99 surrogates when two tests apply.
    rows : int
        Samples [1] used for the regression; longer recordings are thinned. More rows cost time and add no independent data.
    folds : int
        Left-out parts of the data [1]. Fewer leave a large part out of the fit, more cost time.
    block_times : float
        Length of a block [correlation times]: exp(-4) = 2 % of the residual's correlation is left across a block.
    needed_blocks : float
        Blocks [1] below which the recordings are called too short: the share of blocks that improve is then too coarse.
    lag_share : float
        Longest lag [share of the longest recording] in the correlation time; beyond it the estimate is mostly noise.
    ridge : tuple[float, float, int]
        Smallest and largest ridge parameter [variance of a feature] and their number; at the largest the prediction vanishes.
    knots : int
        Hinge functions over all signals [1].
    bank : int
        Columns [1] of resonators driven by the inputs: modes the simulation does not have.
    damping : tuple[float, float]
        Damping ratios [1] of these resonators, one for a mode and one for a lag.
    picked : int
        Columns [1] drawn at random of each kind that grows with the product of signals, functions and poles.
    least_periods : int
        Whole periods [1] from which the part of the residual that repeats is tested.
    whitening_order : int
        Order [samples] of the autoregressive filter before that test: without it one end of a slow residual fills all lines.
    """

    level: float = 0.02
    rows: int = 8000
    folds: int = 16
    block_times: float = 4.0
    needed_blocks: float = 10.0
    lag_share: float = 0.2
    ridge: tuple[float, float, int] = (1e-6, 1e2, 9)
    knots: int = 20
    bank: int = 48
    damping: tuple[float, float] = (0.05, 0.3)
    picked: int = 64
    least_periods: int = 2
    whitening_order: int = 20

    def __post_init__(self) -> None:
        """Raise `BadInput` when a number makes no test."""
        if not 0 < self.level < 1 or self.folds < 3 or self.rows < 100:
            raise BadInput(
                f"gap test: level {self.level:g}, {self.folds} folds, {self.rows} rows; "
                "expected a level between 0 and 1, at least 3 folds and 100 rows"
            )
