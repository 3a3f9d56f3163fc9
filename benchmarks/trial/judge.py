"""Score another engine on trials that were only written: its documents in the form of `explain --json`, one per trial.

    afdsvc trial --parts field --n 40 --seed 7 --folder trials --write-only
    (the engine reads trials/trials/0000/ ... and writes answers/0000.json ...; trials/sealed/ is none of its business)
    python benchmarks/trial/judge.py trials answers --n 40 --seed 7
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from afdsvc.app.trial import in_order, write_reports
from afdsvc.trial import study


def main(folder: Path, answers: Path, count: int, seed: int, parts: Sequence[str]) -> None:
    """Score every document and write the report into the folder of the trials."""

    def answered(model: Path, recordings: Sequence[Path], holdout: Path) -> Mapping[str, Any]:
        document: dict[str, Any] = json.loads((answers / f"{model.parent.name}.json").read_text(encoding="utf-8"))
        return document

    requests = in_order(count, seed, None, (), parts)
    print(write_reports(study(requests, answered, folder, keep=True), folder)["summary"])


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("answers", type=Path)
    parser.add_argument("--n", type=int, required=True)
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--parts", nargs="*", default=["field"])
    given = parser.parse_args()
    main(given.folder, given.answers, given.n, given.seed, given.parts)
