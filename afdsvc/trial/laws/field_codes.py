"""Numbers by which the compiled loop of the field trials knows its laws, and the sizes of its tables."""

from __future__ import annotations

# Where a law acts is its number divided by `GROUP`: on the held command once per integration step, on the command inside the
# plant, as a force on an axis (two groups), as a characteristic of the process, as a further branch of it, on the sensor, on
# the reading with its noise. CONSTANT is no law: it changes one constant of the plant.
GROUP = 20
HELD, FLOW, FORCE, MORE_FORCE, CHARACTERISTIC, BRANCH, SENSOR, READOUT = range(8)
CONSTANT = -1

UNEVEN_ZONE, STICKY_ZONE, POWER_CURVE, UNEVEN_LIMIT, PLAYS, SOFT_PLAY, GRID, LATE, SOFT_SLEW, LAME, FOLLOWS = range(11)
TWO_LAGS, RINGING, DROOP, RELAXING, PATCHY_GAIN = range(20, 25)
DRY, STRIBECK, WARMING, PRESSED, BRISTLE, PATCHY, BOUC_WEN = range(40, 47)
DRAG, SLOW_DRAG, ONE_WAY, EMF, SPEED_LIMIT = range(47, 52)
HARDENING, LEANING, GAP, WEIGHT, RIPPLE, RIDER, LOAD, TONE = range(60, 68)
ROOT, MAGNET, INDUCTANCE, HEATING, RADIATION, HARD_SHAFT, LOOSE_SHAFT = range(80, 87)
SPILL, STORE = range(100, 102)
TWO_POLES, CLIPPED, BENT, WARM_UP, CROSSED, ECCENTRIC = range(120, 126)
COARSE = 140

# A law is one row of the table: its code, its place, its first own state, then its values.
CODE, PLACE, OWN, VALUES = range(4)
COLUMNS, MEMORY = 9, 4096
SHARP = (DRY, STRIBECK, WARMING, PRESSED, PATCHY)  # laws with a steep flank: they are integrated in finer steps
