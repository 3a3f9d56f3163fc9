"""Commands about site files."""

from __future__ import annotations

from typing import Annotated

import typer

from afdsvc.cli.options import Json, SiteFile, show

app = typer.Typer(no_args_is_help=True, help="Site files.")


@app.callback()
def _site() -> None:
    """Site files."""


@app.command("check")
def site_check(
    site: SiteFile,
    allow_code: Annotated[bool, typer.Option("--allow-code", help="Permit simulators that the file names to run.")] = False,
    as_json: Json = False,
) -> None:
    """Say what a site file makes of every machine, without starting anything; exit 2 where one could not start."""
    from afdsvc.app.site_check import check_site
    from afdsvc.present.terminal import site_table

    document = check_site(site, allow_code)
    show(as_json, document, lambda: site_table(document))
    if any(m["problem"] for m in document["machines"]):
        raise typer.Exit(2)
