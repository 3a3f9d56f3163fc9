"""`afdsvc design`: the diagnosis burst of a machine, its design sheet and page."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from afdsvc.api.detection import FalseAlarms
from afdsvc.app import commissioning
from afdsvc.app.pipelines import diagnosis_burst
from afdsvc.errors import BadInput
from afdsvc.excite.design_sheet import design_sheet
from afdsvc.excite.loop_sheet import loop_sheet
from afdsvc.files.site import read_site
from afdsvc.plugins.manager import load
from afdsvc.present.html.design_page import design_page


def design_files(
    site_file: Path, machine: str | None, out: Path | None, allow_code: bool = False, frequencies: Sequence[float] = ()
) -> dict[str, Any]:
    """Return the design sheet of a machine (``design --json``) and write its page beside the site file.

    A model that is a simulator (an FMI unit, a Python function) is opened only with ``allow_code``. ``frequencies`` [rad/s] are the
    candidates of which ``loop`` reports (see `afdsvc.excite.loop_sheet`), in place of the burst's and some between.
    """
    site, plugins = read_site(site_file), load()
    config = site.machine(machine) if machine else site.machines[0]
    parts = commissioning.commission(config, plugins, allow_code=allow_code)
    if parts.limits is None or parts.noise is None or parts.controller is None:
        raise BadInput(f"machine '{config.id}' can be watched, not excited; there is no burst to design")
    alarms = {d.kind: FalseAlarms(d.false_alarms_per_1000_bursts / 1000, d.false_alarms_per_day / 24) for d in config.detectors}
    first = next(iter(alarms.values()), FalseAlarms())
    problem = commissioning.problem(parts, parts.noise, first)
    burst = diagnosis_burst(parts)(problem)
    per_hour = 3600 / config.bursts.every_seconds if config.bursts.every_seconds else 0.0
    K = parts.controller.factorisation.K
    sheet = design_sheet(problem, [burst], alarms, per_hour) | {"loop": loop_sheet(problem, burst, K, frequencies)}
    page = out or site_file.with_name(f"{site_file.stem}.{config.id}.design.html")
    units = [v.unit for v in parts.inputs], [v.unit for v in parts.outputs]
    page.write_text(design_page(problem, burst, sheet, units, K), encoding="utf-8")
    return {**sheet, "machine": config.id, "report": str(page)}
