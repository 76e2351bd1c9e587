"""The published experiments, rerun: published figure beside ours, with a picture where the paper has one.

`geomag reproduce E1 E2 --data DIR --out DIR` from the command line, `run` from Python. Each experiment is a module
with `run(context) -> Report`.
"""

from __future__ import annotations

import importlib
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from geomag._errors import InvalidInputError, MissingFileError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

EXPERIMENTS = {
    "E1": "IEMA: a single feasible solution on the true track",
    "E2": "IEMA: how many samples it needs",
    "E3": "IEMA against MSD",
    "E4": "ICCP on delta-modulation sequences, rough region",
    "E5": "ICCP on delta-modulation sequences, flat region",
    "E6": "Sliding-window ICCP for gravity",
    "E7": "Ship navigation on a harmonic field",
    "E8": "Real surveys: calibration report",
}


@dataclass(frozen=True)
class Table:
    """One table of a report."""

    title: str
    columns: Sequence[str]
    rows: Sequence[Sequence[object]]

    def markdown(self) -> str:
        """The table in Markdown."""
        lines = [f"**{self.title}**", "", "| " + " | ".join(self.columns) + " |", "|" + "---|" * len(self.columns)]
        lines += ["| " + " | ".join(_cell(c) for c in row) + " |" for row in self.rows]
        return "\n".join(lines) + "\n"


def _cell(value: object) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)


@dataclass
class Report:
    """What an experiment found."""

    key: str
    settings: dict[str, object]
    tables: list[Table] = field(default_factory=list)
    pictures: list[Path] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def markdown(self) -> str:
        """The report in Markdown, pictures linked by name."""
        lines = [f"## {self.key} {EXPERIMENTS[self.key]}", ""]
        lines += ["Settings: " + "; ".join(f"{k} {v}" for k, v in self.settings.items()) + ".", ""]
        for table in self.tables:
            lines += [table.markdown()]
        lines += [f"![{p.stem}]({p.name})\n" for p in self.pictures]
        lines += [f"{note}\n" for note in self.notes]
        return "\n".join(lines)


@dataclass(frozen=True)
class Context:
    """What an experiment is given: data and output folders, seed, and the share of the full number of trials."""

    data: Path
    out: Path
    seed: int = 2012
    effort: float = 1.0
    say: Callable[[str], None] = print

    def file(self, relative: str) -> Path:
        """A file of the data folder.

        Raises
        ------
        MissingFileError
            Where it is not there.
        """
        path = self.data / relative
        if not path.exists():
            raise MissingFileError(f"experiment data: needed {relative} in the data folder, got nothing at {path}")
        return path

    def trials(self, full: int, least: int = 20) -> int:
        """Number of trials at this effort."""
        return max(least, round(full * self.effort))

    def save(self, figure: Figure, name: str) -> Path:
        """Write a picture into the output folder and close it."""
        from matplotlib import pyplot

        from geomag.plot import save

        path = save(figure, self.out / f"{name}.png")
        pyplot.close(figure)
        return path


def run(
    keys: Sequence[str],
    *,
    data: str | Path,
    out: str | Path,
    seed: int = 2012,
    effort: float = 1.0,
    say: Callable[[str], None] = print,
) -> list[Report]:
    """Rerun experiments and write `report.md`, `report.json` and the pictures into `out`.

    Parameters
    ----------
    keys : names from `EXPERIMENTS`; all of them where empty.
    data : the folder of surveys and fields.
    effort : share of the full number of trials; 1 for the figures of the documentation, less for a quick look.
    """
    chosen = [k.upper() for k in keys] or list(EXPERIMENTS)
    for key in chosen:
        if key not in EXPERIMENTS:
            raise InvalidInputError(f"experiment: needed one of {', '.join(EXPERIMENTS)}, got '{key}'")
    context = Context(Path(data), Path(out), seed, effort, say)
    context.out.mkdir(parents=True, exist_ok=True)
    reports = []
    for key in chosen:
        say(f"{key}: {EXPERIMENTS[key]}")
        reports.append(importlib.import_module(f"geomag.reproduce.{key.lower()}").run(context))
    title = "# Published experiments, reproduced\n\n"
    (context.out / "report.md").write_text(title + "\n".join(r.markdown() for r in reports), encoding="utf-8")
    plain = [
        {
            "key": r.key,
            "settings": {k: str(v) for k, v in r.settings.items()},
            "tables": [
                {"title": t.title, "columns": list(t.columns), "rows": [list(x) for x in t.rows]} for t in r.tables
            ],
            "pictures": [p.name for p in r.pictures],
            "notes": r.notes,
        }
        for r in reports
    ]
    (context.out / "report.json").write_text(json.dumps(plain, indent=1, default=float), encoding="utf-8")
    return reports
