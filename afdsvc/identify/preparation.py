"""From a model and traces to matching arrays; every mismatch is named."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import linalg

from afdsvc.api.model import Model
from afdsvc.api.signals import Trace
from afdsvc.dataset.arrays import InputOutputData, together
from afdsvc.dataset.periods import without_rotation
from afdsvc.dataset.screening import require_sizes, screen, screening_notes, without_gaps
from afdsvc.dataset.split import still_readings
from afdsvc.errors import BadInput
from afdsvc.identify.methods.hansen import settling_samples
from afdsvc.identify.parameters.structure import model_structure
from afdsvc.identify.settings import SETTINGS
from afdsvc.lti.coprime import Factorisation
from afdsvc.lti.python_control import factorise
from afdsvc.lti.sampling import sample_zoh
from afdsvc.lti.simulate import simulate
from afdsvc.lti.statespace import Array, StateSpace

#: Samples over which that is checked.
_CHECKED = 20_000


@dataclass(frozen=True, slots=True, eq=False)
class Prepared:
    """Everything a method needs: the nominal plant at the recordings' sample time, the controller and their factors
    (None without a controller), and the recordings of u and y with the operating point removed. ``played`` holds the
    recorded alpha in place of u where alpha excites the loop and no reference does, and is empty otherwise.
    """

    model: Model
    nominal: StateSpace
    fact: Factorisation | None
    training: tuple[InputOutputData, ...]
    heldout: tuple[InputOutputData, ...]
    closed_loop_signs: tuple[str, ...]
    played: tuple[InputOutputData, ...] = ()
    notes: tuple[str, ...] = ()

    @property
    def slowest(self) -> float:
        """Slowest time constant of the nominal loop (or plant) in samples."""
        return settling_samples(self.fact.R if self.fact is not None else self.nominal, float(np.exp(-1)))


def prepare_problem(model: Model, traces: Sequence[Trace], heldout: Sequence[Trace], needed: int, screening: bool | None = None) -> Prepared:
    """Return the prepared problem; raises `BadInput` for whatever does not fit, naming file, field and value.

    Where the rotor angle was recorded, what turns with it is taken out of every signal. ``screening``: refuse recordings that `screen` refuses
    (None: where a controller is known, which a saturated actuator or a drift contradicts); else they are fitted, cut at missing samples, and
    the notes say so.
    """
    if not traces:
        raise BadInput("no recording was handed in; expected at least one")
    if not model.inputs:
        raise BadInput(f"model '{model.name}' has no inputs; expected at least one, since a response is identified; 'explain' takes free motion")
    for trace in (*traces, *heldout):
        require_sizes(trace)
    notes: list[str] = []
    if model.controller is not None if screening is None else screening:
        for trace in (*traces, *heldout):
            screen(trace, needed)
    else:
        traces, heldout = (_kept(several, needed, notes) for several in (traces, heldout))
    traces, heldout = ([without_rotation(t) for t in several] for several in (traces, heldout))
    training, away = [_recording(model, t) for t in traces], [_recording(model, t) for t in heldout]
    together(training + away)
    for name, said in still_readings(model.outputs, np.concatenate([r.y for r in training])):
        raise BadInput(f"output '{name}' {said}, or a model without it")
    dt = traces[0].dt
    nominal = nominal_plant(model, dt)
    fact = None if model.controller is None else factorise(nominal, _controller_at(model.controller, dt))
    if fact is not None:
        for trace, recording in zip((*traces, *heldout), (*training, *away), strict=True):
            _require_controller(fact, model, trace, recording)
    signs = tuple(c.name for c in traces[0].channels if c.role in ("alpha", "beta", "ref"))
    played = tuple(_played(model, t, r) for t, r in zip(traces, training, strict=True))
    played = played if any(p.u.any() for p in played) and not any(_referenced(model, t) for t in traces) else ()
    return Prepared(model, nominal, fact, tuple(r.centred() for r in training), tuple(away), signs, played, tuple(notes))


def _kept(traces: Sequence[Trace], needed: int, notes: list[str]) -> list[Trace]:
    """Return the stretches without gaps that hold ``needed`` samples, and note what was found; raises `BadInput` where none is left."""
    kept = []
    for trace in traces:
        pieces = [piece for piece in without_gaps(trace) if len(piece) >= needed]
        if not pieces:
            screen(trace, needed)  # says why
        if len(pieces) > 1 or len(pieces[0]) < len(trace):
            notes.append(f"{trace.name}: samples are missing; fitted {len(pieces)} stretches without gaps, {sum(map(len, pieces))} of {len(trace)} samples")
        notes += [f"fitted in spite of this: {sentence}" for piece in pieces for sentence in screening_notes(piece)]
        kept += pieces
    return kept


def nominal_plant(model: Model, dt: float) -> StateSpace:
    """Return the model's plant at a sample time, inputs held; a simulator is linearised around rest.

    Raises `BadInput` where it grows beyond all numbers within a sample.
    """
    plant = model.plant
    if plant is None:
        structure = model_structure(model)
        plant = structure.build(structure.values)
    if not plant.discrete:
        with np.errstate(all="ignore"):
            sampled = sample_zoh(plant, dt)
        if not all(np.isfinite(M).all() for M in (sampled.A, sampled.B)):
            raise BadInput(f"model '{model.name}' grows beyond all numbers within a sample of {dt:g} s; expected poles and gains that samples can follow: are its units those of the recordings?")
        return sampled
    if not np.isclose(plant.dt, dt, rtol=1e-6):
        raise BadInput(
            f"model '{model.name}' has sample_time {plant.dt} s, the recordings {dt} s; expected equal ones"
        )
    return plant


def _controller_at(controller: StateSpace, dt: float) -> StateSpace:
    """Return the controller at the sample time; a continuous one with states is refused (how it was sampled
    matters)."""
    if not controller.order:
        return StateSpace.gain(controller.D, dt)
    if not controller.discrete:
        raise BadInput('the controller is given in continuous time; give the discrete one that ran (time = "discrete")')
    if not np.isclose(controller.dt, dt, rtol=1e-6):
        raise BadInput(
            f"the controller has sample_time {controller.dt} s, the recordings {dt} s; expected equal ones"
        )
    return controller


def _require_controller(fact: Factorisation, model: Model, trace: Trace, recording: InputOutputData) -> None:
    """Raise `BadInput` when the recorded excitation shows that another controller ran than the model names.

    ``Vt u - Ut y`` must be alpha (through a fixed filter) minus ``Ut ref``; the remainder is compared with
    ``Ut y``. Without recorded excitation nothing can be checked.
    """
    alpha = _columns(trace, "alpha", [v.name for v in model.inputs], optional=True)
    ref = _columns(trace, "ref", [v.name for v in model.outputs], optional=True)
    if not alpha.any() and not ref.any():
        return
    m = fact.plant.inputs
    start = min(settling_samples(fact.Lf), len(recording) // 2)
    recording, alpha, ref = recording.span(0, start + _CHECKED), alpha[: start + _CHECKED], ref[: start + _CHECKED]
    signals = np.stack(
        [
            simulate(fact.Lf, np.hstack(pair))[0][start:, :m]
            for pair in (
                (recording.u, recording.y),
                (np.zeros_like(recording.u), ref),
                (np.zeros_like(recording.u), recording.y),
            )
        ]
    )
    external, action = signals[0] - signals[1], signals[2]
    left = external - _explained(external, alpha[start:])
    share = float(
        ((left - left.mean(axis=0)) ** 2).sum() / max(float(((action - action.mean(axis=0)) ** 2).sum()), 1e-300)
    )
    if share > SETTINGS.controller_mismatch:
        raise BadInput(
            f"{trace.name}: the recorded input is not what the model's controller makes of the recorded output "
            "and excitation "
            f"({100 * share:.3g} % of its action unexplained, expected at most {100 * SETTINGS.controller_mismatch:.2g} %): another controller "
            f"ran, or the actuator saturated; correct [controller]"
        )


def _explained(signal: Array, alpha: Array, lags: int = 40) -> Array:
    """Return the part of a signal that a filter of alpha explains (identity when the same factors made alpha)."""
    if not alpha.any():
        return np.zeros_like(signal)
    if float(np.abs(signal - alpha).max()) < 1e-6 * float(np.abs(alpha).max()):
        return signal
    window = np.lib.stride_tricks.sliding_window_view(
        np.vstack([np.zeros((lags, alpha.shape[1])), alpha]), lags + 1, axis=0
    )
    rows = window.reshape(len(alpha), -1)
    solution = linalg.lstsq(rows, signal, lapack_driver="gelsy")[0]
    return np.asarray(rows @ solution)


def _played(model: Model, trace: Trace, recording: InputOutputData) -> InputOutputData:
    return replace(recording, u=_columns(trace, "alpha", [v.name for v in model.inputs], optional=True))


def _referenced(model: Model, trace: Trace) -> bool:
    return bool(np.ptp(_columns(trace, "ref", [v.name for v in model.outputs], optional=True), axis=0).any())


def _recording(model: Model, trace: Trace) -> InputOutputData:
    u = _columns(trace, "u", [v.name for v in model.inputs])
    y = _columns(trace, "y", [v.name for v in model.outputs])
    return InputOutputData.of(u, y, trace.dt, trace.name)


def _columns(trace: Trace, role: str, names: Sequence[str], optional: bool = False) -> Array:
    """Return one role in the model's order; a missing optional column is zero, any other `BadInput`."""
    columns = [f"{role}_{name}" for name in names]
    return np.column_stack([np.zeros(len(trace)) if optional and not trace.has(name) else trace.column(name) for name in columns])
