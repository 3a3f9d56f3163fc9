"""`afdsvc site check`: whether a service and its rigs could start with a site file, machine by machine, without starting anything."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from afdsvc.app.commissioning import Commissioned, commission
from afdsvc.errors import BadInput
from afdsvc.files.site import MachineSection, read_site
from afdsvc.plugins.manager import Plugins, load


def check_site(path: Path, allow_code: bool = False) -> dict[str, Any]:
    """Return what every machine of a site is and what keeps it from starting; raises `BadInput` where the file itself is wrong."""
    site, plugins = read_site(path), load()
    remarks = [] if site.transport.security else [f"whoever reaches {', '.join(site.transport.listen)} may read signals and excite machines (transport.security)"]
    machines = [_machine(m, plugins, allow_code) for m in site.machines]
    return {"site": site.site, "machines": machines, "problem": _kept_nowhere(site.recording.folder), "remarks": remarks}


def _kept_nowhere(folder: Path) -> str:
    """Return why recordings cannot be kept in a folder that is there or would be made, "" where they can."""
    there = next((f for f in (folder, *folder.absolute().parents) if f.exists()), folder)
    try:
        with TemporaryDirectory(dir=there):
            return ""
    except OSError as error:
        return f"recording.folder: recordings cannot be kept in {folder}: {(error.strerror or str(error)).lower()}; expected a folder that can be written"


def _machine(config: MachineSection, plugins: Plugins, allow_code: bool) -> dict[str, Any]:
    try:
        return {"id": config.id, "problem": "", **_described(commission(config, plugins, allow_code=allow_code))}
    except BadInput as error:
        return {"id": config.id, "problem": str(error)}


def _described(machine: Commissioned) -> dict[str, Any]:
    noise = "stated" if machine.output_cov is not None else "estimated from the first seconds without a burst"
    bursts = machine.config.bursts
    excited = "by schedule" if bursts.every_seconds else "on request"
    return {
        "plant": machine.config.plant or str(machine.config.model), "states": machine.plant.order, "sample_time": machine.plant.dt,
        "inputs": [f"{v.name} [{v.unit}]" for v in machine.inputs], "outputs": [f"{v.name} [{v.unit}]" for v in machine.outputs],
        "controller": machine.config.controller.kind if machine.controller else "unknown", "driver": machine.config.driver.kind, "noise": noise,
        "bursts": excited if machine.limits else "none: no limits are stated, so the machine is only monitored",
    }  # fmt: skip
