"""Does a rig agent hold 5 kHz on one core, and does every block reach the service?

    python benchmarks/rig.py --seconds 600
    python benchmarks/rig.py --seconds 0 --order-of-q 0 30

Runs the service here and the rig agent in a process of its own, over zenoh on loopback, with a burst every 5 s. Prints late
control samples, head-room, lost samples, and the cost of one control sample as a ratio to a plain numpy step of the same
matrices in the same run.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path

import numpy as np

from afdsvc.app.demo import rig_process
from afdsvc.app.demo_site import DemoOptions, free_port, site_text
from afdsvc.app.serve import serving
from afdsvc.files.site import read_site
from afdsvc.hal import control_sample
from afdsvc.lti.statespace import Array
from afdsvc.plants.registry import plant
from afdsvc.plugins.manager import load


def control_cost(samples: int = 20_000, order_of_q: int = 0) -> tuple[Array, float]:
    """Return seconds of every control sample, compiled and called once per sample as around real hardware; and the mean of numpy's."""
    bearing = plant("gas_bearing")
    design = load().get("controllers", "lqg").design(bearing.discrete(), bearing.recommended["lqg"])
    K = control_sample.contiguous_system(design.interconnection)
    control_sample.compile_loops()
    xk, y, alpha, u, beta = np.zeros(K.order), np.zeros(2), np.zeros(2), np.zeros(2), np.zeros(2)
    bounds, n = np.full(2, 10.0), order_of_q
    rng = np.random.default_rng(0)
    q = 0.5 * np.linalg.qr(rng.standard_normal((n, n)))[0], *(0.01 * rng.standard_normal(shape) for shape in ((n, 2), (2, n), (2, 2))), np.zeros(n)
    motion = np.array([1.0, 1.0, 1.0, 1.0]) if n else np.zeros(4)
    compiled, noise = np.empty(samples), 0.1 * rng.standard_normal((samples, 2))
    for k in range(samples):
        y[:], start = noise[k], time.perf_counter()
        control_sample.control_sample(K.A, K.B, K.C, K.D, xk, q, motion, y, alpha, True, bounds, bounds, u, beta)
        compiled[k] = time.perf_counter() - start
    start = time.perf_counter()
    for _ in range(samples):
        w = np.concatenate([y, alpha])
        out = K.C @ xk + K.D @ w
        xk = K.A @ xk + K.B @ w
        np.clip(out[:2], -bounds, bounds)
    return compiled, (time.perf_counter() - start) / samples


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=600.0)
    parser.add_argument("--order-of-q", type=int, nargs="+", default=[0], help="states of a Q beside the controller")
    options = parser.parse_args()
    for order in options.order_of_q:
        compiled, plain = control_cost(order_of_q=order)
        middle, most = 1e6 * np.quantile(compiled, [0.5, 0.99])
        print(f"control sample, Q of order {order}: {middle:.2f} us (median), {most:.2f} us (99 %) compiled, {1e6 * plain:.2f} us numpy; period 200 us")
    if options.seconds:
        _rig(options.seconds)


def _rig(seconds: float) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "site.toml"
        options = DemoOptions(faults=(), out=Path(folder) / "recordings", seconds=seconds)
        path.write_text(site_text(options, free_port()).replace('rerun = "file"', 'rerun = "off"'))
        with serving(read_site(path)) as hub, rig_process(path, "bearing", seconds) as rig:
            rig.wait(seconds + 60)
            hub.drain()
            watch = hub.watches["bearing"]
            file, size, failure, dropped = hub.recording()
            samples = round(watch.seconds_seen * 5000)
            print(f"rig: {samples} samples in {watch.blocks} blocks, {watch.late} late ({100 * watch.late / samples:.3f} %)")
            print(f"rig: head-room {100 * watch.head_room:.1f} % of the sample period, last value reported")
            print(f"service: {watch.lost_samples} samples lost, {hub.dropped + dropped} messages dropped, {size / 1e6:.1f} MB")
            print(
                f"service: {len(watch.evidence)} decisions kept, alarms {[a.id for a in hub.alarms.alarms.values()]} {failure}"
            )


if __name__ == "__main__":
    main()
