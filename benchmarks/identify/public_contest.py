"""Fit of automatic `identify` on the public sets, beside that of other tools.

    AFDSVC_DATA=folder python benchmarks/identify/public_contest.py ours.csv [--method pem] [set ...]
    python benchmarks/identify/public_contest.py --page ours.csv peers.csv

The first identifies; the second prints the table of ours.csv and of the peers.csv that `peers.py` wrote. A refusal or a crash counts as failed.
"""

from __future__ import annotations

import argparse
import csv
import time
import warnings
from collections import defaultdict
from pathlib import Path

import numpy as np
from public_sets import fit, from_environment


def identified(path: Path, method: str, names: list[str]) -> None:
    """Write fit, order and seconds of processor time of every set."""
    import afdsvc

    with path.open("w", newline="") as file:
        table = csv.writer(file)
        table.writerow(["set", "tool", "fit", "order", "seconds"])
        for name in names or from_environment():
            data, start = from_environment()[name](), time.process_time()
            try:
                found = afdsvc.identify(data.u, data.y, dt=1.0, groups=0, cross_check=False, method=method).result.fit
                value, order, how = fit(found.system.A, found.system.B, found.system.C, found.system.D, data), found.order, found.notes[0]
            except Exception as error:  # a crash is a figure of this page too
                value, order, how = -np.inf, 0, f"{type(error).__name__}: {error}"
            table.writerow([name, f"afdsvc {method}", f"{value:.2f}", order, f"{time.process_time() - start:.1f}"])
            file.flush()
            print(f"{name:18s} {value:8.2f} {order:3d} {time.process_time() - start:7.1f} s  {how}", flush=True)


def page(paths: list[Path]) -> None:
    """Print the table of all tools on the sets of the first file, and how often its tool is best, within one point, and farther than five behind."""
    fits: dict[str, dict[str, float]] = defaultdict(dict)
    for path in paths:
        for row in csv.DictReader(path.open()):
            if path == paths[0] or row["set"] in fits:
                fits[row["set"]][row["tool"]] = float(row["fit"])
    tools = list(dict.fromkeys(tool for found in fits.values() for tool in found))
    print("| set | ", " | ".join(tools), " |\n|---|", "---:|" * len(tools), sep="")
    for name, found in fits.items():
        best = max(found.values())
        cells = ("failed" if (v := found.get(t, -np.inf)) < -1e6 else f"**{v:.1f}**" if v == best else f"{v:.1f}" for t in tools)
        print(f"| {name} |", " | ".join(cells), "|")
    behind = [max(v for t, v in found.items() if t != tools[0]) - found[tools[0]] for found in fits.values()]
    print(f"\n{tools[0]}: best or within 1 point on {sum(b <= 1 for b in behind)} of {len(behind)} sets, "
          f"more than 5 points behind on {sum(b > 5 for b in behind)}, the farthest {max(behind):.1f}")  # fmt: skip


if __name__ == "__main__":
    warnings.filterwarnings("ignore")
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("files", nargs="+")
    parser.add_argument("--method", default="auto")
    parser.add_argument("--page", action="store_true")
    args = parser.parse_args()
    page([Path(f) for f in args.files]) if args.page else identified(Path(args.files[0]), args.method, args.files[1:])
