"""Every tutorial is followed as it is printed: its commands run, and what it shows is what comes."""

from __future__ import annotations

import importlib.util
import re
import runpy
from pathlib import Path

import numpy as np
import pytest

from afdsvc.plants.gas_bearing import gas_bearing

ROOT = Path(__file__).parents[2]
_spec = importlib.util.spec_from_file_location("run_tutorials", ROOT / "docs" / "run_tutorials.py")
assert _spec is not None
assert _spec.loader is not None
run_tutorials = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(run_tutorials)


@pytest.mark.parametrize("page", run_tutorials.PAGES, ids=lambda p: p.stem)
def test_a_tutorial_prints_what_it_shows(page: Path, tmp_path: Path):
    follower = run_tutorials.Follower(page, tmp_path)
    assert follower.follow() == {}, f"PYTHONPATH=. python docs/run_tutorials.py {page.relative_to(ROOT)}"
    assert follower.said
    for report in tmp_path.rglob("report.html"):  # what is named is not rejected in another shape
        named, _, rejected = report.read_text(encoding="utf-8").partition("Rejected hypotheses")
        first = re.findall(r"<h3>(.*?), (.*?):", named)
        assert first
        assert [n for n in first if n in re.findall(r"<tr><td>(.*?)</td><td>(.*?)</td>", rejected)] == []


def test_the_motor_is_named_in_few_commands_and_its_friction_is_the_true_one():
    page = (ROOT / "docs" / "tutorial" / "from-a-log-to-a-law.md").read_text(encoding="utf-8")
    commands = [line for block in re.findall(r"^```sh\n(.*?)^```", page, re.MULTILINE | re.DOTALL) for line in block.splitlines()]
    assert len(commands) <= 6
    (force,) = re.findall(r"^  0\.50 .*against the direction of motion \(force ([0-9.]+) \+- [0-9.]+ V\)", page, re.MULTILINE)
    assert float(force) == pytest.approx(runpy.run_path(str(ROOT / "examples" / "motor_recording.py"))["FRICTION"], rel=0.05)


@pytest.mark.parametrize(
    ("printed", "same"),
    [
        ("value 0.499 V", True), ("value 0.45 V", False), ("value 0.5", False), ("volts 0.5 V", False),
        ("value ...", True), ("volts ...", False), ("value 0.5 V and ...", False),
    ],
)  # fmt: skip
def test_lines_are_alike_in_words_and_within_two_percent(tmp_path, printed, same):
    (tmp_path / "page.md").write_text(f"```sh\necho value 0.5 V\n```\n\n```text\n{printed}\n```\n")
    (tmp_path / "run").mkdir()
    assert (run_tutorials.Follower(tmp_path / "page.md", tmp_path / "run").follow() == {}) == same


def test_changed_lines_keep_their_dots():
    assert run_tutorials.shortened(" 1.0  a b ...", " 2.0  a c and more") == " 2.0  a c ..."
    assert run_tutorials.shortened("1.0 a", "2.0 a ") == "2.0 a"


def test_the_settling_controller_settles_as_its_page_promises():
    """Every pole of loop and observer decays at least as fast as exp(-t / seconds)."""
    page = (ROOT / "docs" / "tutorial" / "write-a-controller.md").read_text(encoding="utf-8")
    place: dict = {"__name__": "settling"}
    exec(compile(re.findall(r"```python\n(.*?)```", page, re.DOTALL)[0], "settling.py", "exec", dont_inherit=True), place)
    plant = gas_bearing().discrete()
    for seconds in (0.01, 0.0005):
        K = place["Settling"]().design(plant, {"seconds": seconds}).factorisation.controller
        closed = np.block([[plant.A, plant.B @ K.C], [K.B @ plant.C, K.A]])
        assert abs(np.linalg.eigvals(closed)).max() <= np.exp(-plant.dt / seconds) + 1e-9
