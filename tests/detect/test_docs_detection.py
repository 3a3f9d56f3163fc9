"""The pages about detection: their code runs and prints what they show, every detector has its page, figures agree."""

import contextlib
import io
import re
from pathlib import Path

import pytest

from afdsvc.errors import BadInput
from afdsvc.plugins.detectors import afdsvc_detectors
from afdsvc.testing.machines import bearing_problem

DOCS = Path(__file__).parents[2] / "docs"
DETECTORS = {design.name: design for design in afdsvc_detectors()}
BLOCK = re.compile(r"```python\n(.*?)```(?:\n\n```text\n(.*?)```)?", flags=re.DOTALL)


def test_the_explanation_prints_what_it_shows():
    blocks = BLOCK.findall((DOCS / "explanation" / "detection.md").read_text())
    assert len(blocks) >= 10
    names: dict[str, object] = {}
    for code, shown in blocks:
        out = io.StringIO()
        with contextlib.redirect_stdout(out):
            exec(compile(code, "detection.md", "exec"), names)
        assert out.getvalue().rstrip("\n") == shown.rstrip("\n")


def test_pages_and_detectors_are_the_same_set():
    assert {path.stem for path in (DOCS / "detectors").glob("*.md")} - {"README"} == set(DETECTORS)
    index = (DOCS / "detectors" / "README.md").read_text()
    for name in DETECTORS:
        assert f"[{name}]({name}.md)" in index


def settings(name):
    """The settings of a detector, from the sentence that refuses an unknown one."""
    with pytest.raises(BadInput) as refused:
        DETECTORS[name].design(bearing_problem(), {"no_such_setting": 1})
    return set(str(refused.value).split("it has ")[1].rstrip(".").split(", "))


@pytest.mark.parametrize("name", DETECTORS)
def test_every_setting_is_documented_and_no_other(name):
    page, index = ((DOCS / "detectors" / f"{file}.md").read_text() for file in (name, "README"))
    common = set(re.findall(r"^\| `(\w+)` \|", index.split("## Settings")[1].split("\n\n`fault_curves`")[0], flags=re.MULTILINE))
    said = set(re.findall(r"`(\w+)`", page.split("**Settings.**")[1].split("\n\n")[0]))
    assert common | said == settings(name)


@pytest.mark.parametrize("name", DETECTORS)
def test_every_page_has_its_parts(name):
    page = (DOCS / "detectors" / f"{name}.md").read_text()
    for part in ("Statistic", "Threshold", "Assumes", "Use it", "Settings", "Source"):
        assert f"**{part}" in page


def test_links_of_the_pages_lead_somewhere():
    for page in [DOCS / "explanation" / "detection.md", DOCS / "reference" / "detection-comparison.md", *(DOCS / "detectors").glob("*.md")]:
        for target in re.findall(r"\]\(([^)#]+)\)", page.read_text()):
            assert (page.parent / target).exists(), f"{page.name}: {target}"


def test_figures_of_the_comparison_are_quoted_as_measured():
    rows = set((DOCS / "reference" / "detection-comparison.md").read_text().splitlines())
    answer = (DOCS / "explanation" / "detection.md").read_text().split("## 8.")[1]
    quoted = [line for line in answer.splitlines() if line.startswith("| ") and not line.startswith("| detector |")]
    assert len(quoted) >= 5
    assert set(quoted) <= rows
