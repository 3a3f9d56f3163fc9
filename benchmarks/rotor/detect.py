"""One burst on the turboexpander at 31,500 rpm with unbalance of grade G2.5 and 0.5 um noise, through the service's pipeline.

    python benchmarks/rotor/detect.py faults            every stiffness, actuator and sensor fault at -20 %
    python benchmarks/rotor/detect.py quiet --bursts 200    alarms at a promised rate of one in ten bursts
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np
from scipy.stats import beta

sys.path.insert(0, str(Path(__file__).parent))
from machine import machine, plugins, run

KINDS = ("matched_filter", "regression")
RATE = 0.1  # promised alarms per burst in the study of quiet bursts: one that a few hundred bursts can check


def faults(controller: str, severity: float, driver: dict) -> None:
    """Print what every detector says about every fault, one burst each."""
    installed = plugins()
    names = machine(installed).augmented.fault_names
    burst = None
    print("fault: detector, statistic / threshold, named, severity; largest displacement [um]")
    for seed, name in enumerate(names):
        settings = {"controller": {"kind": controller}, "detectors": [{"kind": k} for k in KINDS], "driver": driver}
        parts = machine(installed, {name: (severity, 0.0)}, seed, **settings)
        found = run(parts, installed, [0.7, "burst"], burst)
        burst = found.bursts[0]
        reported = [
            f"{e.detector} {e.statistic:.1f}/{e.threshold:.2f}{'' if e.detected else ' NOT DETECTED ' + e.reason}, {e.fault}, "
            f"{'-' if e.severity is None else f'{e.severity.value:.3f} +- {e.severity.sd:.3f}'}"
            for e in found.evidence
        ]
        print(f"{name}: {'; '.join(reported)}; {found.peak:.1f} um", flush=True)


def quiet(bursts: int, seed: int, driver: dict) -> None:
    """Print how many healthy bursts raise an alarm when one in ten is promised, and how many the gate refuses."""
    installed = plugins()
    detectors = [{"kind": k, "false_alarms_per_1000_bursts": 1000 * RATE} for k in KINDS]
    parts = machine(installed, seed=seed, detectors=detectors, bursts={"severity": -0.2, "seconds": 1.0}, driver=driver)
    found = run(parts, installed, [0.7, *(["burst", 0.4] * bursts)])
    for kind in KINDS:
        mine = [e for e in found.evidence if e.detector == kind]
        alarms, refused = sum(e.statistic > e.threshold for e in mine), sum(not e.trustworthy for e in mine)
        low, high = beta.ppf([0.005, 0.995], [alarms, alarms + 1], [len(mine) - alarms + 1, len(mine) - alarms])
        print(f"{kind}: {alarms} of {len(mine)} bursts above the threshold, promised {RATE:.0%}, 99 % interval {low:.3f} to {high:.3f}; {refused} refused")
    print("largest displacement [um]:", round(found.peak, 2), "said:", sorted(set(found.said)), "p of whiteness, smallest:", np.nanmin([e.p_white for e in found.evidence]))


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("what", choices=["faults", "quiet"])
    parser.add_argument("--bursts", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--controller", default="lqg")
    parser.add_argument("--severity", type=float, default=-0.2)
    parser.add_argument("--full", action="store_true", help="all 320 states are simulated; the model keeps 8")
    wanted = parser.parse_args()
    simulated = {"options": {"states": 320}} if wanted.full else {}
    if wanted.what == "faults":
        faults(wanted.controller, wanted.severity, simulated)
    else:
        quiet(wanted.bursts, wanted.seed, simulated)
