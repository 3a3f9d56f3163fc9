"""What the gap test answers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from afdsvc.api.evidence import p_value_text


@dataclass(frozen=True, slots=True)
class Gap:
    """Whether simulation and recording differ by more than noise, and by how much.

    Attributes
    ----------
    present : bool
        Whether the residual depends on inputs, states, aux or time, or repeats with the excitation, at the stated level.
    r2 : tuple of float
        Per output, share of the residual's power that the flexible model predicts on blocks it was not fitted to.
    total : float
        Mean of ``r2`` over the outputs.
    linear : float
        The same for the features that are linear in inputs, states and aux.
    whitened : tuple of float
        Per output, share predicted of the residual's innovations (autoregressive whitening of residual and features).
    p_value : float
        p-value of both tests together (Bonferroni).
    threshold : tuple of float
        ``r2`` per output that residuals of the same colour, independent of the inputs, exceed with the stated level. For orientation:
        the decision also uses ``whitened``, where slow noise hides less.
    blocks, blocks_won : int, float
        Left-out blocks, and the share of them in which the prediction is better than none.
    enough : bool
        Whether the recordings hold enough blocks of four correlation times.
    correlation_time : tuple of float
        Of the residual, per output [samples].
    depends_on : tuple of (group, share)
        Share of the residual's power lost when a group of features is left out, largest first. Groups that stand in for one
        another (a state and the history of the input that moves it) both lose little.
    repeats : tuple of float, optional
        Per output, share of the residual's power that repeats with the excitation; None where no excitation repeats.
    offset : tuple of float
        Per output, share of the residual's whole power that is a constant in each recording; not part of the test.
    sentence : str
        The finding in words.
    """

    present: bool
    r2: tuple[float, ...]
    total: float
    linear: float
    whitened: tuple[float, ...]
    p_value: float
    threshold: tuple[float, ...]
    blocks: int
    blocks_won: float
    enough: bool
    correlation_time: tuple[float, ...]
    depends_on: tuple[tuple[str, float], ...]
    repeats: tuple[float, ...] | None
    offset: tuple[float, ...]
    sentence: str = ""

    @property
    def absent(self) -> bool:
        """Whether the recordings are long enough to show a gap, and show none."""
        return self.enough and not self.present

    @property
    def within_reach(self) -> tuple[float, ...]:
        """Per output, the share of the residual's power that some model could explain: the larger of ``r2`` and ``repeats``."""
        repeats = self.repeats or (0.0,) * len(self.r2)
        return tuple(max(a, b, 0.0) for a, b in zip(self.r2, repeats, strict=True))


def sentence(found: Gap, outputs: Sequence[str], held: float, needed: float) -> str:
    """Return the finding in words; ``held`` blocks of four correlation times where ``needed`` are expected."""
    kind = "Gap" if found.present else "No gap found" if found.enough else "Too short to distinguish a gap from noise"
    words = f"{kind}: a flexible model predicts {_shares(found.r2, outputs)} of the residual's power on data it was not fitted to"
    words += f" ({100 * found.blocks_won:.0f} % of {found.blocks} blocks improve, {p_value_text(found.p_value)})"
    if found.present:
        words += f"; linear functions of inputs and states, and of their history, predict {100 * max(found.linear, 0.0):.0f} % (all outputs)"
        if max(found.whitened) > max(found.r2):
            words += f"; of the residual's innovations it predicts {_shares(found.whitened, outputs)}"
    if found.repeats is not None:
        words += f"; {_shares(found.repeats, outputs)} repeats with the excitation"
    if not found.enough:
        words += f"; the recordings hold {held:.1f} blocks of four correlation times, {needed:g} are needed"
    return words + "."


def _shares(values: Sequence[float], outputs: Sequence[str]) -> str:
    return ", ".join(f"{100 * max(v, 0.0):.0f} % ('{name}')" for v, name in zip(values, outputs, strict=True))
