"""Arguments, nothing else: each command hands over to the module that does the work."""

from __future__ import annotations

import sys
import tempfile
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer

from afdsvc import __version__, is_compiled
from afdsvc.cli import plugins, running
from afdsvc.cli.interrupt import INTERRUPTED, end_on_interrupt, leave, was_interrupted
from afdsvc.cli.options import Json, MachineOption, MappingOption, SiteFile, among, show
from afdsvc.errors import AfdsvcError, BadInput

app = typer.Typer(
    name="afdsvc", no_args_is_help=True, pretty_exceptions_enable=False,
    help="Active fault diagnosis for closed-loop machines, and why a model disagrees with its recordings.",
)  # fmt: skip
UsageError: Any = typer.BadParameter.__base__  # whose other kinds typer does not export
app.add_typer(running.app)
app.add_typer(plugins.app, name="plugins")
app.add_typer(running.site, name="site")


def run_cli() -> None:
    """Run the command line: exit 0 done, 2 bad input or usage (one sentence), 1 unexpected failure."""
    end_on_interrupt()
    try:
        code = app(prog_name="afdsvc", standalone_mode=False)
    except AfdsvcError as error:
        sys.exit(_fail(str(error), 2))
    except UsageError as error:
        sys.exit(_wrong_usage(error))
    except (KeyboardInterrupt, typer.Abort):
        leave()
    except BrokenPipeError:
        sys.exit(1)
    except Exception as error:
        if was_interrupted(error):
            leave()
        if isinstance(error, OSError) and error.filename is not None:
            sys.exit(_fail(f"{error.filename}: {(error.strerror or str(error)).lower()}; expected a path that can be read or written", 2))
        sys.exit(_fail(f"unexpected failure: {type(error).__name__}: {error}; a report of it needs {_traceback()}", 1))
    if code == INTERRUPTED:  # typer's word for it
        leave()
    sys.exit(code if isinstance(code, int) else 0)


def _wrong_usage(error: Any) -> int:
    """Say what is wrong with the words of a command, or show the help of one that was given none; return the exit code."""
    if type(error).__name__ == "NoArgsIsHelpError":
        print(error.ctx.get_help())
        return 2
    said = error.format_message()
    path = error.ctx.command_path if error.ctx else app.info.name
    return _fail(f"{said[0].lower()}{said[1:].rstrip('.')}; '{path} --help' says what is expected", 2)


def _traceback() -> str:
    """Return the file that holds the traceback of the exception at hand."""
    with tempfile.NamedTemporaryFile("w", prefix="afdsvc-", suffix=".txt", encoding="utf-8", delete=False) as file:
        traceback.print_exc(file=file)
    return file.name


def _fail(sentence: str, code: int) -> int:
    print(f"afdsvc: {sentence}", file=sys.stderr)
    return code


COMPUTING = ("batch", "check", "demo", "design", "diagnose", "explain", "identify", "init", "retune", "trial")  # and `serve` and `rig`, in their logs


@app.callback(invoke_without_command=True)
def afdsvc(context: typer.Context, show: Annotated[bool, typer.Option("--version", help="Show the version and stop.")] = False) -> None:
    """Active fault diagnosis for closed-loop machines."""
    if show:
        print(__version__)
        raise typer.Exit
    if context.invoked_subcommand in COMPUTING and "--help" not in sys.argv and sys.stderr.isatty() and not is_compiled():
        print("afdsvc: its numerical code is compiled first, once on this computer: up to a minute", file=sys.stderr, flush=True)


@app.command()
def demo(
    plant: Annotated[str, typer.Option(help="The plant that is simulated.")] = "gas_bearing",
    fault: Annotated[list[str] | None, typer.Option(metavar="NAME=SEVERITY@SECONDS", help="May be repeated.")] = None,
    healthy: Annotated[bool, typer.Option("--healthy", help="Inject no fault.")] = False,
    controller: Annotated[str, typer.Option(autocompletion=among("lqg", "proportional"), help="lqg or proportional")] = "lqg",
    rpm: Annotated[int | None, typer.Option(help="Rotor speed; the plant's own otherwise.")] = None,
    seconds: Annotated[float | None, typer.Option(help="Length of the run; 30, with --heal 60.")] = None,
    seed: Annotated[int, typer.Option(help="Seed of the noise.")] = 1,
    heal: Annotated[bool, typer.Option("--heal", help="Disturb the inputs, and accept the Q that is proposed for the fault.")] = False,
    out: Annotated[Path, typer.Option(help="Folder of the recording.")] = Path("recordings"),
    as_json: Json = False,
) -> None:
    """Watch a simulated machine from its first burst to a named fault, with --heal to a healed machine, on this computer alone."""
    from afdsvc.app.demo_site import DemoOptions, first_fault, free_port, parse_fault

    length = seconds or (60.0 if heal else 30.0)
    faults = [] if healthy else fault or [f"{first_fault(plant, heal)}=-0.5@{min(12.0, 0.4 * length):g}"]
    options = DemoOptions(plant, controller, rpm, tuple(parse_fault(f) for f in faults), length, seed, out, heal=heal, console=f"127.0.0.1:{free_port()}")
    print(f"afdsvc: preparing a simulated {plant}: controller, burst and detectors are designed; then it is shown live on http://{options.console}/", file=sys.stderr, flush=True)
    from afdsvc.app.demo import happening, run_demo  # takes seconds to import
    from afdsvc.present.progress import progress
    from afdsvc.present.terminal import demo_table

    with progress("running the machine", length) as tell:
        document = run_demo(options, lambda done, hub: tell(done, happening(hub)))
    show(as_json, document, lambda: demo_table(document))


@app.command("diagnose")
def diagnose_command(
    recordings: Annotated[list[Path], typer.Argument(metavar="RECORDING...", help="MCAP recordings, or tables with --model.")],
    model: Annotated[Path | None, typer.Option(metavar="MODEL.toml", help="The model, for recordings that carry none.")] = None,
    calibrate: Annotated[float | None, typer.Option(metavar="SECONDS", help="Seconds of data without bursts from which the noise is estimated.")] = None,
    calibrate_on: Annotated[Path | None, typer.Option(metavar="TABLE", help="Table from which the noise is estimated.")] = None,
    detector: Annotated[list[str] | None, typer.Option(metavar="NAME", help="Detector to use instead of the site's; may be repeated.")] = None,
    page: Annotated[Path | None, typer.Option("--page", metavar="FILE.html", help="Also write the diagnosis as an HTML page.")] = None,
    allow_code: Annotated[bool, typer.Option("--allow-code", help="Permit the simulator of --model to run; its linear part is used.")] = False,
    mapping: MappingOption = None,
    as_json: Json = False,
) -> None:
    """Run the detectors over recordings: the same code and the same evidence as live."""
    from afdsvc.app.diagnose import diagnose_recordings
    from afdsvc.files.open import Naming
    from afdsvc.present.progress import progress
    from afdsvc.present.terminal import diagnosis_table

    with progress("diagnosing", None):
        document = diagnose_recordings(recordings, model, calibrate, calibrate_on, detector or [], Naming.of(mapping), allow_code)
    if page:
        from afdsvc.present.html.diagnose_page import write_diagnosis

        write_diagnosis(document, page)
    show(as_json, document, lambda: diagnosis_table(document))


@app.command("design")
def design_command(
    site: SiteFile,
    machine: MachineOption = None,
    out: Annotated[Path | None, typer.Option("--out", "-o", metavar="FILE.html", help="Where the page goes.")] = None,
    frequency: Annotated[list[float] | None, typer.Option("--frequency", "-w", metavar="RAD_S", help="A candidate: what it disturbs, phase and amplitude of every fault there; may be repeated.")] = None,
    allow_code: Annotated[bool, typer.Option("--allow-code", help="Permit the model's simulator to run.")] = False,
    as_json: Json = False,
) -> None:
    """Make the design sheet: burst, thresholds, detection probabilities, smallest faults, faults that cannot be distinguished."""
    from afdsvc.app.design import design_files
    from afdsvc.present.terminal import design_table

    document = design_files(site, machine, out, allow_code, frequency or ())
    show(as_json, document, lambda: design_table(document, bool(frequency)))


@app.command()
def init(
    recording: Annotated[Path, typer.Argument(metavar="TABLE", help="A table whose columns say what they are (speed_rpm, voltage_V, t_ms), or a log of topics (bag, ULog, MCAP), whose columns are TOPIC.FIELD.")],
    out: Annotated[Path | None, typer.Option("--out", "-o", metavar="DIR", help="Folder of the files (default: that of the table).")] = None,
    inputs: Annotated[list[str] | None, typer.Option("--input", metavar="COLUMN", help="A column that is an input; may be repeated.")] = None,
    outputs: Annotated[list[str] | None, typer.Option("--output", metavar="COLUMN", help="A column that is an output; may be repeated.")] = None,
    unit: Annotated[list[str] | None, typer.Option("--unit", metavar="COLUMN=UNIT", help="The unit of a column; with s, ms, us or ns it is the time; may be repeated.")] = None,
    step: Annotated[float | None, typer.Option("--step", metavar="SECONDS", help="Time between rows, where no column is the time.")] = None,
    with_site: Annotated[bool, typer.Option("--with-site", help="Also write site.toml, which runs the model as a simulated machine.")] = False,
    limit: Annotated[list[str] | None, typer.Option("--limit", metavar="COLUMN=VALUE", help="Largest magnitude in a burst, for site.toml (default: that of the table).")] = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace files that are there.")] = False,
    as_json: Json = False,
) -> None:
    """Write a first MODEL.toml, a mapping file and a site file from a recording's columns; on a terminal it asks what names do not say."""
    from afdsvc.app.init import Answers, init_files
    from afdsvc.present.terminal import init_table

    ask = _ask if sys.stdin.isatty() and not as_json else None
    answers = Answers(inputs or [], outputs or [], _pairs("--unit", "rpm", unit), _pairs("--limit", "24", limit), step, ask)
    document = init_files(recording, out, answers, overwrite, with_site)
    show(as_json, document, lambda: init_table(document))


def _ask(question: str, default: str, parse: Callable[[str], Any]) -> Any:
    """Ask on the terminal until the answer can be read."""

    def read(text: str) -> Any:
        try:
            return parse(text)
        except BadInput as error:
            raise typer.BadParameter(str(error)) from error

    return typer.prompt(question, default=default, show_default=bool(default), value_proc=read, err=True)


@app.command("check")
def check_command(
    model: Annotated[Path, typer.Argument(metavar="MODEL.toml", help="The model (MODEL.toml), or a recording that carries it.")],
    recordings: Annotated[list[Path] | None, typer.Argument(metavar="RECORDING...", help="MCAP recordings or tables.")] = None,
    out: Annotated[Path | None, typer.Option("--out", "-o", metavar="FILE.html", help="Where the page goes.")] = None,
    column: Annotated[list[str] | None, typer.Option("--map", metavar="COLUMN=u_name", help="Name a foreign column.")] = None,
    mapping: MappingOption = None,
    machine: MachineOption = None,
    allow_code: Annotated[bool, typer.Option("--allow-code", help="Permit the model's Python simulator to run.")] = False,
    as_json: Json = False,
) -> None:
    """Compare a model with recordings before anything is fitted: units, clocks, excitation, what can be tried and what cannot.

    Ends with exit code 2 where model and recordings do not fit together.
    """
    from afdsvc.app.check import check_files
    from afdsvc.app.explain import ExplainOptions
    from afdsvc.present.progress import progress
    from afdsvc.present.terminal import show_check

    options = ExplainOptions(None, _pairs("--map", "u_current", column), allow_code, machine=machine, mapping_file=mapping)
    with progress("comparing simulated with measured", None):
        result, document = check_files(model, recordings or [], options, out)
    show(as_json, document, lambda: show_check(result, document))
    if result.verdict == "refused":
        raise typer.Exit(2)


@app.command("identify")
def identify_command(
    model: Annotated[Path, typer.Argument(metavar="MODEL.toml", help="The nominal model (MODEL.toml).")],
    recordings: Annotated[list[Path], typer.Argument(metavar="RECORDING...", help="MCAP recordings or tables.")],
    holdout: Annotated[list[Path] | None, typer.Option(help="Recordings never used in fitting; may be repeated.")] = None,
    out: Annotated[Path | None, typer.Option("--out", "-o", metavar="MODEL.toml", help="File of the identified model.")] = None,
    method: Annotated[str, typer.Option(autocompletion=among("auto", "hansen", "subspace", "pbsid", "pem", "output_error", "greybox", "indirect"), help="auto, hansen, subspace, pbsid, pem, output_error, greybox or indirect")] = "auto",
    order: Annotated[int | None, typer.Option(help="Order to identify (default: chosen from the data).")] = None,
    reduce_to: Annotated[int | None, typer.Option(help="Order of the plant (default: that of the nominal model).")] = None,
    weighting: Annotated[str | None, typer.Option(autocompletion=among("po-moesp", "pi-moesp", "n4sid", "cva"), help="po-moesp, pi-moesp, n4sid or cva (subspace)")] = None,
    horizon: Annotated[int | None, typer.Option(help="Horizon of the subspace method (default: chosen from the data).")] = None,
    reduction: Annotated[str | None, typer.Option(help="Method of order reduction (default: the best of all, refined on the data).")] = None,
    norm: Annotated[int | None, typer.Option(help="1 or 2: the cost of the indirect method")] = None,
    feedthrough: Annotated[bool | None, typer.Option("--feedthrough/--no-feedthrough", help="May the plant answer within a sample? (default: chosen from the data by auto, yes for subspace, else no)")] = None,
    screening: Annotated[bool | None, typer.Option("--screening/--no-screening", help="Refuse recordings that are frozen, saturated or drift, or fit and report them (default: refuse where a controller is known).")] = None,
    free: Annotated[list[str] | None, typer.Option(metavar="PARAMETER", help="Parameter to estimate (default: all); may be repeated.")] = None,
    starts: Annotated[int | None, typer.Option(help="Number of starting points of the grey-box search.")] = None,
    seed: Annotated[int, typer.Option(help="Seed of the starting points.")] = 0,
    mapping: MappingOption = None,
    allow_code: Annotated[bool, typer.Option("--allow-code", help="Permit the model's Python simulator to run.")] = False,
    as_json: Json = False,
) -> None:
    """Identify the plant from recordings made in closed loop, and judge it on data not used."""
    from afdsvc.app.identify import identify_files
    from afdsvc.files.open import Naming
    from afdsvc.present.progress import progress
    from afdsvc.present.terminal import identify_table

    options = {
        "method": method, "order": order, "reduce_to": reduce_to, "starts": starts, "weighting": weighting, "horizon": horizon,
        "reduction": reduction, "norm": norm, "free": tuple(free) if free else None, "feedthrough": feedthrough, "screening": screening,
    }  # fmt: skip
    with progress("identifying", None) as tell:
        tell(None, f"fitting to {len(recordings)} recording{'s' if len(recordings) > 1 else ''} by {method}")
        document = identify_files(model, recordings, holdout or [], out, options, seed, allow_code, Naming.of(mapping))
    show(as_json, document, lambda: identify_table(document))


@app.command("explain")
def explain_command(
    model: Annotated[Path, typer.Argument(metavar="MODEL.toml", help="The nominal model (MODEL.toml), or a recording that carries it.")],
    recordings: Annotated[list[Path] | None, typer.Argument(metavar="RECORDING...", help="MCAP recordings or tables.")] = None,
    holdout: Annotated[list[Path] | None, typer.Option(help="Recordings never used in fitting; may be repeated.")] = None,
    out: Annotated[Path | None, typer.Option("--out", "-o", metavar="DIR", help="Folder of the improved model and the report.")] = None,
    column: Annotated[list[str] | None, typer.Option("--map", metavar="COLUMN=u_name", help="Name a foreign column.")] = None,
    mapping: MappingOption = None,
    rrd: Annotated[Path | None, typer.Option(metavar="FILE.rrd", help="Write simulations before and after for Rerun.")] = None,
    machine: MachineOption = None,
    allow_code: Annotated[bool, typer.Option("--allow-code", help="Permit the model's Python simulator to run.")] = False,
    jobs: Annotated[int, typer.Option(min=1, help="Cores to use.")] = 2,
    trust_units: Annotated[bool, typer.Option("--trust-units", help="Go on where units or signs look wrong.")] = False,
    as_json: Json = False,
) -> None:
    """Say why simulation and recordings differ: where, what physics is missing, how well the improved model fits."""
    from afdsvc.app.explain import ExplainOptions, explain_files
    from afdsvc.present.progress import progress
    from afdsvc.present.terminal import explain_table

    options = ExplainOptions(out, _pairs("--map", "u_current", column), allow_code, rrd, machine, jobs, mapping, trust_units)
    with progress("explaining", 1.0) as tell:
        document = explain_files(model, recordings or [], holdout or [], options, lambda what, share: tell(share, what))
    show(as_json, document, lambda: explain_table(document))


@app.command("trial")
def trial_command(
    folder: Annotated[Path, typer.Option(metavar="DIR", help="Where trials, sealed answers, results and reports are kept.")] = Path("trials"),
    n: Annotated[int, typer.Option("--n", help="Number of trials in the plan.")] = 20,
    rho: Annotated[float | None, typer.Option(help="Size of the hidden effect: its rms in the outputs relative to the noise; in field trials its share of the held-out error.")] = None,
    kinds: Annotated[list[str] | None, typer.Option(metavar="NAME,NAME", help="Only trials with one of these hidden effects; 'nothing' is one.")] = None,
    parts: Annotated[list[str] | None, typer.Option(metavar="PART,PART", help="Only these parts of the plan; 'field' runs only when named.")] = None,
    seed: Annotated[int, typer.Option(help="Seed of the plan.")] = 1,
    jobs: Annotated[int, typer.Option(min=1, help="Trials at a time.")] = 1,
    keep: Annotated[bool, typer.Option("--keep", help="Keep the recordings.")] = False,
    write_only: Annotated[bool, typer.Option("--write-only", help="Write recordings and sealed answers, explain nothing.")] = False,
    as_json: Json = False,
) -> None:
    """Test `explain` blind: hide physics in recordings, seal the answer, let it look, break the seal, score."""
    from afdsvc.app.trial import trial_files
    from afdsvc.present.progress import progress
    from afdsvc.present.terminal import trial_table

    hidden, of_plan = ([word for text in texts or () for word in text.split(",") if word] for texts in (kinds, parts))
    with progress("trials", 1.0) as tell:
        document = trial_files(folder, n, seed, rho, hidden, of_plan, jobs, keep, lambda done, of: tell(done / of), write_only)
    show(as_json, document, lambda: trial_table(document))


@app.command()
def batch(
    task: Annotated[str, typer.Argument(autocompletion=among("diagnose", "identify", "explain"), help="diagnose, identify or explain")],
    recordings: Annotated[list[Path], typer.Argument(metavar="RECORDING...", help="Recordings or tables.")],
    out: Annotated[Path, typer.Option("--out", "-o", metavar="TABLE.parquet", help="Where the table goes.")],
    model: Annotated[Path | None, typer.Option(metavar="MODEL.toml", help="The model, for recordings that carry none.")] = None,
    detector: Annotated[list[str] | None, typer.Option(metavar="NAME", help="Detectors of `diagnose`, instead of the site's.")] = None,
    mapping: MappingOption = None,
    jobs: Annotated[int, typer.Option(min=1, help="Number of recordings processed at a time.")] = 2,
    cluster: Annotated[str | None, typer.Option(metavar="ADDRESS", help="A Dask scheduler (extra `cluster`).")] = None,
    as_json: Json = False,
) -> None:
    """Work through many recordings into one table; what an earlier run has done is not done again."""
    from afdsvc.app.batch import Batch, run_batch
    from afdsvc.present.progress import progress

    chosen = Batch(task, model, tuple(detector or ()), mapping=mapping)
    with progress(task, len(recordings)) as tell:
        done = run_batch(chosen, recordings, out, jobs, cluster, lambda n, of: tell(n))
    value = {"table": str(done.table), "rows": done.rows, "failed": done.failed, "kept": done.kept}
    said = f"{done.table}: {done.rows} recordings, {done.failed} failed, {done.kept} done before"
    show(as_json, value, lambda: print(said))
    if done.failed and done.failed == done.rows:
        raise typer.Exit(2)


@app.command()
def review(
    recordings: Annotated[list[Path], typer.Argument(metavar="RECORDING...", help="MCAP recordings; several are shown side by side.")],
    save: Annotated[
        Path | None, typer.Option(metavar="FILE.rrd", help="Write a Rerun file instead of opening the viewer.")
    ] = None,
    history: Annotated[bool, typer.Option("--history", help="Show the severity per fault over the dates of all recordings.")] = False,
    as_json: Json = False,
) -> None:
    """Look at recordings in Rerun: is something wrong, since when, which part, how sure, and what the machine did."""
    import tempfile

    from afdsvc.app.review import fault_planes
    from afdsvc.present.rerun import review_history, review_recordings

    if history:
        made = review_history(recordings, save or Path(tempfile.mkdtemp(prefix="afdsvc-review-")) / "history.rrd")
    else:
        made = review_recordings(recordings, save, planes=fault_planes)
    show(as_json, {"rerun": str(made)}, lambda: print(made) if save else _open(made))


def _open(made: Path) -> None:
    from afdsvc.present.rerun import open_viewer

    open_viewer(made)


@app.command("recover")
def recover_command(
    recording: Annotated[Path, typer.Argument(metavar="FILE.mcap", help="A recording that was not closed, or is damaged.")],
    out: Annotated[Path | None, typer.Option("--out", "-o", metavar="FILE.mcap", help="A new file, instead of in place.")] = None,
    as_json: Json = False,
) -> None:
    """Close and index a recording so that every tool opens it, and say what of it is lost."""
    from afdsvc.files.recording.recover import recover as copy
    from afdsvc.files.recording.recover import recover_in_place

    done = copy(recording, out) if out else recover_in_place(recording)
    value = {"recording": str(done.path), "messages": dict(done.messages), "loss": done.loss}
    show(as_json, value, lambda: print(f"{done.path}: {sum(done.messages.values())} messages; {done.loss or 'nothing is lost'}"))


@app.command("import")
def import_(
    table: Annotated[Path, typer.Argument(metavar="TABLE", help=".csv, .parquet, .mat, .npz, .tdms, or .ulg, .bag, .db3 and foreign .mcap with --mapping")],
    out: Annotated[Path, typer.Option("--out", "-o", metavar="FILE.mcap", help="The recording to write.")],
    model: Annotated[Path | None, typer.Option(metavar="MODEL.toml", help="The model to store in the recording.")] = None,
    column: Annotated[list[str] | None, typer.Option("--map", metavar="COLUMN=u_name", help="Name a foreign column.")] = None,
    mapping: MappingOption = None,
    as_json: Json = False,
) -> None:
    """Turn a foreign table into a recording, to the last bit; with a mapping, in its units and at its rate."""
    from afdsvc.app.diagnose import import_recording
    from afdsvc.present.terminal import show_import

    done = import_recording(table, out, model, _pairs("--map", "u_current", column), mapping)
    show(as_json, done, lambda: show_import(done))


def _pairs(option: str, example: str, pairs: list[str] | None) -> dict[str, str]:
    for pair in pairs or []:
        if pair.count("=") != 1:
            raise BadInput(f"{option} '{pair}': expected COLUMN=VALUE, for example column={example}")
    return dict(pair.split("=") for pair in pairs or [])
