"""Every plugin printed in a tutorial conforms when it is put where the page says."""

from __future__ import annotations

import importlib.util
import re
import sys
from pathlib import Path

import pytest

from afdsvc.testing.conformance import checks
from afdsvc.testing.plugin_package import write_plugin

PAGES = Path(__file__).parents[2] / "docs" / "tutorial"
PRINTED = {
    "controller": ("settling", "controllers"),
    "fault": ("cross_talk", "faults"),
    "physics": ("eddy_brake", "physics"),
    "driver": ("socket_card", "drivers"),
}


def printed(kind: str, folder: Path):
    """Follow the page: let afdsvc write the package, replace its file by what is printed, and load it."""
    name, family = PRINTED[kind]
    page = (PAGES / f"write-a-{kind}.md").read_text()
    assert f"afdsvc plugins new {kind} {name}" in page
    write_plugin(kind, name, folder)
    path = folder / name / f"{name}.py"
    path.write_text(re.findall(r"```python\n(.*?)```", page, re.S)[0])
    spec = importlib.util.spec_from_file_location(name, path)
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return getattr(module, f"afdsvc_{family}")()[0], checks(family)


@pytest.mark.parametrize("kind", PRINTED)
def test_the_plugin_of_the_page_conforms(kind: str, tmp_path: Path):
    thing, asked = printed(kind, tmp_path)
    for check in asked:
        check(thing)


def test_the_settling_controller_settles_as_it_promises(tmp_path: Path):
    """The claim of the page: every pole of loop and observer decays at least as fast as exp(-t / seconds)."""
    import numpy as np

    from afdsvc.plants.gas_bearing import gas_bearing

    plant = gas_bearing().discrete()
    thing, _ = printed("controller", tmp_path)
    for seconds in (0.01, 0.0005):
        made = thing.design(plant, {"seconds": seconds})
        K = made.factorisation.controller
        closed = np.block([[plant.A, plant.B @ K.C], [K.B @ plant.C, K.A]])
        assert abs(np.linalg.eigvals(closed)).max() <= np.exp(-plant.dt / seconds) + 1e-9
