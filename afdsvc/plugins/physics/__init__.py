"""Built-in physics hypotheses: one file each."""

from __future__ import annotations

from collections.abc import Iterable

from afdsvc.api.physics import Physics
from afdsvc.plugins.hookspecs import hookimpl
from afdsvc.plugins.physics.actuator_crosstalk import ActuatorCrosstalk
from afdsvc.plugins.physics.actuator_lag import ActuatorLag
from afdsvc.plugins.physics.asymmetric_damping import AsymmetricDamping
from afdsvc.plugins.physics.back_emf import BackEmf
from afdsvc.plugins.physics.backlash import Backlash
from afdsvc.plugins.physics.clearance import Clearance
from afdsvc.plugins.physics.clock_offset import ClockOffset
from afdsvc.plugins.physics.cogging import Cogging
from afdsvc.plugins.physics.coloured_noise import ColouredNoise
from afdsvc.plugins.physics.constant_load import ConstantLoad
from afdsvc.plugins.physics.coulomb_friction import CoulombFriction
from afdsvc.plugins.physics.creep import Creep
from afdsvc.plugins.physics.cross_coupled_stiffness import CrossCoupledStiffness
from afdsvc.plugins.physics.cubic_damping import CubicDamping
from afdsvc.plugins.physics.cubic_stiffness import CubicStiffness
from afdsvc.plugins.physics.dead_zone import DeadZone
from afdsvc.plugins.physics.eccentricity import Eccentricity
from afdsvc.plugins.physics.encoder_error import EncoderError
from afdsvc.plugins.physics.exchange import Exchange
from afdsvc.plugins.physics.flexible_mode import FlexibleMode
from afdsvc.plugins.physics.gain_follows_aux import GainFollowsAux
from afdsvc.plugins.physics.gain_follows_level import GainFollowsLevel
from afdsvc.plugins.physics.gain_follows_position import GainFollowsPosition
from afdsvc.plugins.physics.gravity import Gravity
from afdsvc.plugins.physics.gyroscopic_coupling import GyroscopicCoupling
from afdsvc.plugins.physics.hysteresis import Hysteresis
from afdsvc.plugins.physics.inertia_follows_position import InertiaFollowsPosition
from afdsvc.plugins.physics.linear_stiffness import LinearStiffness
from afdsvc.plugins.physics.magnetic_force import MagneticForce
from afdsvc.plugins.physics.offset_step import OffsetStep
from afdsvc.plugins.physics.parameter_change import ParameterChange
from afdsvc.plugins.physics.parameter_drift import ParameterDrift
from afdsvc.plugins.physics.parameter_follows_state import ParameterFollowsState
from afdsvc.plugins.physics.parameter_step import ParameterStep
from afdsvc.plugins.physics.periodic_disturbance import PeriodicDisturbance
from afdsvc.plugins.physics.quadratic_damping import QuadraticDamping
from afdsvc.plugins.physics.quadratic_stiffness import QuadraticStiffness
from afdsvc.plugins.physics.quantisation import Quantisation
from afdsvc.plugins.physics.relaxation import Relaxation
from afdsvc.plugins.physics.repulsion import Repulsion
from afdsvc.plugins.physics.resonant_actuator import ResonantActuator
from afdsvc.plugins.physics.runout import Runout
from afdsvc.plugins.physics.saturation import Saturation
from afdsvc.plugins.physics.self_heating import SelfHeating
from afdsvc.plugins.physics.sensor_ac_coupling import SensorAcCoupling
from afdsvc.plugins.physics.sensor_crosstalk import SensorCrosstalk
from afdsvc.plugins.physics.sensor_drift import SensorDrift
from afdsvc.plugins.physics.sensor_lag import SensorLag
from afdsvc.plugins.physics.sensor_misalignment import SensorMisalignment
from afdsvc.plugins.physics.sensor_nonlinearity import SensorNonlinearity
from afdsvc.plugins.physics.sensor_offset import SensorOffset
from afdsvc.plugins.physics.sensor_rectification import SensorRectification
from afdsvc.plugins.physics.sensor_saturation import SensorSaturation
from afdsvc.plugins.physics.slew_limit import SlewLimit
from afdsvc.plugins.physics.slow_mode import SlowMode
from afdsvc.plugins.physics.static_nonlinearity import StaticNonlinearity
from afdsvc.plugins.physics.stiffness_follows_aux import StiffnessFollowsAux
from afdsvc.plugins.physics.stribeck_friction import StribeckFriction
from afdsvc.plugins.physics.supply_droop import SupplyDroop
from afdsvc.plugins.physics.transport_delay import TransportDelay
from afdsvc.plugins.physics.unbalance import Unbalance
from afdsvc.plugins.physics.velocity_coupling import VelocityCoupling
from afdsvc.plugins.physics.viscous_damping import ViscousDamping
from afdsvc.plugins.physics.voltage_drop import VoltageDrop

BUILT_IN = (
    ActuatorCrosstalk, ActuatorLag, AsymmetricDamping, BackEmf, Backlash, Clearance, ClockOffset, Cogging, ColouredNoise, ConstantLoad,
    CoulombFriction, Creep, CrossCoupledStiffness, CubicDamping, CubicStiffness, DeadZone, Eccentricity, EncoderError, Exchange, FlexibleMode,
    GainFollowsAux, GainFollowsLevel, GainFollowsPosition, Gravity, GyroscopicCoupling, Hysteresis, InertiaFollowsPosition, LinearStiffness, MagneticForce,
    OffsetStep, ParameterChange, ParameterDrift, ParameterFollowsState, ParameterStep, PeriodicDisturbance, QuadraticDamping, QuadraticStiffness, Quantisation,
    Relaxation, Repulsion, ResonantActuator, Runout, Saturation, SelfHeating, SensorAcCoupling, SensorCrosstalk, SensorDrift, SensorLag, SensorMisalignment,
    SensorNonlinearity, SensorOffset, SensorRectification, SensorSaturation, SlewLimit, SlowMode,
    StaticNonlinearity, StiffnessFollowsAux, StribeckFriction, SupplyDroop, TransportDelay, Unbalance, VelocityCoupling, ViscousDamping, VoltageDrop,
)


@hookimpl
def afdsvc_physics() -> Iterable[Physics]:
    """Offer every built-in hypothesis."""
    return [physics() for physics in BUILT_IN]
