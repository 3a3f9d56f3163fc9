"""The active gas bearing of the thesis, in all its forms.

A disc on a flexible shaft is held by gas whose flow piezo actuators control; displacements are measured horizontally
and vertically [um], the inputs are actuator voltages [V]. Stiffness K [1/s^2], damping D [1/s] and input gain B
[um/(s^2 V)] are specific, that is divided by the moving mass, and act as ``l'' = D l' + K l + B a``; p are actuator
poles [rad/s].

Source: A. K. Sekunda, "Fault Diagnosis and Identification of Electro-Mechanical Systems", PhD thesis, Technical
University of Denmark, 2017: eqs. 3.1-3.12, publication P3 eqs. 22-25, publication P5 eqs. 1-8 and tables 0.1, 0.2.
Noise variances 0.12 and 0.15 um^2 are those of P5 section 6, the 10 um displacement limit that of thesis section 3.1.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from afdsvc.api.model import Quantity, Variable
from afdsvc.api.plant import Build, PhysicalPlant
from afdsvc.errors import BadInput
from afdsvc.lti.statespace import Array, StateSpace

SAMPLE_TIME = 2e-4  # s; thesis section 3.3
DISPLACEMENT_LIMIT = 10.0  # um; thesis section 3.1: beyond it the rig may be damaged
VOLTAGE_LIMIT = (
    10.0  # V; full scale of the rig's dSPACE converters (no limit is printed; 10 um needs about 4 V at rest)
)
NOISE_VARIANCE = (0.12, 0.15)  # um^2, horizontal and vertical; P5 section 6

AXES = ("horizontal", "vertical")
FAULTS = {
    "horizontal_actuator": ("input", 0),
    "vertical_actuator": ("input", 1),
    "horizontal_sensor": ("output", 0),
    "vertical_sensor": ("output", 1),
}

Values = Mapping[str, tuple[tuple[float, float], tuple[float, float]] | tuple[float, float]]

# P5 table 0.1: no rotation, identified by a grey-box prediction error method.
TABLE_0_1: Values = {
    "K": ((-1.79e6, 1.726e4), (1.061e4, -1.926e6)),
    "D": ((-283.2, -13.82), (-8.152, -219.7)),
    "B": ((4.318e6, -2.672e5), (9.204e4, 4.81e6)),
    "P": (1021.0, 944.5),
}
# P5 table 0.2: 1100 rpm, with three signs and an exponent corrected (D22, B11, B12); as printed the plant is unstable,
# although the paper calls it stable, and no scalar gain in the range of its root locus stabilises it.
TABLE_0_2: Values = {
    "K": ((-1.79e6, 3.43e4), (3.171e4, -1.931e6)),
    "D": ((-241.6, 45.97), (7.94, -212.1)),
    "B": ((4.446e6, 7.887e4), (6085.0, 4.853e6)),
    "P": (898.9, 955.7),
}
TABLE_0_2_AS_PRINTED: Values = {
    "K": ((-1.79e6, 3.43e4), (3.171e4, -1.931e6)),
    "D": ((-241.6, 45.97), (7.94, 212.1)),
    "B": ((-4.446e6, 7.887e7), (6085.0, 4.853e6)),
    "P": (898.9, 955.7),
}
# Thesis eqs. 3.9-3.12: no rotation, an earlier identification with the opposite sign of B.
EQUATIONS_3_9: Values = {
    "K": ((-1.869e6, -8577.0), (-9510.0, -1.737e6)),
    "D": ((-224.9, 3.97), (9.12, -267.7)),
    "B": ((-6.126e6, 3.154e5), (-1.571e5, -4.516e6)),
    "P": (989.0, 942.5),
}
PARAMETER_SETS: dict[str, Values] = {
    "table_0_1": TABLE_0_1,
    "table_0_2": TABLE_0_2,
    "table_0_2_as_printed": TABLE_0_2_AS_PRINTED,
    "equations_3_9": EQUATIONS_3_9,
}
FORMS = ("first_order_actuators", "delay", "second_order_actuators")


FASTEST_RPM = 1100


def gas_bearing(
    rpm: float = 0, parameters: str | None = None, form: str = "first_order_actuators", sample_time: float = SAMPLE_TIME
) -> PhysicalPlant:
    """Return the gas bearing at 0 or 1100 rpm (P5 tables 0.1 and 0.2 corrected), or with another published parameter
    set. Between the two speeds every parameter is interpolated linearly; there are no measurements between them.

    ``form`` is the way the actuators are modelled:

    - ``first_order_actuators``: 6 states (thesis 3.7, P5 4-8), a first-order lag per axis with the printed pole;
    - ``delay``: 6 states (P3 22-25), a first-order all-pass (Tustin) per axis standing for a transport delay;
    - ``second_order_actuators``: 10 states (thesis 3.3-3.6, actuator first), two lags per axis and the delay.

    The thesis prints no delay and no second-order poles: the delay defaults to 1/p of the printed pole p (then both
    6-state forms lag alike at low frequency), the actuator poles of the 10-state form to p and 10 p with the delay a
    tenth of 1/p. Raises `BadInput` for an unknown rpm, parameter set or form.
    """
    name, values = _values(rpm, parameters)
    if form not in FORMS:
        raise BadInput(f"the gas bearing has no form '{form}'; it has {', '.join(FORMS)}")
    build, extra, states = _FORMS[form](values)

    def at_speed(speed: float) -> PhysicalPlant:
        return gas_bearing(_round_rpm(speed), None, form, sample_time)

    return PhysicalPlant(
        name=f"gas bearing, {name}, {form}",
        inputs=tuple(Variable(axis, "V") for axis in AXES),
        outputs=tuple(Variable(axis, "um") for axis in AXES),
        states=(*_BODY_STATES, *states),
        parameters={**_body_parameters(values), **extra},
        build=build,
        sample_time=sample_time,
        output_cov=np.diag(NOISE_VARIANCE),
        output_limit=np.full(2, DISPLACEMENT_LIMIT),
        input_limit=np.full(2, VOLTAGE_LIMIT),
        fault_sites=FAULTS,
        source="A. K. Sekunda, PhD thesis, DTU 2017, publication P5 and chapter 3",
        recommended={"lqg": _weights(2 + len(states)), "proportional": _weights(2 + len(states))},
        speed=2 * np.pi * rpm / 60,
        at_speed=None if parameters else at_speed,
    )


def _weights(after_velocities: int) -> dict[str, Any]:
    """Return LQ and observer weights that reproduce every printed digit of F in P5 (12) from table 0.1."""
    velocities = [0.0, 0.0, 1e-4, 1e-4] + [0.0] * (after_velocities - 2)
    return {"state_weight": velocities, "input_weight": 1.0, "process_weight": 0.01, "noise_weight": 1.0}


def _values(rpm: float, parameters: str | None) -> tuple[str, Values]:
    """Return the name and the values of a parameter set, or those for a speed."""
    if parameters is not None:
        if parameters not in PARAMETER_SETS:
            raise BadInput(f"the gas bearing has no parameter set '{parameters}'; it has {', '.join(PARAMETER_SETS)}")
        return parameters, PARAMETER_SETS[parameters]
    if rpm in (0, FASTEST_RPM):
        name = "table_0_2" if rpm else "table_0_1"
        return name, PARAMETER_SETS[name]
    if not 0 < rpm < FASTEST_RPM:
        raise BadInput(f"the gas bearing was identified at 0 and {FASTEST_RPM} rpm, not at {rpm:g}; a speed between them is interpolated")
    return f"{rpm:g} rpm interpolated", _between(rpm / FASTEST_RPM)


def _between(share: float) -> Values:
    """Return the parameters at a share of the way from standstill to the faster published speed."""
    def mixed(key: str) -> Any:
        return ((1 - share) * np.asarray(TABLE_0_1[key]) + share * np.asarray(TABLE_0_2[key])).tolist()

    return {key: mixed(key) for key in TABLE_0_1}


def _round_rpm(speed: float) -> float:
    """Return rpm of a speed [rad/s], without the rounding of the conversion."""
    return float(np.round(speed * 30 / np.pi, 9))


_BODY_STATES = (
    Variable("horizontal", "um"),
    Variable("vertical", "um"),
    Variable("horizontal_rate", "um/s", rate_of="horizontal"),
    Variable("vertical_rate", "um/s", rate_of="vertical"),
)


def _body_parameters(values: Values) -> dict[str, Quantity]:
    """Return stiffness, damping and input gain entry by entry, and the moving mass relative to its nominal value."""
    out = {"mass": Quantity(1.0, "1")}
    for word, key, unit in (("stiffness", "K", "1/s^2"), ("damping", "D", "1/s"), ("gain", "B", "um/(s^2 V)")):
        for i, row in enumerate("hv"):
            for j, column in enumerate("hv"):
                out[f"{word}_{row}{column}"] = Quantity(np.asarray(values[key])[i, j].item(), unit)
    return out


def _matrix(p: Mapping[str, float], word: str) -> Array:
    """Return a specific matrix from its entries, divided by the relative mass."""
    return np.array([[p[f"{word}_{row}{column}"] for column in "hv"] for row in "hv"]) / p["mass"]


def _diagonal(p: Mapping[str, float], word: str) -> Array:
    return np.diag([p[f"{word}_h"], p[f"{word}_v"]])


def _pair(word: str, values: tuple[float, float], unit: str) -> dict[str, Quantity]:
    return {f"{word}_{axis}": Quantity(value, unit) for axis, value in zip("hv", values, strict=True)}


def _poles(values: Values) -> tuple[float, float]:
    h, v = np.asarray(values["P"]).tolist()
    return float(h), float(v)


_O, _I = np.zeros((2, 2)), np.eye(2)


def _body(p: Mapping[str, float], drive: Array) -> tuple[Array, Array]:
    """Return the rows of position and velocity; ``drive`` is the block from the actuator states to acceleration."""
    zero = np.zeros((2, drive.shape[1]))
    return np.hstack([_O, _I, zero]), np.hstack([_matrix(p, "stiffness"), _matrix(p, "damping"), drive])


Parts = tuple[Build, dict[str, Quantity], tuple[Variable, ...]]


def _first_order(values: Values) -> Parts:
    def build(p: Mapping[str, float]) -> StateSpace:
        pole = _diagonal(p, "pole")
        position, velocity = _body(p, _matrix(p, "gain"))
        A = np.vstack([position, velocity, np.hstack([_O, _O, -pole])])
        return StateSpace.of(A, np.vstack([_O, _O, pole]), np.hstack([_I, _O, _O]), _O)

    states = (Variable("horizontal_valve", "V"), Variable("vertical_valve", "V"))
    return build, _pair("pole", _poles(values), "rad/s"), states


def _delay(values: Values) -> Parts:
    def build(p: Mapping[str, float]) -> StateSpace:
        rate = 2 * np.linalg.inv(_diagonal(p, "delay"))
        B = _matrix(p, "gain")
        position, velocity = _body(p, 2 * B @ rate)
        A = np.vstack([position, velocity, np.hstack([_O, _O, -rate])])
        return StateSpace.of(A, np.vstack([_O, -B, _I]), np.hstack([_I, _O, _O]), _O)

    h, v = _poles(values)
    states = (Variable("horizontal_delay", "V s"), Variable("vertical_delay", "V s"))
    return build, _pair("delay", (1 / h, 1 / v), "s"), states


def _second_order(values: Values) -> Parts:
    def build(p: Mapping[str, float]) -> StateSpace:
        rate = 2 * np.linalg.inv(_diagonal(p, "delay"))
        first, second = _diagonal(p, "pole"), _diagonal(p, "second_pole")
        B = _matrix(p, "gain")
        position, velocity = _body(p, np.hstack([2 * B @ rate, _O, -B]))
        A = np.vstack(
            [
                position,
                velocity,
                np.hstack([_O, _O, -rate, _O, _I]),
                np.hstack([_O, _O, _O, -first, _O]),
                np.hstack([_O, _O, _O, second, -second]),
            ]
        )
        gain = _diagonal(p, "actuator_gain")
        return StateSpace.of(A, np.vstack([_O, _O, _O, first @ gain, _O]), np.hstack([_I, *[_O] * 4]), _O)

    h, v = _poles(values)
    extra = {
        **_pair("delay", (0.1 / h, 0.1 / v), "s"),
        **_pair("pole", (h, v), "rad/s"),
        **_pair("second_pole", (10 * h, 10 * v), "rad/s"),
        **_pair("actuator_gain", (1.0, 1.0), "1"),
    }
    states = tuple(
        Variable(f"{axis}_{word}", unit)
        for word, unit in (("delay", "V s"), ("lag", "V"), ("valve", "V"))
        for axis in AXES
    )
    return build, extra, states


_FORMS = {"first_order_actuators": _first_order, "delay": _delay, "second_order_actuators": _second_order}
