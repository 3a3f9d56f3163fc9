"""Where simulation and recordings part: which output, input, frequencies, time, and on what the difference depends."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from afdsvc.api.physics import Machine
from afdsvc.dataset.experiment import Run
from afdsvc.explain import locate_words as words
from afdsvc.explain.baseline import Baseline
from afdsvc.explain.explanation import Located
from afdsvc.explain.locate_amplitude import Law, law
from afdsvc.explain.locate_injection import Entry, injection
from afdsvc.explain.locate_lines import Split, splits
from afdsvc.explain.locate_map import Dependence, dependences
from afdsvc.explain.locate_time import Span, loud_span
from afdsvc.explain.locate_tones import label, speeds
from afdsvc.explain.locate_view import View, view
from afdsvc.explain.settle import raw
from afdsvc.explain.sizes import bandwidth, machine
from afdsvc.lti.statespace import Array
from afdsvc.stats.ar_noise import whiteness_p
from afdsvc.stats.spectral_peaks import peaks
from afdsvc.stats.tones import tones

SURE = 1e-5  # p-value below which what repeats in an output is no chance
HINT = 1e-2  # and above which nothing can depend on the motion alone, as it would have to repeat with it
SHOWS = 25.0  # sum of squares, in units of noise, from which a dependence shows in an output
BENT = {"amplitude", "velocity sign", "history", "sign of the input's rate"}  # what no linear residual depends on
WORTH_SAYING = 0.01  # share of the residual's power below which a loud span is not told
PART = 0.02  # and its share of what it adds to the output that shows it best


@dataclass(frozen=True, slots=True, eq=False)
class _Facts:
    """Everything measured, before it is told output by output."""

    view: View
    machine: Machine
    found: Sequence[Dependence]
    splits: Sequence[Split]
    entries: Sequence[Entry]
    cleaned: Sequence[Array]

    def noise(self, j: int) -> float:
        """Return the standard deviation of the noise of output j as far as it is known, else of its residual."""
        sd = float(self.view.base.floor.sd[j])
        return sd if self.view.base.floor.known else float(np.sqrt(self.view.power[j]))

    def of_kind(self, *kinds: str) -> list[Dependence]:
        return [d for d in self.found if d.group.kind in kinds]


def locate(base: Baseline, more: Sequence[Run] = (), seen: Machine | None = None) -> tuple[Located, ...]:
    """Return where the residual of a baseline differs from noise, the most visible first; none when it does not.

    ``more`` are runs that were not fitted but may be looked at (for selection, never the held-out ones).
    """
    sight = view(base, more)
    facts = _facts(sight, seen or _machine(base))
    out: list[tuple[float, Located]] = []
    for j in range(len(sight.names)):
        out += [(_visible(facts, place, j), place) for place in _of_output(facts, j)]
    return tuple(place for _, place in sorted(out, key=lambda pair: -pair[0]))


def _machine(base: Baseline) -> Machine:
    residuals, runs = raw(base.objective, base.point), base.objective.runs
    return machine(base, [t.omega for t in tones(runs, residuals)], peaks(runs, residuals, 2 * bandwidth(runs)))


def _facts(sight: View, seen: Machine) -> _Facts:
    found = dependences(sight, seen)
    cleaned = []
    for i, e in enumerate(sight.raw):
        own = [d.component[i] for d in found if d.group.kind != "motion"]
        cleaned.append(e - sum(own, np.zeros_like(e)))
    parts = splits(sight.runs, cleaned, bandwidth(sight.runs))
    return _Facts(sight, seen, found, parts, injection(sight, seen, cleaned), cleaned)


def _of_output(facts: _Facts, j: int) -> list[Located]:
    driven = _driven(facts, j)
    out = [driven] if driven else []
    for kind, tell in (("rotation", _rotation), ("tone", _tone), ("time", _slow)):
        shown = [d for d in facts.of_kind(kind) if _shows(facts, d, j)]
        if shown:
            out.append(tell(facts, shown, j))
    span = _span(facts, j)
    if span:
        out.append(span)
    if not out:
        rest = _unattributed(facts, j)
        out = [rest] if rest else []
    return out


def _size(facts: _Facts, d: Dependence, j: int) -> float:
    return float(sum((c[:, j] ** 2).sum() for c in d.component)) / facts.noise(j) ** 2


def _shows(facts: _Facts, d: Dependence, j: int) -> bool:
    most = max(_size(facts, d, k) for k in range(len(facts.view.names)))
    own = _size(facts, d, j)
    return own > SHOWS and own > PART * most


def _explained(facts: _Facts, shown: Sequence[Dependence], j: int) -> float:
    """Return the share of the output's residual power that goes when these components are taken out."""
    before = after = 0.0
    for i, e in enumerate(facts.view.raw):
        component = sum((d.component[i][:, j] for d in shown), np.zeros(len(e)))
        before += float((e[:, j] ** 2).sum())
        after += float(((e[:, j] - component) ** 2).sum())
    return float(np.clip(1 - after / before, 0.0, 1.0)) if before > 0 else 0.0


def _visible(facts: _Facts, place: Located, j: int) -> float:
    """Return the rms of what was located over that of the noise."""
    return float(np.sqrt(place.share_of_residual_power * facts.view.power[j])) / facts.noise(j)


def _driven(facts: _Facts, j: int) -> Located | None:
    """Return what answers to the excitation in this output, or None when nothing does beyond chance."""
    shown = [d for d in facts.of_kind("motion") if _shows(facts, d, j)]
    split = facts.splits[j] if facts.splits else None
    repeats = split is not None and split.total.p < SURE
    if split is not None and split.total.p > HINT:
        shown = [d for d in shown if _modulated(facts, d)]
    if not repeats and not shown:
        return None
    share = split.total.power / facts.view.power[j] if repeats and split else _explained(facts, shown, j)
    share = float(np.clip(share, 0.0, 1.0))
    grows = law(facts.view.runs, split.per_run) if repeats and split else None
    entry = _entry(facts)
    evidence = words.driven(facts.view.names[j], _explained(facts, shown, j), share, split if repeats else None, grows, shown, facts.entries)
    band = _band_of(facts, shown, split if repeats else None, j)
    depends = _depends(shown, split if repeats else None, grows)
    kind = _kind(shown, split if repeats else None)
    return Located(facts.view.names[j], _input(facts, shown, entry), band, share, depends, evidence, kind)


def _kind(shown: Sequence[Dependence], split: Split | None) -> str:
    """Return "even" or "odd" for a nonlinear residual (odd where the lines cannot tell), "linear" for any other."""
    power = {k: split.kinds[k].power for k in ("odd", "even") if k in split.kinds and split.kinds[k].p < SURE} if split else {}
    if power:
        return max(power, key=lambda k: power[k])
    return "odd" if shown and BENT & set(shown[0].group.depends_on) else "linear"


def _modulated(facts: _Facts, d: Dependence) -> bool:
    """Whether a dependence goes with an auxiliary signal, so that it need not repeat with the excitation."""
    return bool(set(d.group.depends_on) & set(facts.view.runs[0].aux))


def _entry(facts: _Facts) -> Entry | None:
    """Return the one place a single signal must enter at, None when there is none or several would do."""
    best = facts.entries[0] if facts.entries else None
    alone = len(facts.entries) < 2 or facts.entries[1].share < facts.entries[0].share - 0.02
    return best if best and best.share > 0.8 and alone else None


def _input(facts: _Facts, shown: Sequence[Dependence], entry: Entry | None) -> str | None:
    inputs = facts.view.base.nominal.model.inputs
    if len(inputs) == 1:
        return inputs[0].name
    number = shown[0].group.input if shown else entry.input if entry else None
    return None if number is None else inputs[number].name


def _depends(shown: Sequence[Dependence], split: Split | None, grows: Law | None) -> tuple[str, ...]:
    listed: list[str] = []
    for d in shown:
        listed += d.group.depends_on
        for g in d.nearly:
            listed += g.depends_on if g.site == d.group.site else ()
    bent = split is not None and any(split.kinds[k].p < SURE for k in ("odd", "even") if k in split.kinds)
    if bent or (grows is not None and grows.nonlinear):
        listed.append("amplitude")
    if not listed:
        listed.append("frequency")
    return tuple(dict.fromkeys(listed))


def _band_of(facts: _Facts, shown: Sequence[Dependence], split: Split | None, j: int) -> tuple[float, float]:
    if split is not None:
        return split.band[0] / (2 * np.pi), split.band[1] / (2 * np.pi)
    pieces = [sum((d.component[i][:, j] for d in shown), np.zeros(len(r))) for i, r in enumerate(facts.view.runs)]
    return spectral_band(max(pieces, key=lambda x: float(x @ x)), facts.machine.dt)


def spectral_band(x: Array, dt: float) -> tuple[float, float]:
    """Return the frequencies [Hz] between which all but a twentieth on either side of a signal's power lies."""
    power = np.abs(np.fft.rfft(x - x.mean())) ** 2
    share = np.cumsum(power)
    if not share[-1] > 0:
        return 0.0, 0.5 / dt
    low, high = np.searchsorted(share, [0.05 * share[-1], 0.95 * share[-1]])
    return float(low / (len(x) * dt)), float(high / (len(x) * dt))


def _rotation(facts: _Facts, shown: Sequence[Dependence], j: int) -> Located:
    turning = [s / (2 * np.pi) for s in speeds(facts.view.runs)] or [0.0]
    laws = " ".join(d.group.law for d in shown)
    highest = 3 if "three" in laws else 2 if "twice" in laws else 1
    depends = tuple(dict.fromkeys(w for d in shown for w in d.group.depends_on))
    band = (min(turning), highest * max(turning))
    return _told(facts, shown, j, band, depends, words.rotation(shown, turning))


def _tone(facts: _Facts, shown: Sequence[Dependence], j: int) -> Located:
    hertz = [d.group.omega / (2 * np.pi) for d in shown]
    named = [label(d.group.omega, facts.view.runs) for d in shown]
    depends = ("rotor angle",) if all("rotation" in n for n in named) else ("time",)
    return _told(facts, shown, j, (min(hertz), max(hertz)), depends, words.tone(shown, hertz, named))


def _slow(facts: _Facts, shown: Sequence[Dependence], j: int) -> Located:
    depends = tuple(dict.fromkeys(w for d in shown for w in d.group.depends_on))
    pieces = [sum((d.component[i][:, j] for d in shown), np.zeros(len(r))) for i, r in enumerate(facts.view.runs)]
    longest = max(len(r) for r in facts.view.runs) * facts.machine.dt
    top = max(spectral_band(x, facts.machine.dt)[1] for x in pieces)
    return _told(facts, shown, j, (0.0, max(top if top < 0.4 / facts.machine.dt else 0.0, 1 / longest)), depends, words.slow(shown))


def _told(
    facts: _Facts, shown: Sequence[Dependence], j: int, band: tuple[float, float], depends: tuple[str, ...], text: str
) -> Located:
    share = _explained(facts, shown, j)
    evidence = f"output {facts.view.names[j]}: {words.percent(share)} of the residual's power {text}"
    return Located(facts.view.names[j], None, band, share, depends, evidence, "noise")


def _span(facts: _Facts, j: int) -> Located | None:
    rest = [
        e - sum((d.component[i] for d in facts.found), np.zeros_like(e)) for i, e in enumerate(facts.view.raw)
    ]
    span: Span | None = loud_span(facts.view.runs, rest, j)
    if span is None:
        return None
    length = sum(len(r) for r in facts.view.runs) * facts.machine.dt
    extra = span.usual * (span.ratio - 1) * (span.stop - span.start) / length
    share = float(np.clip(extra / facts.view.power[j], 0.0, 1.0))
    if share < WORTH_SAYING:
        return None
    top = 0.5 / facts.machine.dt
    name = facts.view.names[j]
    return Located(name, None, (0.0, top), share, ("time",), words.span(name, span), "noise")


def _unattributed(facts: _Facts, j: int) -> Located | None:
    """Return a residual that is neither noise as stated nor tied to any signal; only where the noise cannot be measured apart."""
    stated = facts.view.base.nominal.model.output_sd
    if stated is None or facts.view.base.floor.known:
        return None
    ratio = float(facts.view.power[j] / stated[j] ** 2)
    p = whiteness_p([e[:, [j]] for e in facts.view.raw])
    if ratio < 1.5 or p > 1e-6:
        return None
    name, share = facts.view.names[j], 1 - 1 / ratio
    band = spectral_band(max((e[:, j] for e in facts.view.raw), key=len), facts.machine.dt)
    return Located(name, None, band, share, (), words.unattributed(name, ratio, p), "noise")
