"""Arguments, nothing else: each command hands over to the module that does the work."""

from __future__ import annotations

import json
import signal
import sys
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer

from afdsvc import __version__
from afdsvc.errors import AfdsvcError, BadInput, Refused

app = typer.Typer(
    name="afdsvc", no_args_is_help=True, add_completion=False, pretty_exceptions_enable=False,
    help="Active fault diagnosis for closed-loop machines, and why a model disagrees with its recordings.",
)
plugins_app = typer.Typer(no_args_is_help=True, help="What is installed, a scaffold for a new plugin, the conformance suite.")
app.add_typer(plugins_app, name="plugins")

Json = Annotated[bool, typer.Option("--json", help="Exactly one JSON document on stdout.")]


def main() -> None:
    """Run the command line: exit 0 done, 2 bad input or usage (one sentence), 1 unexpected failure."""
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))
    try:
        app()
    except (BadInput, Refused) as error:
        sys.exit(_fail(str(error), 2))
    except AfdsvcError as error:
        sys.exit(_fail(str(error), 2))
    except KeyboardInterrupt:
        sys.exit(130)
    except BrokenPipeError:
        sys.exit(1)
    except Exception as error:
        traceback.print_exc(file=sys.stderr)
        sys.exit(_fail(f"unexpected failure: {type(error).__name__}: {error}", 1))


def _fail(sentence: str, code: int) -> int:
    print(f"afdsvc: {sentence}", file=sys.stderr)
    return code


def _show(as_json: bool, value: Any, text: Callable[[], None]) -> None:
    if as_json:
        print(json.dumps(value, indent=2, allow_nan=False, default=str))
    else:
        text()


@app.callback(invoke_without_command=True)
def version(show: Annotated[bool, typer.Option("--version", help="Show the version and stop.")] = False) -> None:
    """Active fault diagnosis for closed-loop machines."""
    if show:
        print(__version__)
        raise typer.Exit
