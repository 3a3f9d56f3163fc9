"""What ``plugins new`` writes holds what ``plugins check`` asks, and works in a service's parts; what cannot be is refused."""

from __future__ import annotations

import sys
import tomllib

import pytest

from afdsvc.errors import BadInput
from afdsvc.plugins.manager import load
from afdsvc.testing.plugin_package import KINDS, examine_package, write_plugin


@pytest.mark.parametrize("kind", KINDS)
def test_a_new_plugin_conforms(kind, tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "path", list(sys.path))
    name = f"fresh_{kind}"
    files = write_plugin(kind, name, tmp_path)
    assert {p.name for p in files} == {"pyproject.toml", "README.md", f"{name}.py", f"test_{name}.py"}
    declared = tomllib.loads((tmp_path / name / "pyproject.toml").read_text())
    assert declared["project"]["entry-points"]["afdsvc"] == {name: name}
    rows = examine_package(str(tmp_path / name))
    assert len(rows) >= 3
    assert {(r["family"], r["name"]) for r in rows} == {(KINDS[kind], name)}
    assert [r for r in rows if r["failure"]] == []
    sys.modules.pop(name)


def test_a_plugin_that_fails_is_reported_check_by_check(tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "path", list(sys.path))
    write_plugin("detector", "breaks", tmp_path)
    path = tmp_path / "breaks" / "breaks.py"
    path.write_text(path.read_text().replace("per_burst: float  #", "per_burst: float = 0.9  #").replace(
        "problem.false_alarms.per_burst)", "0.9)"))  # fmt: skip
    failed = {r["check"]: r["failure"] for r in examine_package(str(tmp_path / "breaks")) if r["failure"]}
    assert set(failed) == {"is_quiet_on_a_healthy_machine"}
    assert "alarms in 20 healthy bursts" in failed["is_quiet_on_a_healthy_machine"]
    sys.modules.pop("breaks")


@pytest.mark.parametrize(
    ("kind", "name", "sentence"),
    [
        ("colour", "a", "kind of plugin 'colour'; expected one of controller, detector"),
        ("detector", "My-Detector", "plugin name 'My-Detector'; expected small letters"),
        ("detector", "class", "plugin name 'class'"),
        ("detector", "there", "there: exists already and is not overwritten"),
    ],
)
def test_what_cannot_be_is_refused(kind, name, sentence, tmp_path):
    (tmp_path / "there").mkdir()
    with pytest.raises(BadInput, match=sentence):
        write_plugin(kind, name, tmp_path)


def test_a_package_that_is_none_is_named(tmp_path):
    with pytest.raises(BadInput, match="no_such_package_ever: cannot be imported as a plugin"):
        examine_package("no_such_package_ever")
    with pytest.raises(BadInput, match="plugin 'json' offers nothing"):
        examine_package("json")


def test_built_in_families_can_be_checked_by_their_entry_point():
    assert load().family("notifiers")
    with pytest.raises(BadInput, match="offers nothing"):
        examine_package("afdsvc.lti")
