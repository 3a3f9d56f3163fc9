"""The shipped recordings are what the manifest says, and diagnosis says what they show."""

from __future__ import annotations

import hashlib
import tomllib
from pathlib import Path

import pytest

from afdsvc.app.diagnose import diagnose_recordings
from afdsvc.errors import BadInput

FOLDER = Path(__file__).parents[2] / "recordings"
ENTRIES = tomllib.loads((FOLDER / "MANIFEST.toml").read_text())["recordings"]


@pytest.mark.parametrize("entry", ENTRIES, ids=lambda e: e["fault"] or "nominal")
def test_recording(entry):
    path = FOLDER / entry["file"]
    data = path.read_bytes()
    assert len(data) == entry["bytes"]
    assert hashlib.sha256(data).hexdigest() == entry["sha256"]
    (recording,) = diagnose_recordings([path])["recordings"]
    verdict = recording["verdict"]
    assert (verdict["fault"] or "") == entry["fault"]
    if entry["fault"]:
        assert abs(verdict["severity"]["value"] - entry["severity"]) < 3 * verdict["severity"]["sd"]
    else:
        assert verdict["first_detected_s"] is None
    assert recording["remarks"] == []


def test_all_together_are_small():
    assert len(ENTRIES) == 5
    assert sum(e["bytes"] for e in ENTRIES) < 10_000_000


def test_other_detectors_can_be_tried_on_an_old_recording():
    path = Path(__file__).parents[2] / "recordings" / "shipped" / "gas_bearing_vertical_sensor.mcap"
    document = diagnose_recordings([path], detectors=["chi_square"])
    said = {d["detector"] for b in document["recordings"][0]["bursts"] for d in b["decisions"]}
    assert said == {"chi_square"}
    with pytest.raises(BadInput, match="no plugin 'nope' among the detectors"):
        diagnose_recordings([path], detectors=["nope"])
