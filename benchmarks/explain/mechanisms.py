"""Names given by `afdsvc explain` to drawn machines that lack one effect: motors, springs, pendulums, servos, two masses.

    python benchmarks/explain/mechanisms.py SEED COUNT

The machine, its numbers, the effect, the excitation (random steps, filtered noise, chirps, sines that do not repeat), sensor noise and a
coloured disturbance at the input are drawn; the model's numbers are off by 7 % (standard deviation) where 10 % are stated. The effect's
size is such that the best linear gain leaves 10 to 40 % of the output. The simulator shares no code with the product. The search was developed with seeds 1 to 43.
"""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from numba import njit
from numpy.random import Generator
from scipy.signal import chirp, lfilter

from afdsvc.app.explain import ExplainOptions, explain_files
from afdsvc.errors import BadInput

SUBSTEPS = 16
FRICTION = ("coulomb_friction", "stribeck_friction")
EFFECTS = {  # every effect with the names that are right
    "none": (), "coulomb": FRICTION, "stribeck": FRICTION, "quadratic": ("quadratic_damping",), "dead_zone": ("dead_zone",),
    "saturation": ("saturation",), "lag": ("actuator_lag",), "delay": ("transport_delay",), "slew": ("slew_limit",),
    "sensor": ("sensor_nonlinearity", "static_nonlinearity"), "curve": ("static_nonlinearity",), "cubic": ("cubic_stiffness",),
    "clearance": ("clearance", "backlash"), "cogging": ("cogging",), "hysteresis": ("hysteresis",), "backlash": ("backlash", "hysteresis"),
}  # fmt: skip
CODE = {name: k for k, name in enumerate(EFFECTS)}
ANYWHERE = ("none", "coulomb", "stribeck", "quadratic", "dead_zone", "saturation", "lag", "delay", "slew", "sensor")
OWN = {
    "motor": ("curve",), "spring": ("cubic", "clearance", "cogging", "curve", "hysteresis"), "pendulum": ("cogging",),
    "two masses": ("clearance", "cubic"), "servo": ("cogging", "backlash"),
}  # fmt: skip


@njit(cache=True)
def simulated(coupled, effect, size, g, k, c, c2, ratio, wave, stribeck, loop, u, pushed, dt):  # type: ignore[no-untyped-def]  # noqa: C901 - one compiled loop
    """Return position and speed of the driven mass and of the second one, ``(n, 4)``; semi-implicit steps, friction as a threshold."""
    out, h = np.empty((len(u), 4)), dt / SUBSTEPS
    q = v = q2 = v2 = act = z = 0.0
    late = int(round(size / dt)) if effect == 7 else 0
    for n in range(len(u)):
        out[n, 0], out[n, 1], out[n, 2], out[n, 3] = q, v, q2, v2
        w = u[max(n - late, 0)]
        if effect == 4:
            w = np.sign(w) * max(abs(w) - size, 0.0)
        elif effect == 5:
            w = min(max(w, -size), size)
        elif effect == 10:
            w = (1 - size) * w + size * w * abs(w)
        for _ in range(SUBSTEPS):
            if effect == 6:
                act += h * (w - act) / size
            elif effect == 8:
                act += min(max(w - act, -size * h), size * h)
            elif effect == 15:
                act = min(max(act, w - size), w + size)
            else:
                act = w
            x = q - q2
            s = np.sign(x) * max(abs(x) - size, 0.0) if effect == 12 else x
            spring = k * s + (size * x**3 if effect == 11 else 0.0)
            force = loop * (g * (act + pushed[n]) - q) if loop > 0 else g * (act + pushed[n])
            force -= c * v + spring
            if effect == 13:
                force -= size * np.sin(wave * q)
            elif effect == 3:
                force -= size * v * abs(v)
            elif effect == 14:
                z += h * (v - stribeck * (abs(v) * z + 0.3 * v * abs(z)))
                force -= size * z
            rub = size if effect == 1 else size * (1 + 0.8 * np.exp(-((v / stribeck) ** 2))) if effect == 2 else 0.0
            v += h * force
            v = np.sign(v) * max(abs(v) - h * rub, 0.0)
            q += h * v
            if coupled:
                v2 += h * (spring - c2 * v2) / ratio
                q2 += h * v2
    return out


def numbers(machine: str, rng: Generator) -> tuple[dict[str, float], float]:
    """Return the numbers of a machine and its time scale [s]."""
    w = rng.uniform(3, 8) if machine == "pendulum" else 1 / rng.uniform(0.05, 2.0)
    common = {"g": w * w * rng.uniform(0.3, 3), "k": w * w, "c": 2 * w * rng.uniform(0.05, 0.5), "c2": 0.0, "ratio": 1.0, "loop": 0.0}
    if machine == "motor":
        return {**common, "g": w * rng.uniform(0.5, 20), "k": 0.0, "c": w}, 1 / w
    if machine == "two masses":
        return {**common, "c": 0.5 * w, "c2": w * rng.uniform(0.1, 0.5), "ratio": rng.uniform(0.5, 2)}, 4 / w
    if machine == "servo":
        return {**common, "g": rng.uniform(0.5, 2), "k": 0.0, "c": 2 * w * rng.uniform(0.4, 0.9), "loop": w * w}, 3 / w
    return common, 3 / w


def model(machine: str, p: dict[str, float]) -> str:
    """Return the MODEL.toml."""
    k, g = p["k"] + p["loop"], p["g"] * (p["loop"] or 1.0)
    turns = machine != "spring"
    q, kind = ("rad", "rad") if turns else ("m", "N")
    states = [f'{{name = "q", unit = "{q}"}}', f'{{name = "v", unit = "{q}/s", rate_of = "q"}}']
    A, B, C = [[0, 1], [-k, -p["c"]]], [[0], [g]], [[1, 0]]
    outputs = [f'{{name = "position", unit = "{q}"}}']
    unit = {"motor": "V", "servo": "rad", "spring": kind}.get(machine, "N m")
    if machine == "motor":
        states, A, B, C, outputs = ['{name = "w", unit = "rad/s"}'], [[-p["c"]]], [[g]], [[1]], ['{name = "speed", unit = "rad/s"}']
    if machine == "two masses":
        states += ['{name = "q2", unit = "rad"}', '{name = "v2", unit = "rad/s", rate_of = "q2"}']
        A = [[0, 1, 0, 0], [-k, -p["c"], k, 0], [0, 0, 0, 1], [k / p["ratio"], 0, -k / p["ratio"], -p["c2"] / p["ratio"]]]
        B, C = [[0], [g], [0], [0]], [[0, 1, 0, 0], [0, 0, 0, 1]]
        outputs = ['{name = "motor", unit = "rad/s"}', '{name = "load", unit = "rad/s"}']
    D = [[0] for _ in C]
    return (
        f'name = "{machine}"\ntime = "continuous"\ninputs = [{{name = "input", unit = "{unit}"}}]\noutputs = [{", ".join(outputs)}]\n'
        f"states = [{', '.join(states)}]\nA = {A}\nB = {B}\nC = {C}\nD = {D}\n[uncertainty]\nrelative = 0.1\n"
    )


def excitation(kind: str, n: int, per: float, rng: Generator) -> np.ndarray:
    """Return an input of about unit size for a machine whose time scale is ``per`` samples."""
    t = np.arange(n)
    if kind in ("steps", "stairs"):
        shortest, longest = (per / 2, 4 * per) if kind == "steps" else (3 * per, 8 * per)
        held = rng.integers(max(2, int(shortest)), max(4, int(longest)), n)
        return np.repeat(rng.uniform(-1, 1, n), held)[:n]
    if kind == "noise":
        u = lfilter([1], [1, -np.exp(-1 / max(per / 3, 1))], rng.normal(size=n))
        return u / np.abs(u).max()
    if kind == "chirp":
        return chirp(t, 0.02 / per, n, 0.4 / per) * rng.uniform(0.5, 1)
    return sum(np.sin(2 * np.pi * f / per * t + rng.uniform(0, 6.28)) for f in (0.031, 0.077, 0.13, 0.29)) / 3


def drawn(seed: int, folder: Path) -> tuple[str, str, str, float]:
    """Write a machine's model and recordings; return machine, effect, excitation and the error of the best linear gain."""
    rng = np.random.default_rng(seed)
    machine = str(rng.choice(list(OWN)))
    effect = str(rng.choice([*ANYWHERE, *OWN[machine], *OWN[machine]]))
    p, scale = numbers(machine, rng)
    per, n, runs = rng.uniform(12, 40), int(rng.integers(1500, 5000)), int(rng.integers(2, 4))
    dt, kind = scale / per, str(rng.choice(["steps", "stairs", "noise", "chirp", "sines"]))
    inputs, coupled = [excitation(kind, n, per, rng) for _ in range(runs)], machine == "two masses"
    columns = [1, 3] if coupled else [1] if machine == "motor" else [0]
    shape = {"wave": 1.0, "stribeck": 1.0}

    def moved(name: str, size: float, u: np.ndarray, pushed: np.ndarray) -> np.ndarray:
        stiff = (p[name] for name in ("g", "k", "c", "c2", "ratio"))
        return simulated(coupled, CODE[name], size, *stiff, shape["wave"], shape["stribeck"], p["loop"], u, pushed, dt)

    def measured(size: float, u: np.ndarray, pushed: np.ndarray) -> np.ndarray:
        y = moved(effect, size, u, pushed)[:, columns]
        return y + size * np.abs(y) * y / np.abs(y).max() if effect == "sensor" else y

    still = np.zeros(n)
    plain = np.vstack([moved("none", 0.0, u, still) for u in inputs])
    travel, speed = (plain[:, 0] - plain[:, 2]).std() if coupled else plain[:, 0].std(), plain[:, 1].std()
    push = p["g"] * (p["loop"] or 1.0) * np.concatenate(inputs).std()
    shape["wave"] = 2 * np.pi / (plain[:, 0].std() * rng.uniform(0.5, 1.5))
    shape["stribeck"] = rng.uniform(1, 3) / travel if effect == "hysteresis" else speed * rng.uniform(0.05, 0.2)
    units = {
        "coulomb": push, "stribeck": push, "quadratic": push / speed**2, "lag": scale, "delay": scale, "slew": 1 / scale, "cubic": p["k"] / travel**2,
        "clearance": travel, "cogging": push, "hysteresis": push / travel,
    }  # fmt: skip
    asked, trials = rng.uniform(0.1, 0.4), []
    for size in units.get(effect, 1.0) * np.geomspace(0.01, 3, 18):
        y = np.vstack([measured(size, u, still) for u in inputs])
        left = [np.std(a - np.polyval(np.polyfit(b, a, 1), b)) / max(np.std(a), 1e-12) for a, b in zip(y.T, plain[:, columns].T, strict=True)]
        trials.append((abs(np.mean(left) - asked), size, float(np.mean(left))))
    _, size, error = min(t for t in trials if np.isfinite(t[0]))
    noise, disturbed = np.exp(rng.uniform(np.log(0.003), np.log([0.03, 0.05])))
    slow = np.exp(-1 / (rng.uniform(1, 5) * per))
    for i, u in enumerate(inputs):
        pushed = lfilter([np.sqrt(1 - slow**2)], [1, -slow], rng.normal(size=n)) * disturbed * u.std()
        y = measured(size, u, pushed)
        y += rng.normal(size=y.shape) * noise * y.std(0)
        head = ",".join(["t", "u_input", *{"motor": ["y_speed"], "two masses": ["y_motor", "y_load"]}.get(machine, ["y_position"])])
        name = "holdout.csv" if i == runs - 1 else f"train_{i}.csv"
        np.savetxt(folder / name, np.column_stack([np.arange(n) * dt, u, y]), delimiter=",", header=head, comments="", fmt="%.9g")
    stated = {key: value * (1 + 0.07 * rng.normal()) for key, value in p.items()}
    (folder / "model.toml").write_text(model(machine, stated), encoding="utf-8")
    return machine, effect, kind, error


def judged(effect: str, document: dict) -> str:
    """Return "right", "listed" (a right name behind another), "silent", "wrong"; a changed number is right where nothing is missing."""
    named = [n["physics"] for n in document["named"]]
    if effect == "none":
        return "right" if not named or named[0] == "parameter_change" else "wrong"
    right = EFFECTS[effect]
    return "silent" if not named else "right" if named[0] in right else "listed" if set(named) & set(right) else "wrong"


def main(seed: int, count: int) -> None:
    """Print a row per machine, and the counts."""
    print("| seed | machine | effect | excitation | error | verdict | named (weight) | held-out error before, after [%] | judged | seconds |")
    print("|---|---|---|---|---|---|---|---|---|---|", flush=True)
    counts: dict[str, int] = {}
    for number in range(seed, seed + count):
        with tempfile.TemporaryDirectory() as made:
            folder, begin = Path(made), time.perf_counter()
            machine, effect, kind, error = drawn(number, folder)
            try:
                document = explain_files(folder / "model.toml", sorted(folder.glob("train*.csv")), [folder / "holdout.csv"], ExplainOptions(out=folder / "out"))
            except BadInput as refusal:
                document = {"verdict": f"refused: {refusal}", "named": [], "fit": {"per_output": {}}}
        word = judged(effect, document)
        counts[word] = counts.get(word, 0) + 1
        names = ", ".join(f"{n['physics']} at {n['site']} ({n['weight']:.2f})" for n in document["named"][:3]) or "none"
        fits = list(document["fit"]["per_output"].values())
        errors = ", ".join(f"{100 * np.mean([f[k]['nrmse'] or np.inf for f in fits]):.1f}" for k in ("before", "after")) if fits else "-"
        took = time.perf_counter() - begin
        print(f"| {number} | {machine} | {effect} | {kind} | {error:.2f} | {document['verdict']} | {names} | {errors} | {word} | {took:.0f} |", flush=True)
    print("\n" + ", ".join(f"{v} {k}" for k, v in sorted(counts.items())) + f" of {count}.")


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]))
