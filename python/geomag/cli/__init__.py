"""The command line. Exit status: 0 fixed (or done), 1 bad input (one line on standard error), 3 no usable fix."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from geomag._errors import DataWarning, GeomagError
from geomag._optional import require

require("typer", "cli", "the geomag command")

import typer  # noqa: E402 - after the check that it is there

from geomag.cli._checks import in_options, output  # noqa: E402

NO_FIX = 3
BAD_INPUT = 1
INTERRUPTED = 130

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


def _versions(asked: bool) -> None:
    if asked:
        from geomag._versions import show_versions

        show_versions()
        raise typer.Exit


@app.callback()
def _main(
    context: typer.Context,
    version: bool = typer.Option(False, "--version", callback=_version, is_eager=True, help="Show the version."),
    versions: bool = typer.Option(
        False, "--versions", callback=_versions, is_eager=True, help="Show the versions of everything in use."
    ),
    settings: Path | None = typer.Option(
        None, help="TOML file with options: a table for each command, such as [match]. The command line wins."
    ),
    record: Path | None = typer.Option(
        None, callback=output, help="Write what was run, its settings and versions, to this JSON file."
    ),
) -> None:
    if settings is not None:
        from geomag.cli._settings import read_settings

        context.default_map = read_settings(settings, context.command)


# Each registers its command on `app`.
from geomag.cli import (  # noqa: E402
    bench,  # noqa: F401
    calibrate,  # noqa: F401
    dafmit,  # noqa: F401
    demo,  # noqa: F401
    field,  # noqa: F401
    flights,  # noqa: F401
    info,  # noqa: F401
    map,  # noqa: F401
    match,  # noqa: F401
    navigate,  # noqa: F401
    reduce,  # noqa: F401
    reproduce,  # noqa: F401
    stream,  # noqa: F401
    stress,  # noqa: F401
    suitability,  # noqa: F401
)


def run(arguments: Sequence[str]) -> int:
    """Run one command and return the exit status; what readers tell goes to standard error, a line each."""
    with warnings.catch_warnings():
        warnings.simplefilter("always", DataWarning)
        plain = warnings.showwarning

        def show(message: Warning | str, category: type[Warning], *where: Any, **more: Any) -> None:  # noqa: ANN401 - as warnings has it
            if issubclass(category, DataWarning):
                sys.stderr.write(f"geomag: {_here(message)}\n")
            else:
                plain(message, category, *where, **more)

        warnings.showwarning = show
        return _run(arguments)


def _here(message: Warning | Exception | str) -> str:
    """What the library says, in the words of the command line."""
    from geomag.cli._settings import options_of

    return in_options(str(message), options_of(typer.main.get_command(app)))


def _run(arguments: Sequence[str]) -> int:
    try:
        from geomag.cli._settings import recorded

        with recorded(typer.main.get_command(app), arguments) as command:
            result = command.main(list(arguments), prog_name="geomag", standalone_mode=False)
    except (typer.Abort, KeyboardInterrupt):
        sys.stderr.write("geomag: interrupted\n")
        return INTERRUPTED
    except GeomagError as error:
        sys.stderr.write(f"geomag: {_here(error)}\n")
        return BAD_INPUT
    except (OSError, OverflowError, MemoryError) as error:
        # A full disk, a number beyond what the core counts with.
        sys.stderr.write("geomag: " + (str(error) or type(error).__name__).replace("\n", " ") + "\n")
        return BAD_INPUT
    except Exception as error:
        # Usage errors are click's, but recent versions of typer carry a click of their own: known by what they can do.
        message = getattr(error, "format_message", None)
        if message is None:
            raise
        prefix = "" if type(error).__name__ == "NoArgsIsHelpError" else "geomag: "
        sys.stderr.write(f"{prefix}{message()}\n")
        return BAD_INPUT
    if result == INTERRUPTED:  # what typer makes of Ctrl-C within a command, without a word
        sys.stderr.write("geomag: interrupted\n")
    return result if isinstance(result, int) else 0
