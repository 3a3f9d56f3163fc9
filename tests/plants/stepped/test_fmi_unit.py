"""FMI 2 and 3 units built by pythonfmu: their numbers against the formula they hold, and every refusal."""

import gc
import sys
import zipfile

import numpy as np
import pytest

from afdsvc.errors import BadInput
from afdsvc.plants.stepped.fmi_unit import FmiUnit, describe
from afdsvc.testing.fmi_units import build_slide

pytest.importorskip("fmpy", reason="the extra 'fmi' is not installed")
DT = 2e-3


@pytest.fixture(scope="module", params=[2, 3])
def slide(request, tmp_path_factory):
    """A slide on a spring as a unit of FMI 2 and of FMI 3."""
    pytest.importorskip({2: "pythonfmu", 3: "pythonfmu3"}[request.param], reason="the builder of test units is not installed")
    return build_slide(tmp_path_factory.mktemp("unit"), request.param)


def formula(u: np.ndarray, stiffness: float = 4000.0) -> np.ndarray:
    """Return the positions a slide has before every step."""
    q = v = 0.0
    found = []
    for force in u:
        found.append(q)
        for _ in range(20):
            v += DT / 20 * (-stiffness * q - 20 * v + 500 * force)
            q += DT / 20 * v
    return np.array(found)


def run(unit: FmiUnit, u: np.ndarray) -> np.ndarray:
    return np.array([unit.begin(), *(unit.advance(np.array([f]), DT) for f in u[:-1])])[:, 0]


def test_a_unit_says_what_it_has(slide):
    unit = describe(slide)
    assert (unit.name[:-1], dict(unit.inputs), dict(unit.outputs)) == ("Slide", {"force": ""}, {"position": ""})


def test_it_moves_as_its_formula_says_and_begins_anew(slide):
    u = np.random.default_rng(0).standard_normal(200)
    unit = FmiUnit(slide, ["force"], ["position"], {"stiffness": 4080.0}, ["position", "velocity"])
    try:
        for _ in range(2):
            np.testing.assert_allclose(run(unit, u), formula(u, 4080.0), rtol=1e-12, atol=1e-15)
        assert unit.states()[0] == unit.advance(np.zeros(1), 1e-9)[0] or unit.states().shape == (2,)
    finally:
        unit.close()
    unit.close()


def test_two_units_do_not_disturb_each_other(slide):
    u = np.random.default_rng(0).standard_normal(50)
    one, other = (FmiUnit(slide, ["force"], ["position"], {"stiffness": k}) for k in (4000.0, 5000.0))
    y = [one.begin()], [other.begin()]
    for force in u[:-1]:
        for unit, found in zip((one, other), y, strict=True):
            found.append(unit.advance(np.array([force]), DT))
    np.testing.assert_allclose(np.array(y[0])[:, 0], formula(u), atol=1e-15)
    np.testing.assert_allclose(np.array(y[1])[:, 0], formula(u, 5000.0), atol=1e-15)
    one.close()
    other.close()


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ((["current"], ["position"]), "has no input 'current'; it has force"),
        ((["force"], ["speed"]), "has no output 'speed'; it has position"),
        ((["position"], ["position"]), "has no input 'position'; it has force"),
        ((["force"], ["position"], {"mass": 1.0}), "has no parameter 'mass'; it has force, stiffness, friction"),
        ((["force"], ["position"], {}, ["acceleration"]), "has no variable 'acceleration'; it has "),
    ],
)
def test_a_variable_that_is_not_there_is_named_with_those_that_are(slide, arguments, said):
    with pytest.raises(BadInput, match=said) as refusal:
        FmiUnit(slide, *arguments)
    assert str(slide) in str(refusal.value)


@pytest.mark.parametrize(
    ("start", "said"), [({"fail_after": 0.1}, r"Slide.\.fmu fails at 0\.1"), ({"nan_after": 0.1}, r"Slide.\.fmu returns nan for output 0")]
)
def test_a_unit_that_fails_is_named_and_can_be_closed(slide, start, said, capfd):
    unit = FmiUnit(slide, ["force"], ["position"], start)
    with pytest.raises(BadInput, match=said):
        run(unit, np.ones(200))
    if "fail_after" in start:
        with pytest.raises(BadInput, match="has failed or is closed"):
            unit.advance(np.ones(1), DT)
    assert unit.begin() == [0.0]
    unit.close()
    gc.collect()  # what a failed unit left behind must not be freed
    assert capfd.readouterr().out == ""  # stdout belongs to --json


def test_what_is_no_unit_is_refused(slide, tmp_path):
    with pytest.raises(BadInput, match=r"none\.fmu: cannot be read: no such file"):
        describe(tmp_path / "none.fmu")
    (tmp_path / "text.fmu").write_text("hello")
    with pytest.raises(BadInput, match=r"text\.fmu: is not a readable FMI unit"):
        describe(tmp_path / "text.fmu")


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('fmiVersion="2.0"', 'fmiVersion="1.0"', "is a unit of FMI 1.0; expected FMI 2 or 3|is not a readable FMI unit"),
        ("<CoSimulation", "<ModelExchange", "offers no co-simulation|is not a readable FMI unit"),
    ],
)
def test_a_unit_of_another_kind_is_refused(tmp_path, old, new, said):
    pytest.importorskip("pythonfmu", reason="the builder of test units is not installed")
    whole, changed = build_slide(tmp_path), tmp_path / "other.fmu"
    with zipfile.ZipFile(whole) as source, zipfile.ZipFile(changed, "w") as target:
        for item in source.infolist():
            data = source.read(item)
            if item.filename == "modelDescription.xml":
                assert old in data.decode()
                data = data.decode().replace(old, new).replace("</CoSimulation", "</ModelExchange" if "Model" in new else "</CoSimulation").encode()
            target.writestr(item, data)
    with pytest.raises(BadInput, match=said):
        describe(changed)


def test_without_the_extra_it_is_named(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "fmpy", None)
    with pytest.raises(BadInput, match=r"any\.fmu: an FMI unit needs the extra 'fmi': install afdsvc\[fmi\]"):
        describe(tmp_path / "any.fmu")
