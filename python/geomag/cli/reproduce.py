"""`geomag reproduce`: the published experiments."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from geomag.cli import app
from geomag.cli._checks import MAX_SEED, positive


@app.command(epilog="Example: geomag reproduce E1 E2 E3 --data ../shared/data --out out/reproduce")
def reproduce(
    experiments: Annotated[list[str] | None, typer.Argument(help="E1 ... E8; all of them by default.")] = None,
    data: Annotated[
        Path,
        typer.Option(help="Folder of surveys and fields; docs/data.md says what it holds and where that comes from."),
    ] = Path("../shared/data"),
    out: Annotated[Path, typer.Option(help="Folder for the report and its pictures.")] = Path("out/reproduce"),
    seed: Annotated[int, typer.Option(min=0, max=MAX_SEED, help="Seed of every draw.")] = 2012,
    effort: Annotated[float, typer.Option(callback=positive, help="Share of the full number of trials.")] = 1.0,
    as_json: Annotated[bool, typer.Option("--json", help="Print report.json instead of text.")] = False,
) -> int:
    """Rerun the published experiments: published figure beside ours, pictures, report.md and report.json."""
    from geomag.reproduce import run

    say = partial(typer.echo, err=True) if as_json else typer.echo
    reports = run(experiments or [], data=data, out=out, seed=seed, effort=effort, say=say)
    if as_json:
        typer.echo((out / "report.json").read_text(encoding="utf-8"))
        return 0
    for report in reports:
        typer.echo("\n" + report.markdown())
    typer.echo(f"report and pictures: {out / 'report.md'}")
    return 0
