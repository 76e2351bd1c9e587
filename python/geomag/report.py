"""One self-contained page about one match, or one flight: answer, pictures, figures, settings.

The page needs no network and no other file: it can be mailed, archived and printed.
"""

from __future__ import annotations

import base64
import html
import io
import math
from collections.abc import Callable, Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from geomag import plot
from geomag._explain import reasons, status_in_words
from geomag._optional import require
from geomag._versions import versions
from geomag.plot._match import true_offset

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from geomag._geomag import Fix, GridMap, Track
    from geomag._navigation import Navigation

__all__ = ["match_report", "navigation_page"]

_CSS = """
:root { color-scheme: light; --ink: #1b1f24; --soft: #5b6470; --line: #d9dee4; --good: #00694d; --bad: #a84300; }
* { box-sizing: border-box; }
body { margin: 0; font: 16px/1.5 system-ui, "Segoe UI", "DejaVu Sans", Arial, sans-serif; color: var(--ink);
  background: #fff; }
main { max-width: 1180px; margin: 0 auto; padding: 1.2rem clamp(0.8rem, 3vw, 2rem) 3rem; }
h1 { font-size: 1.5rem; margin: 0.2rem 0 0.4rem; }
h2 { font-size: 1.12rem; margin: 0 0 0.5rem; }
.answer { border-left: 6px solid var(--bad); padding: 0.5rem 1rem; background: #fdf4ee; margin: 0.8rem 0 1.4rem; }
.answer.ok { border-color: var(--good); background: #eef8f4; }
.answer p { margin: 0.15rem 0; }
.answer .status { font-weight: 700; }
.grid { display: grid; grid-template-columns: repeat(auto-fit, minmax(min(100%, 27rem), 1fr)); gap: 1.6rem; }
figure { margin: 0; } figure img { width: 100%; height: auto; display: block; }
figcaption { color: var(--soft); font-size: 0.9rem; margin-top: 0.3rem; }
section { min-width: 0; }
.wide { grid-column: 1 / -1; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; width: 100%; font-size: 0.92rem; }
th, td { text-align: left; padding: 0.28rem 0.7rem 0.28rem 0; border-bottom: 1px solid var(--line);
  vertical-align: top; }
td { font-variant-numeric: tabular-nums; overflow-wrap: anywhere; }
th { font-weight: 500; color: var(--soft); white-space: nowrap; }
code { font: 0.88rem/1.4 ui-monospace, "DejaVu Sans Mono", monospace; overflow-wrap: anywhere; white-space: pre-wrap; }
footer { color: var(--soft); font-size: 0.85rem; margin-top: 2rem; }
@media print { body { font-size: 11pt; } .grid { gap: 1rem; } section { break-inside: avoid; } }
""".strip()


def _picture(draw: Callable[[], Figure], caption: str, alternative: str) -> str:
    pyplot = require("matplotlib.pyplot", "plot", "reports")
    figure = draw()
    held = io.BytesIO()
    with plot.style():
        figure.savefig(held, format="png", dpi=170, metadata={"Software": None})
    pyplot.close(figure)
    data = base64.b64encode(held.getvalue()).decode("ascii")
    return (
        f'<figure><img alt="{html.escape(alternative)}" src="data:image/png;base64,{data}">'
        f"<figcaption>{html.escape(caption)}</figcaption></figure>"
    )


def _table(rows: Sequence[tuple[str, object]]) -> str:
    cells = "".join(
        f'<tr><th scope="row">{html.escape(name)}</th><td>{html.escape(str(value))}</td></tr>' for name, value in rows
    )
    return f'<div class="scroll"><table>{cells}</table></div>'


def _number(value: float | None, unit: str = "", digits: int = 6) -> str:
    if value is None or not math.isfinite(value):
        return "not given by this method"
    return f"{value:.{digits}g} {unit}".strip()


def _answer_rows(grid: GridMap, fix: Fix) -> list[tuple[str, object]]:
    unit = "degrees" if grid.geographic else "m"
    rows: list[tuple[str, object]] = [("status", f"{fix.status} (ok: {'yes' if fix.ok else 'no'})")]
    if np.isfinite(fix.offset_m).all():
        rows += [
            (
                "position (x, y)" if fix.ok else "best candidate, not to be used (x, y)",
                f"{fix.x:.10g}, {fix.y:.10g} {unit}",
            ),
            (
                "offset (true minus indicated)" if fix.ok else "best candidate, not to be used (true minus indicated)",
                f"{fix.offset_m[0]:.1f} m east, {fix.offset_m[1]:.1f} m north",
            ),
            ("heading correction", _number(fix.heading_deg, "degrees")),
            ("scale correction", _number(fix.scale)),
        ]
    rows += [
        ("bias of the readings", _number(fix.bias)),
        ("declared risk of being wrong", _number(fix.risk, digits=3)),
        ("goodness of fit (p-value)", _number(fix.goodness, digits=3)),
    ]
    if fix.covariance_m2 is not None:
        c = np.asarray(fix.covariance_m2)
        sigma = np.sqrt(np.clip(np.diag(c), 0, None))
        rows.append(("standard deviation", f"{sigma[0]:.1f} m east, {sigma[1]:.1f} m north"))
    else:
        rows.append(("standard deviation", "not given by this method"))
    rows += [
        ("score, runner-up", f"{_number(fix.score)}, {_number(fix.runner_up)}"),
        ("samples used", fix.n_samples),
        ("iterations", fix.iterations),
    ]
    return rows


def _input_rows(grid: GridMap, track: Track) -> list[tuple[str, object]]:
    values = np.asarray(grid.values)
    units = getattr(grid, "units", None) or "map units"
    kind = "longitude and latitude" if grid.geographic else "projected"
    unit = "degrees" if grid.geographic else "m"
    length = float(np.asarray(track.distance_m(geographic=grid.geographic))[-1])
    return [
        ("map", f"{getattr(grid, 'name', None) or 'field'}, {values.shape[1]} x {values.shape[0]} nodes, {kind}"),
        ("map spacing", f"{grid.x[1] - grid.x[0]:.6g} x {grid.y[1] - grid.y[0]:.6g} {unit}"),
        ("map extent", f"x {grid.x[0]:.8g} to {grid.x[-1]:.8g}, y {grid.y[0]:.8g} to {grid.y[-1]:.8g} {unit}"),
        ("map values", f"{np.nanmin(values):.6g} to {np.nanmax(values):.6g} {units}, "
                       f"{int(np.isnan(values).sum())} holes"),
        ("track", f"{len(track)} samples over {length / 1000:.3g} km"),
        ("readings", f"{np.min(track.values):.6g} to {np.max(track.values):.6g} {units}"),
    ]  # fmt: skip


def match_report(
    path: str | PathLike[str],
    grid: GridMap,
    track: Track,
    fix: Fix,
    *,
    truth: object | None = None,
    steps: Sequence[plot.Frame] | None = None,
    surface_fix: Fix | None = None,
    surface_label: str = "score",
    least_is_best: bool = True,
    settings: Mapping[str, Any] | None = None,
    command: str | None = None,
    title: str = "Match of a track on a field map",
) -> Path:
    """Write one self-contained HTML page about one match.

    Parameters
    ----------
    path : of the page, ending in .html.
    grid, track, fix : map, indicated track with its readings, answer.
    truth : the true track, where it is known.
    steps : what the matcher believed after each sample.
    surface_fix : a fix that carries the score surface, where `fix` itself does not.
    surface_label, least_is_best : of the score.
    settings : what the run was told.
    command : the command line that made it, where there was one.
    title : of the page.
    """
    with_surface = surface_fix or fix
    offset = true_offset(grid, track, truth)
    latitude = float(track.y[-1]) if grid.geographic else 0.0
    sections: list[str] = []

    def add(heading: str, body: str, *, wide: bool = False) -> None:
        sections.append(_section(heading, body, wide=wide))

    def root(ax: Axes) -> Figure:
        return cast("Figure", ax.figure)

    picture = _picture(
        lambda: root(plot.match_map(grid, track, fix, truth=truth)),
        "Indicated and corrected track on the map; the larger marks are the newest points.",
        "Map of the field with the indicated and the matched track",
    )
    add("Where", picture)
    add("Answer", _table(_answer_rows(grid, fix)))
    if with_surface.surface is not None:
        picture = _picture(
            lambda: root(
                plot.score_surface(
                    with_surface,
                    geographic=grid.geographic,
                    latitude_deg=latitude,
                    true_offset=offset,
                    label=surface_label,
                    least_is_best=least_is_best,
                )
            ),
            "Score of every offset that was searched; dark is good. One narrow dark place is a sound fix; several, or "
            "a long valley, are a reason for doubt.",
            "Score over the offsets searched",
        )
        add("How the candidates compare", picture)
    picture = _picture(
        lambda: root(plot.residuals(grid, track, fix)),
        "What the sensor read, and what the map says along the indicated and along the corrected track.",
        "Readings and map values along the track",
    )
    add("Do the readings fit", picture)
    if steps:
        frames = list(steps)
        picture = _picture(
            lambda: plot.frames(frames, true_offset=offset, geographic=grid.geographic, latitude_deg=latitude),
            "What was still possible after so many samples.",
            "Feasible offsets or posterior, sample by sample",
        )
        add("How it was narrowed down", picture, wide=True)
    add("Input", _table(_input_rows(grid, track)))
    told = [(str(k), v) for k, v in (settings or {}).items()]
    if told or command:
        body = (f"<p><code>{html.escape(command)}</code></p>" if command else "") + (_table(told) if told else "")
        add("Settings", body)
    words = html.escape(status_in_words(fix))
    # Without a fix nobody is told where to move.
    moved = "".join(f"<p>{html.escape(reason[:1].upper() + reason[1:])}</p>" for reason in reasons(grid, track, fix))
    if fix.ok:
        east, north = fix.offset_m
        moved = (
            f"<p>The indicated position is to be moved by {abs(east):.0f} m {'east' if east >= 0 else 'west'} and "
            f"{abs(north):.0f} m {'north' if north >= 0 else 'south'}, from {fix.n_samples} samples.</p>"
        )
    footer = "Offsets are true minus indicated position; x to the east, y to the north. Made by geomag."
    return _write(path, title, words + "</p>" + moved, fix.ok, sections, footer)


def _section(heading: str, body: str, *, wide: bool = False) -> str:
    return f"<section{' class=wide' if wide else ''}><h2>{html.escape(heading)}</h2>{body}</section>"


def _write(path: str | PathLike[str], title: str, answer: str, good: bool, sections: list[str], footer: str) -> Path:
    """Write a page: answer first, then the sections, then versions."""
    listed = ", ".join(f"{name} {version}" for name, version in versions().items() if version)
    shown = [*sections, _section("Versions", f"<p><code>{html.escape(listed)}</code></p>")]
    page = (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{html.escape(title)}</title><style>{_CSS}</style></head><body><main>"
        f"<h1>{html.escape(title)}</h1>"
        f'<div class="answer{" ok" if good else ""}"><p class="status">{answer}</div>'
        f'<div class="grid">{"".join(shown)}</div>'
        f"<footer>{footer}</footer>"
        "</main></body></html>\n"
    )
    target = Path(path)
    target.parent.mkdir(parents=True, exist_ok=True)
    target.write_text(page, encoding="utf-8")
    return target


_FLIGHT_WORDS = {
    "tracking": "Tracking: position and bound may be used.",
    "coasting": "Coasting: no reading for a while; position and bound may be used, the bound grows.",
    "acquiring": "Acquiring: the start is not known well enough yet; the bound says how far it may be out.",
    "lost": "Lost: only the bound is to be believed.",
}


def navigation_page(
    path: str | PathLike[str],
    grid: GridMap,
    flight: Navigation,
    indicated: tuple[np.ndarray[Any, Any], np.ndarray[Any, Any]],
    readings: np.ndarray[Any, Any],
    *,
    truth: tuple[np.ndarray[Any, Any], np.ndarray[Any, Any]] | None = None,
    settings: Mapping[str, Any] | None = None,
    title: str = "Flight over a field map",
) -> Path:
    """Write one self-contained HTML page about one navigated flight.

    Parameters
    ----------
    path : of the page, ending in .html.
    grid, flight : map, and what `navigate` answered.
    indicated, readings : x and y of the INS, and the readings (NaN where there was none), shape (n,) each.
    truth : true x and y, where they are known.
    settings : what the run was told.
    title : of the page.
    """
    from geomag.plot._navigation import words

    picture = _picture(
        lambda: plot.navigation_figure(grid, flight, indicated, readings, truth=truth),
        "Left: indicated and corrected track on the map. Right: readings and map along the corrected track; bounds over time, shaded where "
        "the navigator does not track.",
        "Map with the tracks, readings and bounds of the flight",
    )
    names = {
        "share_tracking": "tracking, share of the time", "share_coasting": "coasting", "share_acquiring": "acquiring", "share_lost": "lost",
        "protection_level_m": "protection level, median", "declared_rms_m": "declared rms error", "drms_m": "rms error", "median_m": "median error", "p95_m": "95 % of the errors below",
        "max_m": "largest error", "nees": "squared error over variance (2 is right)", "within_99": "within the 99 % radius", "within_declared": "within 1.4 of it",
        "beyond_protection": "beyond the protection level",
    }  # fmt: skip
    figures = [
        (
            names.get(key, key),
            f"{value:.0f} m" if key.endswith("_m") else f"{value:.3g}" if key == "nees" else f"{100 * value:.1f} %",
        )
        for key, value in flight.summary(truth).items()
    ]
    where = "degrees" if grid.geographic else "m"
    last = [
        ("position (x, y)", f"{flight.x[-1]:.10g}, {flight.y[-1]:.10g} {where}"),
        ("standard deviation", "{:.0f} m east, {:.0f} m north".format(*np.sqrt(np.diag(flight.covariance_m2[-1])))),
        ("protection level", f"{flight.protection_level_m[-1]:.0f} m"),
        ("velocity error of the INS", "{:.2f} m/s east, {:.2f} m/s north".format(*flight.velocity_error_m_s[-1])),
        ("heading error of the INS", f"{flight.heading_error_deg[-1]:.3f} degrees"),
        ("bias of the sensor", f"{flight.bias[-1]:.1f} {grid.units or ''}".strip()),
        ("output of the INS", flight.inputs),
    ]
    changes = np.flatnonzero(np.concatenate([[True], flight.status[1:] != flight.status[:-1]]))
    log = [
        (f"{(flight.time_s[k] - flight.time_s[0]) / 60:.1f} min", f"{flight.status[k]}: {flight.reason[k]}")
        for k in changes[:60]
    ]
    sections = [
        _section("Flight", picture, wide=True),
        _section("Figures", _table(figures)),
        _section("At the end", _table(last)),
        _section("What happened", _table(log)),
    ]
    if settings:
        sections.append(_section("Settings", _table([(str(k), v) for k, v in settings.items()])))
    answer = f"{html.escape(_FLIGHT_WORDS.get(str(flight.status[-1]), str(flight.status[-1])))}</p><p>{html.escape(words(flight))}.</p>"
    footer = "The first ten minutes are not in the figures. x to the east, y to the north. Made by geomag."
    return _write(path, title, answer, flight.status[-1] in ("tracking", "coasting"), sections, footer)
