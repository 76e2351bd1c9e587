"""Settings from a TOML file, and the record of a run."""

from __future__ import annotations

import shlex
import tomllib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeAlias

from geomag._errors import InvalidInputError, MissingFileError, ReadError
from geomag._versions import write_record

#: A command of click, or of the copy that recent versions of typer carry.
Command: TypeAlias = Any


def read_settings(path: Path, group: Command) -> dict[str, Any]:
    """Defaults for the commands from a TOML file; unknown tables and options are refused by name."""
    if not path.exists():
        raise MissingFileError(f"settings file {path}: not found")
    try:
        told = tomllib.loads(path.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ReadError(f"settings file {path}: needed TOML, got {error}") from error
    return _checked(told, group, str(path), "")


def _checked(told: dict[str, Any], command: Command, path: str, table: str) -> dict[str, Any]:
    commands: dict[str, Any] = getattr(command, "commands", {})
    options = {p.name or "": p for p in command.params if table}
    out: dict[str, Any] = {}
    for key, value in told.items():
        name = key.replace("-", "_")
        if key in commands and isinstance(value, dict):
            out[key] = _checked(value, commands[key], path, f"{table}.{key}" if table else key)
        elif name in options or f"{name}_" in options:
            out[name if name in options else f"{name}_"] = value
        else:
            known = ", ".join([*commands, *(n.rstrip("_").replace("_", "-") for n in options)])
            where = f"[{table}]" if table else "at the top"
            raise InvalidInputError(f"settings file {path}, {where}: needed one of {known}, got '{key}'")
    return out


def again(context: Any, resolved: dict[str, object]) -> tuple[dict[str, object], str]:  # noqa: ANN401 - click's, or typer's own
    """Every setting of the command that runs, and a command line that does the same again.

    `resolved` has what the command chose itself where nothing was said, by the name of the parameter.
    """
    settings: dict[str, object] = {}
    words = ["geomag", context.command.name]
    for parameter in context.command.params:
        name = parameter.name
        value = resolved.get(name, context.params.get(name))
        if parameter.param_type_name == "argument":
            settings[name] = value
            words.append(str(value))
            continue
        option = parameter.opts[0]
        settings[option.lstrip("-")] = value
        if value is None or value == parameter.get_default(context):
            continue
        if isinstance(value, bool):
            words.append(option if value else (parameter.secondary_opts or [option])[0])
        else:
            words += [option, str(getattr(value, "value", value))]
    return {k: getattr(v, "value", v) for k, v in settings.items() if v is not None}, shlex.join(words)


def _walk(command: Command) -> Iterator[Command]:
    yield command
    for inner in getattr(command, "commands", {}).values():
        yield from _walk(inner)


def options_of(command: Command) -> set[str]:
    """Every option that a command or one of its own has."""
    return {option for each in _walk(command) for parameter in each.params for option in parameter.opts}


@contextmanager
def recorded(command: Command, arguments: Sequence[str]) -> Iterator[Command]:
    """The command, which after its run leaves a record where `--record` asked for one."""
    seen: list[tuple[Command, dict[str, Any]]] = []
    for each in _walk(command):
        _note(each, seen)
    yield command
    target = next((p["record"] for c, p in seen if c is command), None)
    if target is not None:
        settings = {c.name or "": p for c, p in seen if c is not command}
        write_record(target, settings, command=shlex.join(["geomag", *arguments]))


def _note(command: Command, seen: list[tuple[Command, dict[str, Any]]]) -> None:
    """Have a command note its resolved options when it runs."""
    invoke = command.invoke

    def noting(context: Any) -> object:  # noqa: ANN401 - click's, or typer's own
        seen.append((command, dict(context.params)))
        return invoke(context)

    command.invoke = noting
