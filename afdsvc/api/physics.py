"""The contract of physics hypotheses: what a model may have left out, where it would act, and by which law.

A plugin hands out `Physics` objects. Asked about a `Machine` (what is known about its inputs, axes, states, outputs and
auxiliary signals, with sizes taken from the recordings) each returns one `Hypothesis` per site where it makes sense.

A law is a plain Python function of numbers and arrays, without imports but ``math``'s names `sin cos exp tanh sqrt pi`
and the built-ins `abs min max range len`; it is compiled and called once per sample::

    def law(p, z, m, dt, out):
        '''Coulomb friction: -F tanh(v / w).'''
        out[0] -= p[0] * math.tanh(z[0] / (p[1] + p[0] * dt))

``p`` are the parameters in the order of `Hypothesis.parameters`, ``z`` the signals named in `Hypothesis.reads`, ``m`` a
memory that starts at zero (see `Hypothesis.unsettled`) and survives between calls, ``dt`` the step in seconds, and ``out`` (zero on entry) what is
added to the targets named in `Hypothesis.writes`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, Protocol

from afdsvc.lti.statespace import Array, StateSpace

Law = Callable[[Any, Any, Any, float, Any], None]
Stage = Literal["input", "force", "output", "parameter"]
MOST_SIGNALS, MOST_AHEAD = 16, 7  # that one law may read, and samples ahead of time


@dataclass(frozen=True, slots=True)
class Signal:
    """One signal a law reads or writes: its kind, and its number among its kind.

    Kinds to read: ``u`` input as it acts (after earlier effects), ``x`` state, ``y`` output, ``aux`` auxiliary signal,
    ``t`` time in s (recordings whose clocks overlap follow each other in the order given), ``p`` parameter of a model that is
    Python code. Kinds to write: ``u`` (stage "input"), ``x`` meaning the rate of change of that state ("force"), ``y`` ("output"), ``p`` ("parameter", once per sample). At the last two the input read is the one held during the sample before.

    ``ahead`` reads an input as many samples later (`MOST_AHEAD` at most), as recorded: for errors of the recording, such as a clock that is late. A law that
    does so comes before the other laws at inputs, is no part of the machine, and does nothing in a loop that is closed in simulation.
    """

    kind: Literal["u", "x", "y", "aux", "t", "p"]
    index: int = 0
    ahead: int = 0


LONG_AGO = -1e300  # s: a moment before all recordings


@dataclass(frozen=True, slots=True)
class Coefficient:
    """A parameter of a law: name, unit, range, and how it enters. With ``low == high`` it is a constant of the law.

    ``scale`` is a change that matters, used as the first step of a fit. A parameter with ``low >= 0`` is searched on a
    logarithmic scale. ``linear`` says that the law is proportional to it (together with the other linear ones).
    ``nuisance`` marks a shape parameter that sharpens the fit but is not a finding of its own, such as a rounding width.
    Where a fit ends at the upper end of the range of a ``decisive`` one, such as the damping of a resonance, something else is there, and the
    hypothesis is not compared. ``through = (state, input)`` says that the value is stated divided by that entry of B, in the ``unit`` given: a force
    where the law works with the acceleration it causes. ``unsigned`` divides by the size of the entry: what opposes the motion is positive
    although the input acts against the axis. ``later`` is the value with which the improved model has it, where that is not the fitted one: of a
    change at a moment, one that has come (`LONG_AGO`); recordings held out may show it at another moment.
    """

    name: str
    unit: str
    low: float
    high: float
    scale: float
    linear: bool = False
    nuisance: bool = False
    decisive: bool = False
    through: tuple[int, int] | None = None
    unsigned: bool = False
    later: float | None = None

    def per(self, B: Array) -> float:
        """Return what the law's value is divided by where it is stated, for the matrix ``B (n, m)`` of the plant.

        >>> import numpy as np
        >>> drag = Coefficient("drag", "N s/m", 0.0, 9.0, 0.1, through=(1, 0), unsigned=True)
        >>> drag.per(np.array([[0.0], [-4.0]]))
        4.0
        """
        entry = 1.0 if self.through is None else float(B[self.through]) or 1.0
        return abs(entry) if self.unsigned else entry

    @property
    def free(self) -> bool:
        """Whether the fit may move it."""
        return self.low < self.high


@dataclass(frozen=True, slots=True, eq=False)
class Hypothesis:
    """One physics at one site: a law, its parameters, and how to distinguish it from others.

    ``site`` is ``input:NAME``, ``state:NAME``, ``output:NAME``, ``parameter:NAME`` or ``machine``; a law of stage "force" may have the site of the
    input it concerns. ``family`` groups laws that resemble each other in data; friction that sticks is of family "friction",
    other laws with a memory of the way of family "memory". ``starts`` are starting points of the search (values in the order of
    ``parameters``), guessed from the recordings. ``unsettled`` says how many of the first cells of the memory are in the unit of the
    first signal read and begin a recording at an unknown value, such as the speed of a fan: they are fitted for every recording, as
    the initial state is, and a law adds what it begins with. Of a ``lasting`` law the memory never settles, such as the phase of a tone
    from outside: without what it begins with it adds nothing, and its fixed parameter is the size of one unit of the memory. ``substeps`` asks for that many calls per sample of a continuous model, for
    laws that act within a sample. ``linear`` returns the extended linear plant when the law is linear, given the continuous or
    discrete plant and the fitted values. ``predicts`` and ``refuted_by`` are sentences for people. ``description`` marks a law
    that describes a curve without a mechanism, such as a polynomial: a mechanism that fits as well goes before it. ``along`` is an input
    or a state (of a model that is matrices) through which a force moves all axes of a mechanism: it acts like the change of that signal which has the same effect on
    the velocity that it is written to, at the operating point. Friction where a motor turns an arm moves the pendulum on that arm, too.

    Keys of ``notes``: ``variant`` distinguishes hypotheses of one physics at one site; where one is only another shape of a
    second, ``of`` is the second's variant, and both are reported under one name. ``gauge`` names what the parameter cannot be
    distinguished from by any recording: hypotheses with the same ``gauge`` change the same product.
    """

    physics: str
    site: str
    family: str
    stage: Stage
    law: Law
    reads: tuple[Signal, ...]
    writes: tuple[Signal, ...]
    parameters: tuple[Coefficient, ...]
    starts: tuple[tuple[float, ...], ...]
    memory: int = 0
    unsettled: int = 0
    lasting: bool = False
    substeps: int = 1
    linear: Callable[[StateSpace, Sequence[float]], StateSpace] | None = None
    predicts: str = ""
    refuted_by: str = ""
    description: bool = False
    along: Signal | None = None
    notes: Mapping[str, str] = field(default_factory=dict)

    @property
    def key(self) -> str:
        """Name and site in one word, unique within a library unless ``notes["variant"]`` distinguishes two."""
        variant = self.notes.get("variant", "")
        return f"{self.physics}@{self.site}" + (f"#{variant}" if variant else "")

    @property
    def title(self) -> str:
        """Name, site and shape in words, such as "gravity (force on w; sine in place of a line)"."""
        variant = self.notes.get("variant", "")
        return f"{self.physics.replace('_', ' ')} ({site_words(self.site)}{f'; {variant}' if variant else ''})"


def site_words(site: str) -> str:
    """Return a site in words: "input voltage", "force on w", "sensor angle", "parameter friction", "machine"."""
    kind, _, name = site.partition(":")
    return {"input": f"input {name}", "state": f"force on {name}", "output": f"sensor {name}", "parameter": f"parameter {name}"}.get(kind, site)


@dataclass(frozen=True, slots=True)
class Size:
    """A signal of the machine as the recordings show it: name, unit, mean, rms about the mean, largest absolute value.

    ``step`` is the grid its values lie on, 0 when they lie on none, ``origin`` a value on it. ``reverses`` says whether it takes both
    signs: a law of two directions needs that.
    """

    index: int
    name: str
    unit: str
    mean: float
    rms: float
    peak: float
    step: float = 0.0
    origin: float = 0.0
    reverses: bool = True

    @property
    def reach(self) -> float:
        """The largest distance from the mean, as far as the peak tells, at least three times the rms."""
        return max(self.peak - abs(self.mean), 3 * self.rms)


@dataclass(frozen=True, slots=True)
class Axis:
    """A direction of motion: the states that are its position and its velocity.

    ``position`` is None where the model has the velocity only (a motor whose speed is measured). ``push`` is the rms of the
    rate of change of the velocity caused by the largest of the model's terms: the scale of a force that matters.
    ``input`` is the input that acts on the velocity at once, with gain ``gain`` (None when there is none), so that
    ``force = acceleration / gain`` can be given in the unit of the input.
    """

    name: str
    position: Size | None
    rate: Size
    push: float
    input: int | None = None
    gain: float = 1.0
    unit: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class Machine:
    """What a hypothesis may know: signals with sizes, axes of motion, sample time, and where the residual has tones.

    ``bandwidth`` is the fastest angular frequency [rad/s] that is excited, ``plant`` the nominal plant, ``residual`` the rms
    of the residual per output, shape ``(p,)``, ``tones`` angular frequencies of the residual's lines outside the
    excitation, ``peaks`` those where its spectrum stands out. ``limited`` says whether noise limits what can be seen of a law
    ("noise"), or the model ("model"): the form of a law then shows beyond its first approximation. ``deflections`` are the differences of
    two positions, by the numbers of their states, that a spring of the model couples. ``waves`` are the wave numbers [rad per unit] with which the
    residual repeats best along positions (of kind "x") and along readings of them ("y"). Of ``code`` the plant is the linearisation, and ``parameters``
    are its numbers that are not known exactly, ``mean`` their values and ``rms`` the standard deviations stated. ``driven`` says whether an input goes on
    changing in the second half of a recording: where none does, time and amplitude are one. ``span`` is the time [s] at which the first recording begins
    and at which the last one ends, on the clock that laws read; None: from zero on, ``duration`` long. ``recordings`` is their number.
    """

    inputs: tuple[Size, ...]
    outputs: tuple[Size, ...]
    states: tuple[Size, ...]
    axes: tuple[Axis, ...]
    aux: Mapping[str, Size]
    dt: float
    duration: float
    bandwidth: float
    plant: StateSpace | None
    residual: Array
    tones: tuple[float, ...] = ()
    peaks: tuple[float, ...] = ()
    limited: Literal["noise", "model"] = "noise"
    deflections: Mapping[tuple[int, int], Size] = field(default_factory=dict)
    waves: Mapping[Signal, Sequence[float]] = field(default_factory=dict)
    code: bool = False
    parameters: tuple[Size, ...] = ()
    driven: bool = True
    span: tuple[float, float] | None = None
    recordings: int = 1


class Physics(Protocol):
    """What a physics plugin hands out."""

    name: str
    summary: str

    def hypotheses(self, machine: Machine) -> Iterable[Hypothesis]:
        """Return one hypothesis per site where this physics makes sense; none when the machine has no such site."""
        ...
