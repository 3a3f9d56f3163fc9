"""Ten thousand machines behind zenoh routers: does the plan hold, also when a service, a computer or a router is lost?

    python benchmarks/fleet/simulate.py --capacity 1000 --start 12

A simulation of the traffic, block by block: machines send a block every 50 ms, routers forward it over links of finite
bandwidth to the one service that subscribes to the machine's site, and that service works its queue off at the rate that
`benchmarks/throughput` measured (``--capacity``, blocks a second of one process). What cannot be delivered waits in the rig's
cache and is sent again when somebody is there. Prints bandwidth, waiting times and losses for every case.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, field

import numpy as np

STEP = 0.05  # s: one block of 250 samples at 5 kHz
BLOCK = 16_230  # bytes: 8 channels of 250 doubles, names and header
WIRE = 1.04  # zenoh, TCP and IP headers
CACHE = 4000  # blocks a rig keeps for a service it has lost sight of
NEW = 200  # blocks of each rig that a service started anew is given
DECISIONS = 4 * 1000 / 60 + 400  # bytes a second upwards from one machine: a burst a minute, alarms, its share of the status


@dataclass(frozen=True)
class Plan:
    """How the machines are shared out."""

    machines: int = 10_000
    per_service: int = 32
    per_computer: int = 6
    per_router: int = 40  # services
    capacity: float = 1000.0  # blocks a second of one process when it works all the time
    spread: float = 0.5  # standard deviation of the work of a block over its mean
    link: float = 10e9 / 8  # bytes a second of a router's link
    queue: int = 8000  # blocks that wait in a service at most; then its rigs wait
    seconds: float = 240.0

    @property
    def services(self) -> int:
        """Service processes, each with its site of machines."""
        return -(-self.machines // self.per_service)

    @property
    def routers(self) -> int:
        """Routers without the spare of each pair."""
        return -(-self.services // self.per_router)


@dataclass
class Loss:
    """Something is lost at a time: services of these numbers, until somebody has taken over; or one router's links.

    A service that goes on gets all that its rigs keep; one that is started anew asks for the last ``kept`` blocks of each.
    """

    at: float
    services: slice
    out_for: float
    kept: int = 4000


@dataclass
class Found:
    """What a run showed; waiting times are from the last sample of a block to its judgement."""

    waits: list[np.ndarray] = field(default_factory=list)
    lost: int = 0
    lost_each: float = 0.0
    peak_link: float = 0.0
    most_cached: float = 0.0
    caught_up: float = 0.0


def run(plan: Plan, losses: list[Loss], rng: np.random.Generator) -> Found:
    """Return what happens to every service's queue; time goes on in steps of one block."""
    n = plan.services
    machines = np.full(n, plan.per_service)
    machines[-1] = plan.machines - plan.per_service * (n - 1)
    queue, cached = np.zeros(n), np.zeros(n)  # blocks at the service, blocks in the caches of its rigs
    router, found = np.arange(n) // plan.per_router, Found()
    budget = plan.link * STEP / (BLOCK * WIRE)  # blocks a router can forward in a step
    gone = np.zeros(n)
    for step in range(round(plan.seconds / STEP)):
        t = step * STEP
        away, cache = np.zeros(n, dtype=bool), np.full(n, CACHE)
        for loss in losses:
            if loss.at <= t < loss.at + loss.out_for:
                away[loss.services], cache[loss.services] = True, loss.kept
                if loss.kept < CACHE and t < loss.at + STEP:
                    queue[loss.services] = 0.0  # it died with what waited in it
        cached += machines
        over = np.maximum(cached - cache * machines, 0.0)
        gone += over / machines
        found.lost, cached = found.lost + round(float(over.sum())), cached - over
        asked = np.where(away, 0.0, np.minimum(cached, plan.queue - queue))
        share = np.minimum(1.0, budget / np.maximum(np.bincount(router, asked, plan.routers), 1e-9))
        sent = asked * share[router]
        found.peak_link = max(found.peak_link, float(np.bincount(router, sent, plan.routers).max()) * BLOCK * WIRE / STEP)
        cached, queue = cached - sent, queue + sent
        work = plan.capacity * STEP / (1 + plan.spread * rng.standard_normal(n) / np.sqrt(plan.capacity * STEP))
        done = np.where(away, 0.0, np.minimum(queue, np.maximum(work, 0.0)))
        queue -= done
        waiting = (queue + cached) / plan.capacity + np.where(away, np.nan, 0.5 / plan.capacity * machines)
        found.waits.append(waiting)
        found.most_cached = max(found.most_cached, float((cached / machines).max()))
        if ((queue + cached) > 2 * machines).any():
            found.caught_up = t
    found.lost_each = float(gone.max())
    return found


def tell(name: str, plan: Plan, found: Found, losses: list[Loss]) -> None:
    """Print one line."""
    waits = np.concatenate(found.waits)
    waits = 1e3 * waits[np.isfinite(waits)]
    after = f"; all caught up {found.caught_up - losses[0].at:.0f} s after" if losses and found.caught_up else ""
    print(
        f"{name:46s} median wait {np.median(waits):5.0f} ms, 99.9 % {np.quantile(waits, 0.999):8.0f} ms; busiest router link "
        f"{8e-9 * found.peak_link:.2f} Gbit/s; caches at most {found.most_cached * STEP:.0f} s; blocks lost {found.lost}, most of one machine {found.lost_each * STEP:.0f} s{after}"
    )


def plain(plan: Plan) -> None:
    """Print the plan in numbers."""
    one = BLOCK * WIRE / STEP
    print(f"one machine: {8e-6 * one:.2f} Mbit/s of samples, {8e-3 * DECISIONS:.1f} kbit/s of decisions and status")
    print(f"{plan.machines} machines: {8e-9 * one * plan.machines:.1f} Gbit/s of samples, {8e-6 * DECISIONS * plan.machines:.0f} Mbit/s upwards")
    load = plan.per_service / STEP / plan.capacity
    print(f"{plan.services} services of {plan.per_service} machines ({100 * load:.0f} % busy), on {-(-plan.services // plan.per_computer)} computers of {plan.per_computer}")
    print(f"{plan.routers} pairs of routers, {plan.per_router} services each, {8e-9 * one * plan.per_service * plan.per_router:.1f} Gbit/s a router")
    print(f"recordings: {one * plan.machines * 86400 / WIRE / 1e12 * 0.9:.0f} TB a day if everything is kept")


def cases(plan: Plan, start: float) -> list[tuple[str, list[Loss]]]:
    """Return what is tried: a death is seen at once, a hang after 20 s, and then a service takes ``start`` seconds to listen."""
    computer, router = slice(0, plan.per_computer), slice(0, plan.per_router)
    return [
        ("nothing is lost", []),
        (f"a service dies, listens again after {start:.0f} s", [Loss(60.0, slice(0, 1), start, NEW)]),
        ("a service hangs: seen after 20 s, started again", [Loss(60.0, slice(0, 1), 20 + start, NEW)]),
        (f"a computer with {plan.per_computer} services dies", [Loss(60.0, computer, 5 + 2 * start, NEW)]),
        ("a router dies, rigs find the other in 2 s", [Loss(60.0, router, 2.0)]),
        ("both routers of a pair are away for 60 s", [Loss(60.0, router, 60.0)]),
        ("both routers of a pair are away for 210 s", [Loss(10.0, router, 210.0)]),
    ]


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--capacity", type=float, required=True, help="blocks a second one service process works off, measured")
    parser.add_argument("--machines", type=int, default=10_000)
    parser.add_argument("--per-service", type=int, default=32)
    parser.add_argument("--start", type=float, default=12.0, help="seconds a service takes until it listens, measured")
    asked = parser.parse_args()
    plan = Plan(machines=asked.machines, per_service=asked.per_service, capacity=asked.capacity)
    plain(plan)
    for name, losses in cases(plan, asked.start):
        tell(name, plan, run(plan, losses, np.random.default_rng(0)), losses)


if __name__ == "__main__":
    main()
