"""The turboexpander's rotor modelled with ROSS, as a plant: how long it takes and how far it is from our own finite elements.

Needs the extra ``rotor``.

    python benchmarks/rotor/from_ross.py
"""

from __future__ import annotations

import os
import time

import numpy as np

from afdsvc.lti.frequency import frequency_response
from afdsvc.plants import amb_turboexpander as turbo
from afdsvc.plants.rotor.magnetic_rotor import Instrumentation, magnetic_rotor, rotor_plant
from afdsvc.plants.rotor.ross import rotor_from_ross

began, started = time.process_time(), time.perf_counter()
import ross  # noqa: E402 - its import is part of what is timed

imported = time.process_time()
steel = ross.Material("shaft_steel", rho=7850, E=2.1e11, G_s=2.1e11 / 2.6)
diameters = [mm * 1e-3 for count, mm in turbo.SHAFT for _ in range(count)]
shaft = [ross.ShaftElement(L=turbo.LENGTH, idl=0, odl=d, material=steel, n=i) for i, d in enumerate(diameters)]
wheels = [ross.DiskElement(n=w.node, m=w.mass, Id=w.diametral, Ip=w.polar) for w in turbo.WHEELS]
free = rotor_from_ross(ross.Rotor(shaft, wheels))
held = magnetic_rotor(free, turbo.BEARINGS, turbo.NOMINAL_RPM)
plant = rotor_plant(held, Instrumentation(1e-4, 0.5, 125.0, 4.0), "from ROSS", balance_grade=2.5)
plant.faults()
done, ended = time.process_time(), time.perf_counter()
w = np.geomspace(30, 20000, 60)
a, b = (frequency_response(p.continuous(), w) for p in (plant, turbo.amb_turboexpander(shear=True)))
print(f"ROSS {ross.__version__}: import {imported - began:.1f} s of processor time, rotor to plant with 12 faults {done - imported:.1f} s")
print(f"wall clock, import to plant: {ended - started:.1f} s at a load of {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores")
print("largest relative difference from our own elements:", float((np.abs(a - b).max((1, 2)) / np.abs(b).max((1, 2))).max()))
