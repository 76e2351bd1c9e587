"""The command line. Exit status: 0 fixed (or done), 1 bad input (one line on standard error), 3 no usable fix."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from geomag._errors import GeomagError
from geomag._optional import require

require("typer", "cli", "the geomag command")

import click  # noqa: E402 - comes with typer, whose absence is reported above
import typer  # noqa: E402

NO_FIX = 3
BAD_INPUT = 1

app = typer.Typer(
    name="geomag",
    help="Geomagnetic and gravity map-matching navigation: position fixes, honest about when not to use them.",
    no_args_is_help=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
)


def _version(asked: bool) -> None:
    if asked:
        from geomag import __version__

        typer.echo(f"geomag {__version__}")
        raise typer.Exit


@app.callback()
def _main(
    version: bool = typer.Option(False, "--version", callback=_version, is_eager=True, help="Show the version."),
) -> None:
    pass


from geomag.cli import demo, field, info, match, reproduce  # noqa: E402, F401 - each registers its command on `app`


def run(arguments: Sequence[str]) -> int:
    """Run one command and return the exit status."""
    try:
        result = typer.main.get_command(app).main(list(arguments), prog_name="geomag", standalone_mode=False)
    except click.exceptions.NoArgsIsHelpError as help_shown:
        sys.stderr.write(f"{help_shown.format_message()}\n")
        return BAD_INPUT
    except click.ClickException as error:
        sys.stderr.write(f"geomag: {error.format_message()}\n")
        return BAD_INPUT
    except (click.Abort, KeyboardInterrupt):
        sys.stderr.write("geomag: interrupted\n")
        return 130
    except GeomagError as error:
        sys.stderr.write("geomag: " + str(error).replace("\n", " ") + "\n")
        return BAD_INPUT
    return result if isinstance(result, int) else 0
