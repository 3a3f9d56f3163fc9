"""Every figure and table of the thesis that can be remade: each printed number and statement within its tolerance, or the erratum's."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from benchmarks.thesis.__main__ import PAGES, figures, main
from benchmarks.thesis.figure import Row

ALL = figures()


def compares_a_number(row: Row) -> bool:
    return not isinstance(row.ours, bool | np.bool_)


QUICK = [f for f in ALL if f.remade and not f.long]
LONG = [f for f in ALL if f.remade and f.long]


@pytest.mark.parametrize("figure", QUICK, ids=lambda f: f.name)
def test_the_printed_numbers_are_found(figure):
    rows = figure.remade()
    assert any(compares_a_number(r) for r in rows)
    assert [(r.what, r.printed, r.ours) for r in rows if not r.holds] == []
    assert all(r.erratum for r in rows if r.printed is None)


@pytest.mark.long
@pytest.mark.parametrize("figure", LONG, ids=lambda f: f.name)
def test_the_printed_numbers_are_found_in_longer_runs(figure):
    rows = figure.remade()
    assert any(compares_a_number(r) for r in rows)
    assert [(r.what, r.printed, r.ours) for r in rows if not r.holds] == []


def test_every_figure_has_a_command_or_a_reason_and_the_index_names_it():
    assert len({f.name for f in ALL}) == len(ALL)
    assert all((f.remade is None) == bool(f.reason) for f in ALL)
    assert len(QUICK) + len(LONG) >= 30
    index = (PAGES / "README.md").read_text()
    named = re.findall(r"^\| \[?((?:figure|table|p\d)-[a-z0-9.-]+)", index, re.MULTILINE)
    assert named == [f.name for f in ALL]
    remade = re.findall(r"^\| \[(.+?)\]\(.+?`python -m benchmarks.thesis (.+?)`", index, re.MULTILINE)
    assert remade == [(f.name, f.name) for f in ALL if f.remade]  # these are the ones asserted above
    for page, anchor in re.findall(r"\]\((.+?)\.md#(.+?)\)", index):
        headings = re.findall(r"^## (.+)$", Path(PAGES / f"{page}.md").read_text(), re.MULTILINE)
        assert anchor in [h.replace(".", "") for h in headings]


def test_a_wrong_number_does_not_hold():
    assert not Row("", 2.0, 2.2, 0.1).holds
    assert not Row("", True, False).holds
    assert not Row("", None, 1.0, 0.1).holds
    assert not Row("", 2.0, 2.0, 0.1, "print is wrong", 3.0).holds
    assert Row("", 2.0, 3.05, 0.1, "print is wrong", 3.0).holds


def test_the_command_prints_a_figure_or_says_why_not(capsys):
    assert main(["p5-0.13"]) == 0
    assert "0.0003" in capsys.readouterr().out
    assert main(["p5-0.2"]) == 2
    assert "photograph" in capsys.readouterr().out
    assert main(["list"]) == 0
    assert main(["nothing"]) == 2
