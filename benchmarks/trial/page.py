"""Write docs/reference/blind-trials.md (and an HTML page beside the results) from a folder of `afdsvc trial`.

    afdsvc trial --folder trials --n 300 --seed 2026 --jobs 2     # hours; goes on where it was interrupted
    afdsvc trial --folder nothing --parts nothing --n 2500 --seed 2031 --jobs 2     # 200 more with nothing hidden
    python benchmarks/trial/page.py trials 300 COMMIT nothing COMMIT
    python benchmarks/trial/page.py trials 300 COMMIT --name blind-trials-newest     # beside the page, not instead of it
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from scipy.stats import binomtest

from afdsvc.trial import FIELD, markdown, page, results
from afdsvc.trial.study import rescored

DOCS = Path(__file__).parents[2] / "docs" / "reference"
HOW = """
Every trial is made by a truth generator that shares no code with the simulator or the hypotheses of `explain`: its own
Runge-Kutta integrator in five sub-steps, its own functional forms (arctan friction where the hypothesis has tanh, smooth dead
zones where it has sharp ones, hysteresis of other exponents, five edges of play where it has two, a servo with a soft corner where it
has a rate limit, limits approached by a power law where it has a parabola, a joint that stiffens by another power), its own errors of
every constant, drawn from the stated 2 %.
It writes three recordings, a held-out one and the nominal MODEL.toml; the answer is sealed with a hash over answer, nonce and
files and kept in another folder. `explain` is handed the files only. Then the seal is checked and broken, and the answer scored.
rho is the effect's rms in the outputs over the noise's, measured without noise.

Scores: *right first*: name and site of the first name are what was hidden (cases in which two words mean the same physics are
listed with their reasons in `afdsvc/trial/matching.py`); *among the look-alikes*: it is among the names reported for that effect;
*confident false name*: a wrong name with 90 % of the weight or more and no remainder flagged; *d*: how far apart hidden effect
and first name are for this data when both are fitted as well as can be, in noise units: below 4.65 the best possible test errs
more than once in a hundred. Times are by the clock, of a trial among whatever else the computer did.
"""

HOW_FIELD = """
What is hidden, in which machine and how it was recorded is drawn as [field trials](field-trials.md) says. The laws are frozen: they are not
changed in a commit that changes `explain` (`tests/trial/test_frozen.py`). Their functional forms are not listed here, and whoever
works on `explain` does not read them.
"""


def nothing_hidden(folder: Path, commit: str) -> str:
    """Return what came of a study in which nothing was hidden."""
    scores = [rescored(r)["score"] for r in results(folder)]
    verdicts = ", ".join(f"{count} {verdict}" for verdict, count in Counter(s["verdict"] for s in scores).most_common())
    named, sure = (sum(bool(s[key]) for s in scores) for key in ("false_name", "confident_false"))
    high = 100 * float(binomtest(sure, len(scores)).proportion_ci(0.95, "exact").high)
    return (
        f"\nIn {len(scores)} more trials with nothing hidden (`--parts nothing`, another seed, commit {commit}): {verdicts}; a name was given in "
        f"{named}, with confidence in {sure} (95 %, Clopper-Pearson: at most {high:.1f} in 100).\n"
    )


def main(folder: Path, planned: int, commit: str, more: Sequence[str], name: str) -> None:
    """Score the kept results anew and write both pages; ``more`` are folder and commit of a study with nothing hidden."""
    done = [rescored(r) for r in results(folder)]
    text = markdown(done, "Blind trials of `explain`")
    title, rest = text.split("\n", 1)
    short = (
        f"\n**{len(done)} of the {planned} trials of the plan were run** (commit {commit}, in an order drawn beforehand, so that the part "
        "done is a fair sample); the same command with the same folder goes on with the rest. With so few, read the intervals, not the "
        "percentages.\n" if len(done) < planned else f"\n{planned} trials, commit {commit}.\n"
    )
    seed = done[0]["answer"]["seed"].split("/")[0]
    named = "" if name == "blind-trials" else f" --name {name}"
    field = all(r["part"] == FIELD for r in done)
    parts = " --parts field" if field else ""
    command = f"\nMade by `afdsvc trial --folder trials{parts} --n {planned} --seed {seed}` and `python benchmarks/trial/page.py trials {planned} {commit}{named}`.\n"
    empty = nothing_hidden(Path(more[0]), more[1]) if more else ""
    (DOCS / f"{name}.md").write_text(f"{title}\n{short}{HOW_FIELD if field else HOW}{command}{empty}{rest}", encoding="utf-8")
    (folder / f"{name}.html").write_text(page(done, "Blind trials of explain"), encoding="utf-8")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("planned", type=int)
    parser.add_argument("commit")
    parser.add_argument("more", nargs="*", help="folder and commit of a study with nothing hidden")
    parser.add_argument("--name", default="blind-trials", help="of the page")
    given = parser.parse_args()
    main(given.folder, given.planned, given.commit, given.more, given.name)
