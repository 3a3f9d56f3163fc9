"""All detectors on the same bursts at the same alarm rate, against the Neyman-Pearson bound.

    python benchmarks/detection/run.py [--quick] [--out FOLDER] [--docs]

Writes one HTML page with its pictures into FOLDER (detection-report by default); ``--docs`` also renews
docs/reference/detection-comparison.md. `ruptures` and `river` take part where they are installed (pip install ruptures river).
"""

from __future__ import annotations

import argparse
import os
import shutil
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))  # benchmarks.support
for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import delay  # noqa: E402
import figures  # noqa: E402
import isolation  # noqa: E402
import power  # noqa: E402
from machines import KEYS, case  # noqa: E402
from page import Results, html_page, markdown  # noqa: E402

ROOT = Path(__file__).resolve().parents[2]
INTRO = """\
Every machine plays its diagnosis burst; sensor noise is the only noise. Every detector is shown the same bursts. Thresholds \
are put where each of them alarms on the stated share of the same healthy bursts, so that no detector gains by alarming more often. \
Intervals are 95 % and count the error of the calibration as well as that of the counted bursts.

"Clairvoyant" knows which fault it is and how severe: by the lemma of Neyman and Pearson nothing beats it on the same samples. \
"Fault unknown" knows the severity and averages the likelihood over the faults. `published_a0` and `published_a_phi` are the two \
statistics of A. K. Sekunda's thesis (DTU 2017, eqs. 5.19-5.30, P4 27-46); the amplitude cancels between statistic and threshold, \
so they are one test and one line in the pictures. The shelf detectors see a healthy reference as long as the burst before it."""


def main() -> None:
    """Run the comparison."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="two machines, few bursts: checks that everything runs, in half a minute")
    parser.add_argument("--out", type=Path, default=Path("detection-report"), help="folder of the HTML page")
    parser.add_argument("--docs", action="store_true", help="renew docs/reference/detection-comparison.md and its pictures")
    wanted = parser.parse_args()
    started = time.process_time()
    found = results(wanted.quick)
    found.cpu_seconds = time.process_time() - started
    wanted.out.mkdir(parents=True, exist_ok=True)
    draw(found, wanted.out)
    print(f"wrote {html_page(found, INTRO, wanted.out)} after {found.cpu_seconds:.0f} CPU seconds")
    if wanted.docs:
        document(found, wanted.out)


def results(quick: bool) -> Results:
    """Return the whole comparison."""
    effort = power.QUICK if quick else power.FULL
    keys = ("lqg-0", "unstable") if quick else KEYS
    found = Results("python benchmarks/detection/run.py" + (" --quick" if quick else ""), effort.rate)
    for key in keys:
        _timed(key, lambda key=key: found.powers.append(power.study(case(key), effort)))  # type: ignore[misc]
    _timed("delays", lambda: found.delays.append(delay.study(case("lqg-0"), "vertical_actuator", quick)))
    for key in keys:
        both = (8 if quick else 40) if key in ("lqg-0", "proportional-0") else 0
        each = 6 if quick else 60
        _timed(f"isolation {key}", lambda key=key, both=both, each=each: found.isolations.append(isolation.study(case(key), each, both)))  # type: ignore[misc]
    return found


def _timed(what: str, job: object) -> None:
    start = time.process_time()
    job()  # type: ignore[operator]
    print(f"{what}: {time.process_time() - start:.0f} CPU seconds", file=sys.stderr, flush=True)


def draw(found: Results, folder: Path) -> None:
    """Write all pictures."""
    for one in found.powers:
        key = one.case.key
        found.pictures[f"power-{key}"] = figures.save(figures.severity_figure(one, found.rate), folder, f"detection-power-{key}")
        found.pictures[f"faults-{key}"] = figures.save(figures.fault_figure(one, found.rate), folder, f"detection-faults-{key}")
    for late in found.delays:
        found.pictures[f"delay-{late.case.key}"] = figures.save(figures.delay_figure(late), folder, f"detection-delay-{late.case.key}")
    if found.isolations:
        found.pictures["isolation"] = figures.save(figures.isolation_figure(found.isolations), folder, "detection-isolation")


def document(found: Results, folder: Path) -> None:
    """Copy the pictures into docs/pictures and write the page of the documentation."""
    pictures = ROOT / "docs" / "pictures"
    for name in found.pictures.values():
        shutil.copyfile(folder / name, pictures / name)
    page = ROOT / "docs" / "reference" / "detection-comparison.md"
    page.write_text(markdown(found, INTRO, lambda name: f"../pictures/{name}"))
    print(f"wrote {page}")


if __name__ == "__main__":
    main()
