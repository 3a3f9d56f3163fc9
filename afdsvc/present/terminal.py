"""Tables on the terminal."""

from __future__ import annotations

import math
from datetime import datetime
from itertools import groupby
from operator import itemgetter
from typing import TYPE_CHECKING, Any

from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from afdsvc.dataset.units import with_unit
from afdsvc.present.text_plot import LEGEND, close_up, text_plot

if TYPE_CHECKING:
    from afdsvc.explain.check.result import CheckResult

OUT = Console(markup=False, emoji=False)  # names and paths may hold brackets and colons


def _percent(severity: dict[str, float] | None) -> str:
    """Return a severity with its standard error in percent."""
    return "" if severity is None else f"{100 * severity['value']:+.1f} ± {100 * severity['sd']:.1f} %"


def _number(value: float | None) -> str:
    """Return a number in three digits; what is not finite is a dash."""
    return "-" if value is None else f"{value:.3g}"


WHOLE = {"fault", "detector", "name", "id", "alarm", "machine", "state", "event", "severity"}  # columns of names, folded last


def _table(title: str, *columns: str) -> Table:
    """Return an empty table; what does not fit a narrow terminal is folded, never cut off."""
    table = Table(title=title or None, box=box.SIMPLE_HEAD, pad_edge=False, collapse_padding=True)
    for column in columns:
        table.add_column(column, overflow="fold", no_wrap=column in WHOLE and OUT.width >= 60)
    return table


def demo_table(document: dict[str, Any]) -> None:
    """Show truth beside verdict, and the files to open."""
    verdict = document["recordings"][0]["verdict"]
    table = _table("What was injected and what was found", "", "fault", "severity", "since")
    for t in document["truth"]:
        table.add_row("injected", t["fault"], f"{100 * t['severity']:+.1f} %", f"{t['start_s']:.1f} s")
    if not document["truth"]:
        table.add_row("injected", "none", "", "")
    found = verdict["fault"] or ("a fault, not isolated" if verdict["first_detected_s"] is not None else "none")
    first = verdict["first_detected_s"]
    table.add_row("found", found, _percent(verdict["severity"]), "" if first is None else f"decided at {first:.1f} s")
    OUT.print(table)
    _weights(verdict["weights"])
    if "retuning" in document:
        _healed(document["retuning"], document["measured"])
    OUT.print(f"recording  {document['recording']}", soft_wrap=True)
    OUT.print(f"review     rerun {document['rerun']}", soft_wrap=True)


def _healed(sheet: dict[str, Any], measured: dict[str, dict[str, float]]) -> None:
    """Show the Q that was accepted, and what was measured in the healthy, the damaged and the healed machine."""
    if "refused" in sheet:
        return OUT.print(f"no Q acted: {sheet['refused']}", soft_wrap=True)
    retune_table(sheet)
    table = _table("Measured standard deviations, without bursts", "", *measured)
    for name in next(iter(measured.values())):
        table.add_row(name, *(_number(stretch[name]) for stretch in measured.values()))
    OUT.print(table)


def _weights(weights: dict[str, float]) -> None:
    if weights:
        OUT.print("weights    " + ", ".join(f"{k} {100 * w:.1f} %" for k, w in sorted(weights.items(), key=lambda i: -i[1])))


def diagnosis_table(document: dict[str, Any]) -> None:
    """Show the decisions of every burst and the verdict of every recording."""
    for recording in document["recordings"]:
        columns = ("at", "detector", "value", "limit", "says", "fault", "severity")
        table = _table(f"{recording['recording']} ({recording['machine']})", *columns)
        for burst in recording["bursts"]:
            for d in burst["decisions"]:
                decision = "FAULT" if d["detected"] else ("quiet" if d.get("trustworthy", True) else "not trustworthy")
                table.add_row(
                    f"{burst['start_s']:.2f} s",
                    d["detector"],
                    _number(d["statistic"]),
                    _number(d["threshold"]),
                    decision,
                    d["fault"] or "",
                    _percent(d["severity"]),
                )
        if recording["bursts"]:
            OUT.print(table)
        else:
            OUT.print(f"{recording['recording']} ({recording['machine']}): no bursts", style="bold", soft_wrap=True)
        _passive(recording)
        for remark in (*recording.get("notes", []), *recording["remarks"][:10]):
            OUT.print(f"note: {remark}", soft_wrap=True)
        verdict = recording["verdict"]
        silent = "no fault" if verdict.get("trustworthy", True) else "not trustworthy:"
        words = verdict["fault"] or ("a fault, not isolated" if verdict["first_detected_s"] is not None else silent)
        OUT.print(f"verdict: {words} {_percent(verdict['severity'])} {verdict.get('reason', '')}")
        _weights(verdict["weights"])


def design_table(document: dict[str, Any], candidates: bool = False) -> None:
    """Show what the burst finds and what it cannot, and the ``candidates`` that were asked for."""
    for burst in document["bursts"]:
        lines = ", ".join(f"{w / (2 * math.pi):.3g} Hz ({w:.0f} rad/s)" for w in burst["frequencies_rad_s"])
        OUT.print(
            f"burst on {burst['input']}: {lines}, {burst['seconds']:.2f} s, up to {burst['peak_output']:.3g} at the outputs"
        )
    title = f"{document['machine']}: false alarms per hour {document['false_alarms_per_hour']:.3g}"
    table = _table(title, "fault", "severity", "P_D", "smallest", "sd", "confused with")
    for f in document["faults"]:
        confused = "\n".join(f"{name} {100 * p:.0f} %" for name, p in f["confused_with"].items() if p >= 5e-3)
        smallest = "never" if f["smallest_detectable"] is None else f"{100 * f['smallest_detectable']:.2f} %"
        sd = "" if f["cramer_rao_sd"] is None else f"{100 * f['cramer_rao_sd']:.2f} %"
        table.add_row(f["fault"], f"{100 * f['severity']:.0f} %", f"{f['p_detect']:.3f}", smallest, sd, confused)
    OUT.print(table)
    if document.get("uncertain"):
        OUT.print(f"allowed for: the stated uncertainty of {', '.join(document['uncertain'])}", soft_wrap=True)
    if document.get("unpromised"):
        OUT.print(f"between bursts: {document['unpromised']}", soft_wrap=True)
    if candidates:
        _candidate_table(document["loop"]["candidates"])
    gain, margin = document["loop"]["controller_gain"], document["loop"]["nu_gap"]["margin"]
    low, high = ("" if gain[key] is None else f"{gain[key]:.3g}" for key in ("stable_from", "stable_to"))
    OUT.print(f"loop: stable from {low or '-4 or less'} to {high or '4 or more'} times the controller; least damping {gain['least_damping']:.3g}; margin against the nu-gap {margin:.3g}", soft_wrap=True)
    OUT.print("P_D: probability of detection; smallest: severity found with P_D 0.99; sd: standard error of the severity", soft_wrap=True)
    OUT.print(f"page {document['report']}", soft_wrap=True)


def _candidate_table(candidates: list[dict[str, Any]]) -> None:
    """Show for every candidate what it disturbs, and amplitude and phase of every fault in the output that shows it most."""
    k = len(candidates[0]["severities"]) // 2
    title = f"per unit of alpha, at severity {100 * candidates[0]['severities'][k]:.0f} %"
    table = _table(title, "rad/s", "input", "disturbs", "fault", "amplitude", "phase")
    for c in candidates:
        place = f"{c['rad_s']:.4g}", c["input"], f"{max(c['disturbs'].values()):.3g}"
        for fault, outputs in c["faults"].items():
            seen = max(outputs.values(), key=lambda found: found["amplitude"][k])
            phase = "" if seen["phase_deg"][k] is None else f"{seen['phase_deg'][k]:.1f}°"
            table.add_row(*place, fault, f"{seen['amplitude'][k]:.3g}", phase)
            place = "", "", ""
    OUT.print(table)


EPOCH = 1e6  # s; a recording that begins later counts from another day, and times are shown from its start
APART = 0.1  # distance of the means over the deviation of an output, from which it is shown
MEASURES = {"r2": "R2 of the thesis (4.38), 1 - NRMSE", "r2_classical": "R2, 1 - ratio of variances"}


def identify_table(document: dict[str, Any]) -> None:
    """Show what was identified and how it does on data not used."""
    OUT.print(f"{document['method']}, order {document['order']} ({document.get('order_reason', '')})", soft_wrap=True)
    table = _table("on data not used", "output", "fit", "before", "after")
    for name, fit in document["fit"]["per_output"].items():
        for key, words in MEASURES.items():
            table.add_row(name if key == "r2" else "", words, f"{fit['before'][key]:.4f}", f"{fit['after'][key]:.4f}")
    OUT.print(table)
    for name, p in document["parameters"].items():
        OUT.print(f"{name} = {p['value']:.6g} ± {p['sd']:.2g} {p['unit']}")
    for line in (*document.get("notes", []), *document.get("warnings", [])):
        OUT.print(f"note: {line}", soft_wrap=True)
    OUT.print(f"model  {document['model']}\nreport {document['report']}", soft_wrap=True)


def _passive(recording: dict[str, Any]) -> None:
    """Show what the passive detectors did, beside the rate they promise."""
    for name, promised in recording["promised_alarms"].items():
        decisions = [d for d in recording["passive"] if d["detector"] == name]
        crossed = sum((d["statistic"] or 0.0) >= (d["threshold"] or float("inf")) for d in decisions)
        raised = sum(d["detected"] for d in decisions)
        if decisions:
            counts = f"{crossed} crossings of the threshold, {raised} alarms in {recording['watched_s']:.1f} s"
            OUT.print(f"{name}: {counts}; expected without a fault: {promised:.2g}")
        for why in dict.fromkeys(d["reason"] for d in decisions if not d["trustworthy"]):
            OUT.print(f"  not trustworthy here: {why}")


def status_table(status: dict[str, Any]) -> None:
    """Show the machines of a service: what calls for attention first, then how the watching goes."""
    title = f"{status['site']}: afdsvc {status['version']}, up {status['uptime']:.0f} s"
    table = _table(title, "machine", "state", "alarms", "burst", "samples")
    for m in status["machines"]:
        calling = [a for a in m["alarms"] if a["active"] and not a["suppressed"] and a["kind"] != "notice"]
        style = "bold red" if any(not a["acknowledged"] for a in calling) else "" if m["state"] == "running" else "yellow"
        row = (m["machine"], m["state"], "\n".join(map(_briefly, calling)) or "none", _burst(m), _samples(m))
        table.add_row(*row, style=style)
    OUT.print(table)
    if waits := status.get("longest_waits"):
        OUT.print("longest waits " + ", ".join(f"{what} {seconds:.2f} s" for what, seconds in sorted(waits.items())), soft_wrap=True)
    for m in status["machines"]:
        for said in (m["reason"], m.get("tuning")):
            if said:
                OUT.print(f"{m['machine']}: {said}", soft_wrap=True)
    failure = f"; NOT RECORDING: {status['recording_failure']}" if status["recording_failure"] else ""
    dropped = f"; {status['recording_dropped']} messages dropped" if status["recording_dropped"] else ""
    OUT.print(
        f"recording {status['recording'] or 'nothing'} ({status['recording_bytes'] / 1e6:.1f} MB){failure}{dropped}", soft_wrap=True
    )


def retune_table(sheet: dict[str, Any]) -> None:
    """Show the Q that acts now: variances, sensitivity and room before and after."""
    low, high = (100 * s for s in sheet["severity"])
    OUT.print(f"Q {sheet['tuning']} acts on {sheet['machine']}: {sheet['fault']} {low:.1f} to {high:.1f} %, {sheet['order']} states", soft_wrap=True)
    table = _table("predicted for the middle of that interval", "", "without Q", "with Q")
    for row in sheet["signals"]:
        table.add_row(f"standard deviation of {row['signal']}", _number(row["before"]), _number(row["after"]))
    table.add_row("cost, at worst", _number(sheet["cost_before"]), _number(sheet["cost_after"]))
    table.add_row("sensitivity, at worst", _number(sheet["sensitivity_before"]), _number(sheet["sensitivity_after"]))
    table.add_row("largest noise peak, of its limit", *(f"{100 - 100 * sheet[k]:.0f} %" for k in ("room_before", "room")))
    OUT.print(table)
    OUT.print(
        f"{100 * sheet['reached']:.0f} % of what the best controller of the damaged machine gains" + (f" ({sheet['bound']})" if sheet["bound"] else "")
        + f"; gain rises over {sheet['rise_seconds']:g} s, falls over {sheet['fall_seconds']:g} s, standard deviations meanwhile at most "
        f"{max(sheet['bump_in'], sheet['bump_out']):.2f} times those before and after; if the diagnosis is wrong: sensitivity at most "
        f"{sheet['sensitivity_wrong']:.3g}; closest to its limit: {sheet['tightest']}", soft_wrap=True,
    )  # fmt: skip


def _briefly(alarm: dict[str, Any]) -> str:
    seen = "" if not alarm["acknowledged"] else f" (acknowledged by {alarm['acknowledged_by']})"
    return f"{alarm['fault']} {_percent(alarm['severity'])}{seen}"


def _burst(m: dict[str, Any]) -> str:
    return "plays" if m["burst"] else f"in {m['next_burst']:.1f} s" if m["next_burst"] else "none planned"


def _samples(m: dict[str, Any]) -> str:
    lost = f", {m['lost_blocks']} lost" if m["lost_blocks"] else ""
    late = f", {m['late']} late" if m["late"] else ""
    return f"{m['blocks']} blocks{lost}{late}; head-room {100 * m['head_room']:.0f} %"


def audit_table(audit: dict[str, Any]) -> None:
    """Show who asked for what, and that nothing is missing."""
    table = _table("", "line", "when", "who", "what", "outcome")
    for e in audit["entries"]:
        when = datetime.fromtimestamp(e["time_ns"] / 1e9).strftime("%Y-%m-%d %H:%M:%S")
        said = " ".join(f"{k}={v}" for k, v in e["arguments"].items() if v not in (None, ""))
        table.add_row(str(e["number"]), when, e["who"], f"{e['what']} {said}".strip(), e["outcome"])
    OUT.print(table)
    OUT.print(f"{audit['file']}: {audit['lines']} lines, unbroken; the last has the hash {audit['hash']}", soft_wrap=True)


def alarm_table(alarms: list[dict[str, Any]]) -> None:
    """Show the alarms: those that need attention first, then acknowledged, shelved and ended ones."""
    table = _table("Alarms", "id", "state", "since", "severity")
    by_urgency = sorted(alarms, key=lambda a: (not a["active"], bool(a["shelved_until_ns"]), a["acknowledged"], bool(a["cause"]), -a["since_ns"]))
    for a in by_urgency:
        style = "bold red" if a["active"] and not (a["acknowledged"] or a["suppressed"] or a["shelved_until_ns"]) else ""
        follows = f"follows from\n{a['cause'].removeprefix(a['machine'] + '/')}" if a["suppressed"] else ""  # of the same machine
        state = follows or next((word for word in ("shelved", "confirmed", "acknowledged") if a["active"] and _is(a, word)), _alarm_state(a).partition(",")[0])
        table.add_row(a["id"], state, _moment(a["since_ns"]), "" if follows else _percent(a["severity"]), style=style)
    OUT.print(table)
    for a in by_urgency:
        people = ", ".join(f"{what} by {a[by]}" for what, by in PEOPLE if a[by])
        said = (f"{a['suppressed'] or a['sentence']}", f"{a['count']} decisions" if a["count"] > 1 else "", a["comment"], people)
        OUT.print(f"{a['id']} ({a['kind']}, {_alarm_state(a)}): {'; '.join(filter(None, said))}", soft_wrap=True)


PEOPLE = (("acknowledged", "acknowledged_by"), ("confirmed", "confirmed_by"), ("shelved", "shelved_by"))


def _alarm_state(a: dict[str, Any]) -> str:
    """Return how an alarm stands, in the words of OPC UA Part 9."""
    words = ["active" if a["active"] else "latched" if a["latched"] else "inactive"]
    words += ["acknowledged" if a["acknowledged"] else "unacknowledged"] if a["kind"] != "notice" else []
    words += [word for word in ("confirmed", "shelved", "suppressed") if _is(a, word)]
    return ", ".join(words)


def _is(a: dict[str, Any], word: str) -> bool:
    return bool(a["shelved_until_ns" if word == "shelved" else word])


def _moment(t_ns: int) -> str:
    """Return a time as people read it, in this computer's time zone."""
    return datetime.fromtimestamp(t_ns / 1e9).astimezone().strftime("%Y-%m-%d %H:%M:%S")


def history_table(changes: list[dict[str, Any]]) -> None:
    """Show what happened to alarms, oldest first."""
    table = _table("What happened to alarms", "when", "alarm", "event", "by", "why")
    for c in changes:
        table.add_row(_moment(c["t_ns"]), c["alarm"]["id"], c["event"], c["who"] or "the service", c["why"])
    OUT.print(table)


def plugin_table(rows: list[dict[str, str]], broken: dict[str, str]) -> None:
    """Show the plugins by family."""
    table = _table("", "family", "name", "summary", "from")
    for row in rows:
        table.add_row(row["family"], row["name"], row["summary"], row["plugin"])
    OUT.print(table)
    for name, why in broken.items():
        OUT.print(f"{name} could not be loaded: {why}", style="red")


def explain_table(document: dict[str, Any]) -> None:
    """Show the verdict, the names with their look-alikes, and the fit before and after."""
    OUT.print(f"verdict: {document['verdict'].replace('_', ' ')}", style="bold")
    for sentence in (*document["notes"].get("data", []), *document["check"], *document["sentences"]):
        OUT.print(f"note: {sentence}", soft_wrap=True)
    for place in document["located"][:5]:
        OUT.print(f"where: {place['evidence']}", soft_wrap=True)
    for effect, names in groupby(document["named"], key=itemgetter("effect")):
        OUT.print(f"effect {effect}, with the weight of each name:", style="bold")
        for named in names:
            OUT.print(f"  {named['weight']:.2f}  {named['sentence']}", soft_wrap=True)
    for near in document["candidates"]:
        OUT.print(f"not claimed: {near['sentence']}", soft_wrap=True)
    if document["law"]:
        OUT.print(f"law: {document['law']['sentence']}", soft_wrap=True)
    if document["next_experiment"]:
        OUT.print(f"next experiment: {document['next_experiment']['sentence']}", soft_wrap=True)
    title = f"|y - yhat| / |y - mean| on {', '.join(document['fit']['heldout'])}"
    outputs = document["fit"]["per_output"]
    known = any(fit["noise_floor_nrmse"] is not None for fit in outputs.values())
    table = _table(title, "output", "before", "after", *["noise floor"] * known)
    for name, fit in outputs.items():
        table.add_row(name, *map(_number, (fit["before"]["nrmse"], fit["after"]["nrmse"], *[fit["noise_floor_nrmse"]] * known)))
    OUT.print(table)
    OUT.print(f"model  {document['model']}\nreport {document['report']}", soft_wrap=True)


STYLES = {"stop": ("stops", "bold red"), "warning": ("limits", "yellow"), "ok": ("holds", "green")}


def show_check(result: CheckResult, document: dict[str, Any]) -> None:
    """Show the findings, worst first, a picture of every output, and what will be tried."""
    for sentence in document["data"]:
        OUT.print(f"note: {sentence}", soft_wrap=True)
    for kind, (word, style) in STYLES.items():
        for f in (f for f in result.findings if f.kind == kind):
            OUT.print(Text(f"{word:6} ", style).append(f"{f.topic}: {f.sentence}", ""), soft_wrap=True)
    for c in result.outputs:
        part = close_up(c.measured, c.simulated)
        late = f", {1e3 * c.delay:.3g} ms later" if c.delay else ""
        unit = f" [{c.unit}]" if c.unit else ""
        apart = f", means {with_unit(f'{c.offset:.3g}', c.unit)} apart (left out of both)" if abs(c.offset) > APART * c.measured.std() else ""
        begin, end = c.t[part][[0, -1]] - (c.t[0] if c.t[0] > EPOCH else 0.0)
        r2 = f"R2 {c.r2:.3f}" if c.r2 > -1e3 else "R2 below -1000"
        OUT.print(f"\n{c.output}{unit}, {begin:.4g} to {end:.4g} s, {c.how}: {r2}, gain {c.gain:.3g}{late}{apart}", style="bold", soft_wrap=True)
        OUT.print("\n".join([*text_plot(c.measured[part], c.simulated[part]), f"{'':10}{LEGEND}"]), no_wrap=True, overflow="crop")
    OUT.print(f"\nidentify: {document['identify']['sentence']}", soft_wrap=True)
    if result.outputs:
        _offers(document["explain"])
    OUT.print(f"report    {document['report']}", soft_wrap=True)


def _offers(explain: dict[str, Any]) -> None:
    axes = "; ".join(explain["axes"]) or "no state is known as a velocity, so laws of force have no place: state rate_of, or a unit such as rad/s"
    OUT.print(f"explain:  motion: {axes}", soft_wrap=True)
    OUT.print(f"          tries {', '.join(explain['tried'])}", soft_wrap=True)
    lacking: dict[str, list[str]] = {}
    for name, lacks in explain["not_tried"].items():
        lacking.setdefault(lacks, []).append(name)
    for lacks, names in lacking.items():
        OUT.print(f"          not tried: {', '.join(names)} (needs {lacks})", soft_wrap=True)


def site_table(document: dict[str, Any]) -> None:
    """Show what every machine of a site file is, and what keeps it from starting."""
    table = _table(f"site {document['site']}", "id", "what it is", "bursts", "starts")
    for m in document["machines"]:
        if m["problem"]:
            table.add_row(m["id"], m["problem"], "", Text("no", "bold red"))
            continue
        sides = f"{', '.join(m['inputs'])} to {', '.join(m['outputs'])}"
        what = f"{m['plant']}, {m['states']} states, {1 / m['sample_time']:.6g} Hz, {sides}; controller {m['controller']}, driver {m['driver']}, noise {m['noise']}"
        table.add_row(m["id"], what, m["bursts"], Text("yes", "green"))
    OUT.print(table)
    if document["problem"]:
        OUT.print(document["problem"], style="bold red", soft_wrap=True)
    for remark in document["remarks"]:
        OUT.print(f"note: {remark}", soft_wrap=True)


def init_table(document: dict[str, Any]) -> None:
    """Show what each column was taken for, the first model, and what to do next."""
    table = _table("", "column", "signal", "unit")
    for c in document["columns"]:
        table.add_row(c["column"], c["signal"], c["unit"] or "not stated")
    OUT.print(table)
    for name, why in document["left_out"].items():
        OUT.print(f"{name} is left out: {why}", soft_wrap=True, markup=False)
    site = f"\nsite    {document['site']}" if "site" in document else ""
    for name, fit in document["fits"].items():
        OUT.print(f"{name}: {list(fit['num'])} / {list(fit['den'])} explains {100 * fit['r2']:.1f} % of its variance", soft_wrap=True)
    OUT.print(f"model   {document['model']}\nmapping {document['mapping']}{site}\nnext:", soft_wrap=True)
    for command in document["next"]:
        OUT.print(f"  {command}", soft_wrap=True)


def show_import(document: dict[str, Any]) -> None:
    """Show what was written, and what was done to the data on the way."""
    for note in document["notes"]:
        OUT.print(f"note: {note}", soft_wrap=True)
    pieces = f" in {document['pieces']} pieces" if document["pieces"] > 1 else ""
    OUT.print(f"{document['recording']}: {document['samples']} samples{pieces}, {', '.join(document['channels'])}", soft_wrap=True)


def trial_table(document: dict[str, Any]) -> None:
    """Show what came of blind trials, and where the report is."""
    OUT.print(document["summary"], soft_wrap=True)
    if "markdown" in document:
        OUT.print(f"report {document['markdown']}\n       {document['html']}", soft_wrap=True)


def check_table(rows: list[dict[str, str]]) -> None:
    """Show the checks of a plugin, and what does not hold."""
    table = _table("", "", "plugin", "what is asked")
    for r in rows:
        mark = Text("fails", "bold red") if r["failure"] else Text("holds", "green")
        table.add_row(mark, r["name"], Text(r["asked"]).append(f"\n{r['failure']}" if r["failure"] else "", "red"))
    OUT.print(table)
