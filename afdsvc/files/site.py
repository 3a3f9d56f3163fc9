"""The site file: one TOML for service, rig agents and viewers, strictly validated."""

from __future__ import annotations

import ipaddress
import os
import re
from datetime import time
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, field_validator, model_validator

from afdsvc.errors import BadInput
from afdsvc.files.validation import read_text, toml_table, validated

_ID = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]*")
Positive = Annotated[float, Field(gt=0)]
LAST_PORT = 65535


def _with_port(address: str) -> str:
    """Return ``host:port`` or ``protocol/host:port``; raises `ValueError` for a port that no computer has."""
    port = re.fullmatch(r"(?:\w+/)?[^/]+:(\d+)(?:[?#].*)?", address)
    if port and int(port.group(1)) > LAST_PORT:
        raise ValueError(f"'{address}' has the port {port.group(1)}; expected at most {LAST_PORT}")
    return address


Address = Annotated[str, AfterValidator(_with_port)]


def _plain_id(value: str) -> str:
    """Return an id that can be part of keys and file names; raises `ValueError` naming the signs expected."""
    if not _ID.fullmatch(value):
        raise ValueError("expected letters, digits, '-', '_' and '.'")
    return value


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class Security(_Strict):
    """Mutual TLS: the folder of keys and certificates, and the people (names in their certificates) by what they may do.

    Operators may do everything people can, except that only tuners (operators or not) may let a Q act; viewers see samples,
    decisions and the status, and can ask for nothing else.
    """

    keys: Path
    operators: list[str] = []
    viewers: list[str] = []
    tuners: list[str] = []

    @field_validator("operators", "viewers", "tuners")
    @classmethod
    def _plain(cls, value: list[str]) -> list[str]:
        taken = next((name for name in value if name in ("service", "ca") or name.startswith("rig.")), None)
        if taken is not None:
            raise ValueError(f"'{taken}' names a certificate of the site itself; expected the name of a person")
        return [_plain_id(name) for name in value]

    @model_validator(mode="after")
    def _distinct(self) -> Security:
        both = sorted(set(self.operators) & set(self.viewers))
        if both:
            raise ValueError(f"'{both[0]}' is operator and viewer; expected one of both")
        if both := sorted(set(self.tuners) & set(self.viewers)):
            raise ValueError(f"'{both[0]}' is tuner and viewer; expected one of both")
        return self


class TransportSection(_Strict):
    """Where the service listens and how the others find it; by default on the loopback interface only. A second service listens at ``standby``.

    A rig keeps ``cache_blocks`` blocks in memory, and what the service does not acknowledge in the folder ``store``, at most
    ``store_megabytes`` for each machine.
    """

    listen: list[Address] = ["tcp/127.0.0.1:7447"]
    connect: list[Address] = []
    standby: list[Address] = []
    mode: Literal["peer", "router"] = "peer"
    security: Security | None = None
    trusted_network: bool = False
    patience_seconds: Positive = 5.0
    cache_blocks: Annotated[int, Field(ge=10)] = 4000
    store: Path | None = None
    store_megabytes: Positive = 1000.0

    @model_validator(mode="after")
    def _known_peers_only(self) -> TransportSection:
        for endpoint in [*self.listen, *self.connect, *self.standby]:
            protocol, _, address = endpoint.partition("/")
            if self.security and protocol != "tls":
                raise ValueError(f"with 'security' every endpoint is 'tls/host:port'; found '{endpoint}'")
            if not (self.security or self.trusted_network or _loopback(address)):
                raise ValueError(
                    f"'{endpoint}' is reachable from other computers; set 'security', or 'trusted_network = true' where everybody "
                    "who can reach it may excite the machines"
                )
        return self

    def endpoints(self) -> list[str]:
        """Return the endpoints rig agents and viewers connect to."""
        return [*(self.connect or self.listen), *self.standby]


def _loopback(address: str) -> bool:
    host = address.split("#")[0].rsplit(":", 1)[0].strip("[]")
    try:
        return host == "localhost" or ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False  # a name, which may mean any address


class RecordingSection(_Strict):
    """Where recordings go, when a new file is begun, and how much is kept (default: everything)."""

    folder: Path = Path("recordings")
    max_megabytes: Positive = 512.0
    max_minutes: Positive = 60.0
    keep_megabytes: Positive | None = None
    keep_days: Positive | None = None
    preview_hz: Positive = 100.0


class PluginSection(_Strict):
    """A plugin by name with its settings."""

    kind: str
    settings: dict[str, Any] = {}


class Alarms(_Strict):
    """Debounce of alarms, how long their history is kept, and who is notified (notifier plugins)."""

    raise_after: Annotated[int, Field(ge=1, le=20)] = 1
    clear_after: Annotated[int, Field(ge=1, le=100)] = 2
    latch: bool = False
    shelve_minutes: Positive = 24 * 60.0
    history: Path | None = None
    keep_days: Positive = 3650.0
    before_seconds: Annotated[float, Field(ge=0, le=600)] = 60.0
    severity_limit: Annotated[float, Field(ge=-1, lt=0)] = -0.5
    notify: list[PluginSection] = []


class Web(_Strict):
    """Where something is served over HTTP; off by default, and on other computers' request only where that is allowed."""

    listen: Address | None = None
    trusted_network: bool = False

    @field_validator("listen")
    @classmethod
    def _host_and_port(cls, value: str | None) -> str | None:
        if value is not None and not re.fullmatch(r"[^:/\s]+:\d{1,5}", value):
            raise ValueError("expected host:port, like 127.0.0.1:9464")
        return value

    @model_validator(mode="after")
    def _here_unless_trusted(self) -> Web:
        if self.listen and not self.trusted_network and not _loopback(self.listen):
            raise ValueError(f"'{self.listen}' is readable from other computers; 'trusted_network = true' allows it")
        return self


class Review(_Strict):
    """Rerun: off, a file beside each recording, or a live viewer on loopback."""

    rerun: Literal["off", "file", "live"] = "off"
    port: Annotated[int, Field(ge=1, le=LAST_PORT)] = 9876


class FaultInjection(_Strict):
    """A fault the simulator injects; for demonstration and commissioning."""

    name: str
    severity: Annotated[float, Field(ge=-1, le=1)]
    at_seconds: Annotated[float, Field(ge=0)] = 0.0


STEPPED = {"fmu": "the path of an FMI unit", "function": "a function as file.py:name or package.module:name"}


class DriverSection(_Strict):
    """What stands behind the machine: the simulator, an FMI unit, a Python function, a replay of a recording, or a driver plugin.

    ``options`` are those in which the simulated plant differs from the machine's own ``options`` (parameters of an FMI unit, keyword
    arguments of a function); ``speed`` is its speed over time as ``[second, rpm]``, linear in between. ``unit`` is the FMI unit's
    file, or the function as ``file.py:name`` or ``package.module:name``; ``variables`` maps the model's names to the unit's.
    """

    kind: str = "simulator"
    real_time: bool = True
    seed: int = 0
    recording: Path | None = None
    unit: str | None = None
    variables: dict[str, str] = {}
    faults: list[FaultInjection] = []
    options: dict[str, Any] = {}
    speed: list[tuple[Annotated[float, Field(ge=0)], float]] = []
    settings: dict[str, Any] = {}

    @model_validator(mode="after")
    def _replay_needs_recording(self) -> DriverSection:
        if self.kind == "replay" and self.recording is None:
            raise ValueError("a replay needs 'recording', the path of the file to replay")
        if self.kind in STEPPED and self.unit is None:
            raise ValueError(f"a driver of kind '{self.kind}' needs 'unit', {STEPPED[self.kind]}")
        return self


class Fault(_Strict):
    """A fault the detectors look for: its name, its kind (a plugin), and where it sits."""

    name: str
    kind: str
    settings: dict[str, Any] = {}


class DetectorSection(_Strict):
    """A detector and its share of the false alarms."""

    kind: str
    false_alarms_per_1000_bursts: Positive = 1.0
    false_alarms_per_day: Positive = 1 / 30
    settings: dict[str, Any] = {}


class LimitSettings(_Strict):
    """Bounds per channel in the machine's units; defaults are those of the plant.

    ``sensor_range`` is the largest plausible magnitude of each output's reading; one beyond counts as missing.
    """

    output: list[Positive] | None = None
    input: list[Positive] | None = None
    alpha: list[Positive] | None = None
    sensor_range: list[Positive] | None = None
    seconds: Positive = 14.0


class LineSection(_Strict):
    """A sine of a stated burst: the input it enters at by name, its frequency, and its amplitude in alpha."""

    input: str
    rad_s: Positive
    alpha: Positive


class Bursts(_Strict):
    """When bursts are played, where they enter the loop and how large they may be; ``lines`` state one in place of that which is designed."""

    every_seconds: Positive | None = None
    jitter_seconds: Annotated[float, Field(ge=0)] = 0.0
    rest_seconds: Annotated[float, Field(ge=0)] = 1.0
    after_event: bool = False
    isolate: bool = True
    first_after_seconds: Annotated[float, Field(ge=0)] = 2.0
    seconds: Positive = 2.5
    output_amplitude: Positive | None = None
    through: Literal["alpha", "input", "setpoint"] = "alpha"
    severity: Annotated[float, Field(ge=-1, lt=0)] = -0.5
    quiet_hours: list[tuple[time, time]] = []
    lines: list[LineSection] = []


class Retune(PluginSection):
    """How Q is designed for a damaged machine: the retuner, its settings, and the weights of the cost (``state_weight``, ``input_weight``,
    ``process_weight``) where they differ from those of the controller."""

    kind: str = "h2"
    cost: dict[str, Any] = {}


class MachineSection(_Strict):
    """One machine: plant or model, driver, controller, faults, limits, bursts, detectors, retuning."""

    id: str
    plant: str | None = None
    options: dict[str, Any] = {}
    model: Path | None = None
    driver: DriverSection = DriverSection()
    controller: PluginSection = PluginSection(kind="lqg")
    faults: list[Fault] | None = None
    speed_step_rpm: Positive | None = None
    limits: LimitSettings = LimitSettings()
    output_sd: list[Positive] | None = None
    input_sd: list[Positive] | None = None
    uncertainty: dict[str, Positive] = {}
    calibrate_seconds: Annotated[float, Field(ge=0)] = 0.0
    calibrate_on: Path | None = None
    bursts: Bursts = Bursts()
    retune: Retune = Retune()
    detectors: list[DetectorSection] = [DetectorSection(kind=kind) for kind in ("matched_filter", "regression", "cusum", "passive_cusum")]
    block: Annotated[int, Field(ge=10, le=5000)] = 250

    @field_validator("id")
    @classmethod
    def _plain(cls, value: str) -> str:
        return _plain_id(value)

    @model_validator(mode="after")
    def _one_source(self) -> MachineSection:
        if (self.plant is None) == (self.model is None):
            raise ValueError("expected exactly one of 'plant' and 'model'")
        if self.speed_step_rpm and (self.model or self.calibrate_seconds):
            raise ValueError("'speed_step_rpm' needs 'plant' and stated noise: noise estimated at one speed is not valid at another")
        if self.uncertainty and self.model:
            raise ValueError("'uncertainty' names parameters of a built-in plant; of a model, state it in its [uncertainty]")
        if self.calibrate_on and not self.calibrate_seconds:
            raise ValueError("'calibrate_on' needs 'calibrate_seconds', the length of its quiet beginning")
        return self


class Site(_Strict):
    """A whole site file. ``text`` is the file as it was read, ``origin`` its path."""

    site: str
    machines: Annotated[list[MachineSection], Field(min_length=1)]
    transport: TransportSection = TransportSection()
    recording: RecordingSection = RecordingSection()
    review: Review = Review()
    alarms: Alarms = Alarms()
    metrics: Web = Web()
    web: Web = Web()
    text: str = Field(default="", exclude=True)
    origin: str = Field(default="", exclude=True)

    @field_validator("site")
    @classmethod
    def _plain(cls, value: str) -> str:
        return _plain_id(value)

    @model_validator(mode="after")
    def _distinct(self) -> Site:
        ids = [m.id for m in self.machines]
        twice = sorted({i for i in ids if ids.count(i) > 1})
        if twice:
            raise ValueError(f"machine ids must differ; '{twice[0]}' appears {ids.count(twice[0])} times")
        return self

    def machine(self, id: str) -> MachineSection:
        """Return one machine; raises `BadInput` that lists the ids there are."""
        for machine in self.machines:
            if machine.id == id:
                return machine
        raise BadInput(f"{self.origin}: no machine '{id}'; it has {', '.join(m.id for m in self.machines)}")


def read_site(path: Path) -> Site:
    """Read and validate a site file; raises `BadInput` naming file, key, value found and value expected.

    Paths inside the file are relative to its folder. A site that names no folder for recordings keeps them in the state directory
    of its systemd unit (``STATE_DIRECTORY``), where there is one; rigs keep there what is not acknowledged, in ``store``.
    """
    text = read_text(path)
    return parse_site(text, str(path), path.parent)


def parse_site(text: str, origin: str, folder: Path | None = None) -> Site:
    """Validate the text of a site file; see `read_site`."""
    data = toml_table(text, origin)
    if "text" in data or "origin" in data:
        raise BadInput(f"{origin}: key 'text' or 'origin' is unknown; see the reference of the site file")
    if "machines" not in data and {"inputs", "outputs"} & set(data):
        raise BadInput(f"{origin}: is a model (MODEL.toml); expected a site file, with site and machines")
    site = validated(Site, data, origin)
    return _anchored(site.model_copy(update={"text": text, "origin": origin}), folder)


def _anchored(site: Site, folder: Path | None) -> Site:
    if folder is None:
        return site
    machines = [
        m.model_copy(
            update={
                "model": m.model and folder / m.model,
                "calibrate_on": m.calibrate_on and folder / m.calibrate_on,
                "driver": m.driver.model_copy(
                    update={"recording": m.driver.recording and folder / m.driver.recording, "unit": _placed(m.driver.unit, folder)}
                ),
            }
        )
        for m in site.machines
    ]
    stated = "folder" in site.recording.model_fields_set
    state = os.environ.get("STATE_DIRECTORY", "")  # set by systemd, which may list several
    kept = folder if stated or not state else Path(state.split(":")[0])
    recording = site.recording.model_copy(update={"folder": kept / site.recording.folder})
    alarms = site.alarms.model_copy(update={"history": site.alarms.history and folder / site.alarms.history})
    store = site.transport.store
    kept_by_rigs = folder / store if store else Path(state.split(":")[0]) / "store" if state else None
    transport, secure = site.transport.model_copy(update={"store": kept_by_rigs}), site.transport.security
    if secure:
        keys = secure.model_copy(update={"keys": folder / secure.keys})
        transport = transport.model_copy(update={"security": keys})
    return site.model_copy(update={"machines": machines, "recording": recording, "alarms": alarms, "transport": transport})


def _placed(unit: str | None, folder: Path) -> str | None:
    """Return a file's place made absolute; a module's name stays."""
    return str(folder / unit) if unit and (unit.endswith(".fmu") or ".py:" in unit) else unit
