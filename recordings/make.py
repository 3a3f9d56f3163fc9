"""Make the shipped recordings with the demonstration, and their manifest: python recordings/make.py"""

from __future__ import annotations

import hashlib
import json
import subprocess
import sys
import tempfile
from pathlib import Path

HERE = Path(__file__).parent
FAULTS = ("", "horizontal_actuator", "vertical_actuator", "horizontal_sensor", "vertical_sensor")


def make(fault: str) -> dict[str, str | int]:
    """Run the demonstration once and keep its recording; return its entry."""
    target = HERE / "shipped" / f"gas_bearing_{fault or 'nominal'}.mcap"
    with tempfile.TemporaryDirectory() as folder:
        options = ["--fault", f"{fault}=-0.5@0"] if fault else ["--healthy"]
        command = [sys.executable, "-m", "afdsvc", "demo", "--json", "--seconds", "5", "--out", folder, *options]
        document = json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
        target.parent.mkdir(exist_ok=True)
        target.write_bytes(Path(document["recording"]).read_bytes())
    shows = f"{fault} at -50 % from the start" if fault else "nothing wrong"
    data = target.read_bytes()
    return {
        "file": f"shipped/{target.name}", "sha256": hashlib.sha256(data).hexdigest(), "bytes": len(data), "fault": fault,
        "severity": -0.5 if fault else 0.0,
        "shows": f"simulated gas bearing, 0 rpm, LQG, one diagnosis burst of 2.5 s: {shows}",
    }  # fmt: skip


def main() -> None:
    """Make all and write the manifest."""
    entries = [make(fault) for fault in FAULTS]
    lines = ["# Recordings made by `python recordings/make.py`; sha256 of every file and what it shows.", ""]
    for entry in entries:
        lines += ["[[recordings]]", *(f"{key} = {json.dumps(value)}" for key, value in entry.items()), ""]
    (HERE / "MANIFEST.toml").write_text("\n".join(lines), encoding="utf-8")


if __name__ == "__main__":
    main()
