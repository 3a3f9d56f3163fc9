"""Numbers by which the compiled loop knows the laws, and the sizes of the tables it reads."""

from __future__ import annotations

Row = list[float]  # what a law reads and writes by number; compiled, a one-dimensional array

# Where a law acts, which is its number without the last digit: on the command before it drives the plant, on the rates of
# the states, on the sensed output, on the reading (the output with its noise).
COMMAND, COMMAND_WITH_MEMORY, AXIS, AXIS_WITH_MEMORY, MACHINE, SENSOR, SENSOR_WITH_MEMORY, READING = range(8)
# What is no law: a change of the plant's constants, more noise.
CONSTANT, NOISE = -1, -2

# Without memory, on the command.
DEAD_ZONE, SATURATION, STATIC_NONLINEARITY, GAIN_FOLLOWS_AUX, PERIODIC = range(5)
# With memory, on the command.
DELAY, LAG, RESONANCE, BACKLASH, HYSTERESIS, CREEP, SLEW, MEMORY_POLYNOMIAL = range(10, 18)
# On one axis.
COULOMB, STRIBECK, QUADRATIC_DAMPING, CUBIC, QUADRATIC, CLEARANCE, CONSTANT_LOAD, PERIODIC_FORCE = range(20, 28)
# On one axis, with states or memory of their own.
FLEXIBLE_MODE, HYSTERETIC_FORCE, FRACTIONAL, STICK_SLIP = range(30, 34)
# On the machine.
GYROSCOPIC, CROSS_COUPLED, UNBALANCE, STIFFNESS_FOLLOWS_AUX, PARAMETRIC, BILINEAR = range(40, 46)
# On the sensor.
CROSSTALK, MISALIGNMENT, OFFSET, DRIFT, SENSOR_NONLINEARITY, RECTIFICATION, SENSOR_SATURATION = range(50, 57)
SENSOR_LAG, SENSOR_DELAY, RUNOUT, PERIODIC_SENSED, SENSED_GAIN_FOLLOWS_AUX = range(60, 65)
QUANTISATION = 70

PARAMETERS, PLACES, MEMORY = 8, 6, 512  # columns of the tables: values of a law, indices it acts on, its memory
