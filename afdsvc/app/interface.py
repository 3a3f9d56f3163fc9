"""The Python interface: arrays, data frames and files in, answers out; `afdsvc` exports it."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import replace
from numbers import Real
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from afdsvc.api.model import Model, Variable
from afdsvc.api.signals import Channel, Trace
from afdsvc.app.answers import Checked, Designed, Diagnosed, Explained, Identified
from afdsvc.app.explain import announce_compilation, from_rest, load_library, parallel
from afdsvc.errors import BadInput
from afdsvc.files.model.model_file import read_model
from afdsvc.files.open import Naming, open_file
from afdsvc.files.tables.foreign import prepared
from afdsvc.files.tables.formats import Columns, is_stamp, stamps
from afdsvc.files.tables.tables import own_names, table_trace
from afdsvc.files.tables.time_base import own_time
from afdsvc.lti.statespace import Array, StateSpace
from afdsvc.present.notebook import notebook_progress

MODELS = (".toml", ".fmu")


def load(path: str | Path, *, model: Model | None = None, rename: Mapping[str, str] | None = None, mapping: str | Path | None = None,
         allow_code: bool = False) -> Any:  # fmt: skip
    """Return the model in a MODEL.toml, or a recording as traces.

    Parameters
    ----------
    path : str or Path
        ``.toml`` or ``.fmu``: a model; ``.csv``, ``.parquet``, ``.mat``, ``.npz``, ``.tdms``, ``.ulg``, ``.bag``, ``.db3`` or ``.mcap``: a recording.
    model : Model, optional
        Gives a recording its units.
    rename : dict of str to str, optional
        Column to name with a role: ``{"current": "u_force"}``; ``""`` leaves a column out.
    mapping : str or Path, optional
        A mapping file for recordings of others.
    allow_code : bool
        Permit the Python simulator of a model to run.

    Returns
    -------
    Model or list of Trace
        One trace for each stretch without a gap.

    Raises
    ------
    BadInput
        For a file that cannot be read: where, what was found, what was expected.

    Examples
    --------
    >>> import afdsvc
    >>> from pathlib import Path
    >>> _ = Path("run.csv").write_text("t_ms,voltage,u_brake\\n0,1,0\\n5,2,0\\n10,1,0\\n")
    >>> (trace,) = afdsvc.load("run.csv", rename={"voltage": "u_voltage"})
    >>> trace.dt, [c.name for c in trace.channels]
    (0.005, ['u_voltage', 'u_brake'])
    """
    path = _path(path, "a recording or model")
    if path.suffix.lower() in MODELS:
        return read_model(path, allow_code)
    return open_file(path, Naming.of(None if mapping is None else Path(mapping), rename)).traces(model)


def check(system: Any, recordings: Any) -> Checked:
    """Compare a model with recordings before anything is fitted; takes seconds.

    Parameters
    ----------
    system : Model, path, or system of python-control or scipy.signal
        The model. A bare system takes the names of its inputs and outputs from the columns ``u_...`` and ``y_...``.
    recordings : DataFrame, dict of arrays, Trace, path, or list of these
        Columns ``t`` [s], ``u_<input>``, ``y_<output>``, ``ref_...``, ``aux_...``; the prefix may be left out of the model's own names, and
        the time may be the index.

    Returns
    -------
    Checked
        With ``verdict``, ``sentences``, ``rows()``, ``to_pandas()``, ``plot()``.

    Examples
    --------
    >>> import afdsvc, numpy as np
    >>> t = np.arange(2000) * 0.01
    >>> u = np.random.default_rng(1).standard_normal(2000).cumsum() / 10
    >>> motor = afdsvc.Model.from_system(([12.0], [0.08, 1]), {"voltage": "V"}, {"speed": "rad/s"})
    >>> found = afdsvc.check(motor, {"t": t, "voltage": u, "speed": -12 * u})
    >>> found.verdict, found.sentences[1][:38]
    ('refused', 'y_speed is of the opposite sign (facto')
    """
    from afdsvc.explain.check.result import check_all

    model, traces = _together(system, recordings)
    result = check_all(model, traces, load_library())
    return Checked({**result.json(), "data": prepared(traces)}, result)


def identify(u: Any, y: Any = None, dt: float | None = None, *, model: Any = None, holdout: Any = (), seed: int = 0, **options: Any) -> Identified:
    """Identify a plant from inputs and outputs, in open loop or in closed loop.

    Parameters
    ----------
    u : array (n,) or (n, m); or DataFrame, Trace, path or list of these
        The inputs; where ``y`` is left out, whole recordings, whose columns are those of `check`.
    y : array (n,) or (n, p), optional
        The outputs.
    dt : float
        Sample time in seconds, with arrays.
    model : Model, path or system, optional
        What is known before: its controller lets feedback be identified by Hansen's scheme; its order is where the search begins.
    holdout : pair of arrays, recording, or list of these
        Never used in fitting; without it the last quarter of every recording is kept away.
    seed : int
        Seed of starting points, where a method uses several.
    **options
        Those of `afdsvc.identify.IdentifyOptions`, such as ``order=4`` or ``method="pbsid"``.

    Returns
    -------
    Identified
        With ``system`` (control.StateSpace), ``model``, ``order``, ``to_pandas()``, ``plot()``.

    Raises
    ------
    BadInput
        Where the data cannot support an answer, with the reason and the cure.

    Examples
    --------
    >>> import afdsvc, numpy as np
    >>> from scipy.signal import lfilter
    >>> rng = np.random.default_rng(0)
    >>> u = rng.standard_normal(4000)
    >>> y = lfilter([0, 0.5], [1, -1.5, 0.7], u) + 0.1 * rng.standard_normal(4000)
    >>> found = afdsvc.identify(u, y, dt=0.01, order=2)
    >>> bool(abs(found.system.poles()[0] - (0.75 + 0.37j)) < 0.01), bool(found.rows()[0]["r2"] > 0.99)
    (True, True)
    """
    from afdsvc.identify.options import IdentifyOptions
    from afdsvc.identify.pipeline import identify as fit

    train = _arrays(u, y, dt) if y is not None else u
    away = _arrays(*holdout, dt) if isinstance(holdout, tuple) and len(holdout) == 2 and y is not None else holdout
    if model is None:
        traces, held = _traces(train, None), _traces(away, None)
        model = _unknown(traces)
        given = False
    else:
        model, traces = _together(model, train)
        held, given = _traces(away, model), True
    with notebook_progress("identifying"):
        result = fit(model, traces, held, IdentifyOptions.of(options), np.random.default_rng(seed))
    return Identified(result.json(), result, given)


def explain(system: Any, recordings: Any, *, holdout: Any = (), jobs: int = 2, trust_units: bool = False) -> Explained:
    """Say why simulation and recordings differ: where, what physics is missing, how well the improved model fits.

    Parameters
    ----------
    system : Model, path, or system of python-control or scipy.signal
        The model, as in `check`.
    recordings : DataFrame, dict of arrays, Trace, path, or list of these
        As in `check`.
    holdout : same as `recordings`, optional
        Never used in fitting; without it the last recording, or the last third of the only one, is kept away.
    jobs : int
        Threads that try hypotheses.
    trust_units : bool
        Go on where units or signs look wrong.

    Returns
    -------
    Explained
        With ``verdict``, ``sentences``, ``result``, ``to_pandas()``, ``plot()``.

    Raises
    ------
    BadInput
        For recordings that do not fit the model; `check` says more.

    Examples
    --------
    >>> import afdsvc, numpy as np
    >>> rng, t = np.random.default_rng(3), np.arange(3000) * 0.01
    >>> u, y = np.repeat(rng.uniform(-4, 4, 150), 20), np.zeros(3000)
    >>> for k in range(2999):  # the recorded motor has 1.2 V worth of dry friction
    ...     y[k + 1] = y[k] + 0.01 / 0.2 * (3 * (u[k] - 1.2 * np.tanh(y[k] / 0.05)) - y[k]) / 1
    >>> motor = afdsvc.Model.from_system(([3.0], [0.2, 1]), {"voltage": "V"}, {"speed": "rad/s"})
    >>> found = afdsvc.explain(motor, {"t": t, "voltage": u, "speed": y + 0.02 * rng.standard_normal(3000)}, jobs=1)
    >>> found.verdict, found.rows()[0]["site"]
    ('omitted_physics', 'state:speed')
    """
    from afdsvc.explain.pipeline import explain as search

    model, traces = _together(system, recordings)
    held = from_rest(_traces(holdout, model), model)
    with notebook_progress("explaining") as bar:

        def progress(what: str, share: float | None) -> None:
            bar(share, what)

        announce_compilation(progress)
        result = search(model, from_rest(traces, model), held, load_library(), mapper=parallel(jobs), progress=progress, trust_units=trust_units)
    result = replace(result, notes={**result.notes, "data": prepared([*traces, *held])})
    return Explained(result.json(None, None), result)


def diagnose(*recordings: Any, model: Any = None, calibrate: float | None = None, detectors: Sequence[str] = (),
             mapping: str | Path | None = None, rename: Mapping[str, str] | None = None, allow_code: bool = False) -> Diagnosed:  # fmt: skip
    """Run the detectors over recordings: the same code and the same evidence as live.

    Parameters
    ----------
    *recordings : path, DataFrame, dict of arrays, Trace, or list of these
        MCAP recordings; or, with ``model``, tables and data in memory with columns as in `check`. The bursts that were played are the
        columns ``alpha_<input>``, or move the set points ``ref_<output>``; without bursts the detectors that need none judge.
    model : Model, path, or system of python-control or scipy.signal, optional
        For recordings that carry none, with the controller that ran: without it only detectors that need no loop judge.
    calibrate : float, optional
        Seconds without bursts from which the noise is estimated.
    detectors : sequence of str
        Used instead of those of the recording's own site.
    mapping, rename
        As in `load`.
    allow_code : bool
        Permit the simulator of ``model`` to run.

    Returns
    -------
    Diagnosed
        With ``sentences``, ``rows()`` (every decision), ``to_pandas()``, ``plot()``.

    Raises
    ------
    BadInput
        For a recording that cannot be diagnosed, with the cure.

    Examples
    --------
    >>> import afdsvc
    >>> found = afdsvc.diagnose(RECORDING)  # the path of a recording, as text; here one that `afdsvc demo` made
    >>> found.document["recordings"][0]["machine"]
    'bearing'

    A motor under speed control, whose actuator has lost 30 % while two sines are added to its input:

    >>> import numpy as np
    >>> t, rng = 0.005 * np.arange(8000), np.random.default_rng(0)
    >>> k = np.arange(8000) % 4000 - 2000  # two bursts of 10 s
    >>> alpha = np.where(k > 0, 0.4 * (np.sin(0.005 * 4 * np.pi * k) + np.sin(0.005 * 12 * np.pi * k)), 0)
    >>> u, x, y = np.zeros(8000), 0.0, 0.05 * rng.standard_normal(8000)
    >>> for k in range(8000):
    ...     y[k] += x
    ...     u[k] = -0.2 * y[k] + alpha[k]
    ...     x += 0.005 * (-12.5 * x + 150 * 0.7 * u[k])
    >>> motor = afdsvc.Model.from_system(([12.0], [0.08, 1]), {"voltage": "V"}, {"speed": "rad/s"}, controller=([-0.2], [1]))
    >>> found = afdsvc.diagnose({"t": t, "voltage": u, "speed": y, "alpha_voltage": alpha}, model=motor)
    >>> found.document["recordings"][0]["verdict"]["fault"]
    'voltage_actuator'
    """
    from afdsvc.app.diagnose import diagnose_recordings

    if model is not None and not isinstance(model, Model):
        model = read_model(Path(model), allow_code) if isinstance(model, (str, Path)) else _together(model, list(recordings))[0]
    listed = [one for r in recordings for one in (r if isinstance(r, (list, tuple)) else [r])]
    memory = next((r for r in listed if not isinstance(r, (str, Path))), None)
    if model is None and memory is not None:
        raise BadInput(f"a {type(memory).__name__} carries no model; give one with model=, such as the path of a MODEL.toml")
    found = [one for r in listed for one in ([Path(r)] if isinstance(r, (str, Path)) else _traces(r, model))]
    if not found:
        raise BadInput("no recording was given; expected at least one")
    model = model and replace(model, origin=model.origin or f"model '{model.name}'")  # errors begin with it
    naming = Naming.of(None if mapping is None else Path(mapping), rename)
    return Diagnosed(diagnose_recordings(found, model, calibrate, None, detectors, naming, allow_code))


def design(site: str | Path, machine: str | None = None, *, allow_code: bool = False, frequencies: Sequence[float] = ()) -> Designed:
    """Return the design sheet of a machine: burst, thresholds, detection probabilities, smallest faults.

    Parameters
    ----------
    site : str or Path
        The site file.
    machine : str, optional
        Its id, where the site has several.
    allow_code : bool
        Permit the model's simulator to run.
    frequencies : sequence of float
        Candidates [rad/s] of which ``document["loop"]`` reports what they disturb, amplitude and phase of every fault.

    Returns
    -------
    Designed
        With ``rows()`` (a row for each fault), ``to_pandas()``, ``plot()``, ``page``.

    Raises
    ------
    BadInput
        For a site file or a machine without limits or noise, with the cure.

    Examples
    --------
    >>> import afdsvc
    >>> from pathlib import Path
    >>> text = 'site = "hall"\\n[[machines]]\\nid = "bearing"\\nplant = "gas_bearing"\\n'
    >>> _ = Path("site.toml").write_text(text)
    >>> sheet = afdsvc.design("site.toml")
    >>> sheet.rows()[0]["fault"], 0.0 > sheet.rows()[0]["smallest_detectable"] > -0.2
    ('horizontal_actuator', True)
    """
    from afdsvc.app.design import design_files

    with tempfile.TemporaryDirectory() as folder:
        page = Path(folder) / "design.html"
        document = design_files(_path(site, "site"), machine, page, allow_code, frequencies)
        return Designed({k: v for k, v in document.items() if k != "report"}, page.read_text(encoding="utf-8"))


def _together(system: Any, recordings: Any) -> tuple[Model, list[Trace]]:
    """Return model and traces; a bare system takes its names from the recordings."""
    if isinstance(system, (str, Path)):
        system = read_model(Path(system))
    model = system if isinstance(system, Model) else None
    traces = _traces(recordings, model)
    if not traces:
        raise BadInput("no recording was given; expected at least one")
    if model:
        return model, traces
    names = [[c.label for c in traces[0].channels if c.role == role] for role in ("u", "y")]
    return Model.from_system(system, *names), traces


def _traces(recordings: Any, model: Model | None) -> list[Trace]:
    """Return recordings of any kind as traces."""
    if isinstance(recordings, (str, Path)):
        return open_file(Path(recordings)).traces(model)
    if isinstance(recordings, Trace):
        return [recordings]
    if isinstance(recordings, (list, tuple)):
        found = [t for one in recordings for t in _traces(one, model)]
        return [replace(t, name=f"{t.name} {k}") if not t.notes.get("path") and len(found) > 1 else t for k, t in enumerate(found, 1)]
    if isinstance(recordings, Mapping) or hasattr(recordings, "columns"):
        return [_frame(recordings, model)]
    raise BadInput(f"recordings are a {type(recordings).__name__}; expected a DataFrame, a dict of arrays, a Trace, a path, or a list of these")


def _frame(frame: Any, model: Model | None) -> Trace:
    """Return a data frame or a dict of arrays as a trace."""
    names = [str(name) for name in (frame if isinstance(frame, Mapping) else frame.columns)]
    own = own_names(names, model) if model else {}
    columns: Columns = {own.get(name, name): _plain(frame[name]) for name in names}
    if not own_time(columns) and hasattr(frame, "index") and type(frame.index).__name__ != "RangeIndex":
        columns = {"t": _plain(frame.index), **columns}
    dt = model.plant.dt if model and model.plant and model.plant.discrete else None
    columns = {name: column if column.dtype.kind == "M" else _numbers(column, f"data frame: column '{name}'") for name, column in columns.items()}
    return table_trace(columns, Path("data frame"), allow_nan=True, default_dt=dt)


def _plain(column: Any) -> Any:
    """Return a column as an array; time differences become seconds, times with a zone and texts of them UTC."""
    found = np.asarray(column)
    if found.dtype.kind in "OU" and len(found) and isinstance(found[0], str) and is_stamp(found[0]):
        return stamps(Path("data frame"), str(getattr(column, "name", "t")), pa.array([str(text) for text in found]))
    if found.dtype.kind == "m":
        return found.astype("timedelta64[ns]").astype("int64") * 1e-9
    if found.dtype.kind == "O" and len(found) and hasattr(found[0], "timestamp"):
        return np.array([round(1e6 * stamp.timestamp()) for stamp in found], dtype="datetime64[us]").astype("datetime64[ns]")
    return found


def _arrays(u: Any, y: Any, dt: float | None) -> list[Trace]:
    """Return arrays, or lists of them (an experiment each), as traces."""
    if not isinstance(dt, Real) or not dt > 0:
        raise BadInput(f"dt is {dt}; expected the sample time in seconds with arrays of u and y")
    if isinstance(u, (list, tuple)) and isinstance(y, (list, tuple)) and u and np.ndim(u[0]) > 0:
        if len(u) != len(y):
            raise BadInput(f"u has {len(u)} experiments and y {len(y)}; expected as many")
        return [replace(_arrays(a, b, dt)[0], name=f"experiment {k}") for k, (a, b) in enumerate(zip(u, y, strict=True), 1)]
    inputs, outputs = _columns("u", u), _columns("y", y)
    if len(inputs) != len(outputs):
        raise BadInput(f"u has {len(inputs)} samples and y {len(outputs)}; expected equal lengths")
    names = [f"{role}_{role}{k + 1}" for role, part in (("u", inputs), ("y", outputs)) for k in range(part.shape[1])]
    return [Trace("arrays", dt, tuple(Channel(n) for n in names), np.hstack([inputs, outputs]))]


def _columns(name: str, part: Any) -> Array:
    found = _numbers(part, name)
    if not found.size:
        raise BadInput(f"{name} is empty; expected (samples,) or (samples, signals)")
    if found.ndim not in (1, 2) or found.shape[-1] > len(found):
        raise BadInput(f"{name} is an array {found.shape}; expected (samples,) or (samples, signals)")
    return np.ascontiguousarray(found[:, None] if found.ndim == 1 else found)


def _numbers(part: Any, where: str) -> Array:
    """Return real numbers; raises `BadInput` for anything else."""
    found = np.asarray(part)
    try:
        if found.dtype.kind != "c":
            return found.astype(np.float64)
    except (ValueError, TypeError):
        pass
    text = next((value for value in found.ravel().tolist() if isinstance(value, (str, complex))), found.dtype)
    raise BadInput(f"{where} holds {text!r}; expected real numbers")


def _path(given: Any, what: str) -> Path:
    """Return a path; raises `BadInput` for what is none."""
    if not isinstance(given, (str, os.PathLike)):
        raise BadInput(f"{what} is a {type(given).__name__}; expected the path of a file")
    return Path(given)


def _unknown(traces: Sequence[Trace]) -> Model:
    """Return a model that says nothing but names and sample time: two lags for each output, from where orders are searched."""
    if not traces:
        raise BadInput("no recording was given; expected at least one")
    labels = {role: [c.label for c in traces[0].channels if c.role == role] for role in ("u", "y")}
    m, p = len(labels["u"]), len(labels["y"])
    if not m or not p:
        raise BadInput(f"{traces[0].name}: {m} inputs and {p} outputs; expected columns u_<name> and y_<name>")
    A = np.kron(np.eye(p), np.array([[0.9, 1.0], [0.0, 0.8]]))
    plant = StateSpace.of(A, np.kron(np.ones((p, m)), [[0.0], [1.0]]), np.kron(np.eye(p), [[1.0, 0.0]]), dt=traces[0].dt)
    inputs, outputs = (tuple(Variable(n) for n in labels[role]) for role in ("u", "y"))
    return Model("identified", inputs, outputs, tuple(Variable(f"x{k + 1}") for k in range(2 * p)), plant, sample_time=traces[0].dt)
