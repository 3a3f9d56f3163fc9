"""The package's docstring is its map, hooks are specified and used, and the project stands alone."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

import afdsvc
from afdsvc.plugins import hookspecs
from afdsvc.plugins.manager import FAMILIES

ROOT = Path(afdsvc.__file__).parent
REPOSITORY = ROOT.parent


def test_the_docstring_names_every_room_and_nothing_else():
    named = set(re.findall(r"^- `(\w+)`:", afdsvc.__doc__ or "", re.MULTILINE))
    folders = {p.parent.name for p in ROOT.glob("*/__init__.py")}
    files = {p.stem for p in ROOT.glob("*.py")} - {"__init__", "__main__"}
    assert named == folders | files


def test_every_room_says_what_it_is_for():
    for init in ROOT.rglob("__init__.py"):
        assert init.read_text().lstrip().startswith('"""'), init


def test_every_hook_belongs_to_a_family_and_is_documented():
    hooks = {name for name in dir(hookspecs) if name.startswith("afdsvc_")}
    assert hooks == set(FAMILIES.values())
    for hook in hooks:
        assert getattr(hookspecs, hook).__doc__


def test_nothing_names_this_computer_or_a_package_host():
    """Only the CI script may know where a checkout's neighbours are."""
    names = ["\\.\\./sha" + "red", "/wo" + "rk/", "/ro" + "ot/", "py" + "pi\\.org", "python" + "hosted", "sub" + "agent"]
    found = subprocess.run(
        ["git", "grep", "-nIE", "|".join(names), "--", ".", ":!.ci"], cwd=REPOSITORY, capture_output=True, text=True, check=False
    )
    assert found.stdout == ""
