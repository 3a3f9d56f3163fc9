"""Sentences of location: what was found, with its statistics."""

from __future__ import annotations

from collections.abc import Sequence

from afdsvc.explain.locate_amplitude import Law
from afdsvc.explain.locate_injection import REFUSED, Entry
from afdsvc.explain.locate_lines import Split
from afdsvc.explain.locate_map import Dependence
from afdsvc.explain.locate_time import Span


def percent(share: float) -> str:
    """Return a share in per cent, to two digits."""
    return f"{100 * share:.2g} %" if share < 0.995 else "all"


def chance(p: float) -> str:
    """Return a p-value."""
    return f"p = {p:.1g}" if p > 1e-300 else "p < 1e-300"


def driven(
    output: str, explained: float, share: float, split: Split | None, grows: Law | None, shown: Sequence[Dependence],
    entries: Sequence[Entry],
) -> str:
    """Return the evidence for what answers to the excitation."""
    parts = [f"output {output}: {percent(share)} of the residual's power " + _repeats(split)]
    if grows:
        parts.append(f"its rms goes with the excitation's to the power {grows.exponent:.2f} +- {grows.sd:.2f}, {grows.reading}")
    if shown:
        parts.append("; ".join(_depends(d) for d in shown) + f" (together {percent(explained)} of this output's residual)")
    if entries:
        parts.append(_entry(entries))
    return "; ".join(parts)


def _repeats(split: Split | None) -> str:
    if split is None:
        return "follows the machine's own signals"
    total = sum(max(part.power, 0.0) for part in split.kinds.values()) or 1.0
    listed = ", ".join(f"{kind} {percent(max(part.power, 0.0) / total)}" for kind, part in split.kinds.items() if part.lines)
    return f"repeats with the excitation (F = {split.total.f:.3g}, {chance(split.total.p)}; of it by lines: {listed})"


def _depends(d: Dependence) -> str:
    near = [g for g in d.nearly if g.site != d.group.site or g.law != d.group.law]
    also = f"; nearly as well by {', '.join(f'{g.law} at {g.site}' for g in near)}" if near else ""
    return f"follows {d.group.law} entering at {d.group.site} (F = {d.f:.3g}, {chance(d.p)} after correction for all tried{also})"


def _entry(entries: Sequence[Entry]) -> str:
    best = entries[0]
    refused = [e.site for e in entries[1:] if e.p < REFUSED and e.share < best.share - 0.02]
    verdict = "and nothing beyond noise is left" if best.p > REFUSED else f"and leaves more than noise ({chance(best.p)})"
    alike = [e.site for e in entries[1:] if e.share >= best.share - 0.02]
    against = f"; refused: {', '.join(refused)}" if refused else ""
    places = " or ".join([best.site, *alike])
    return f"one signal entering at {places} explains {percent(max(best.share, 0.0))} of what repeats {verdict}{against}"


def rotation(shown: Sequence[Dependence], turning: Sequence[float]) -> str:
    """Return the evidence for what follows the rotor."""
    hertz = ", ".join(f"{s:.4g}" for s in sorted(set(turning)))
    laws = "; ".join(_depends(d) for d in shown)
    return f"turns with the rotor ({hertz} Hz); {laws}"


def tone(shown: Sequence[Dependence], hertz: Sequence[float], named: Sequence[str]) -> str:
    """Return the evidence for tones."""
    parts = [
        f"is a tone of {f:.5g} Hz ({name}; F = {d.f:.3g}, {chance(d.p)})" for d, f, name in zip(shown, hertz, named, strict=True)
    ]
    return " and ".join(parts) + ", which the excitation does not make"


def slow(shown: Sequence[Dependence]) -> str:
    """Return the evidence for constants, drifts and what follows auxiliary signals alone."""
    return "; ".join(_depends(d) for d in shown)


def span(output: str, found: Span) -> str:
    """Return the evidence for a loud span of time."""
    return (
        f"output {output}: from {found.start:.3g} to {found.stop:.3g} s of {found.run} the residual's power is {found.ratio:.2g} "
        f"times the usual ({chance(found.p)})"
    )


def unattributed(output: str, ratio: float, p: float) -> str:
    """Return the evidence for a residual tied to nothing."""
    return (
        f"output {output}: the residual's power is {ratio:.3g} times the stated noise and it is not white ({chance(p)}), but it "
        "follows none of the machine's signals"
    )
