"""Why there is no fix, in words that somebody can act on."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from geomag._geomag import Fix, GridMap, Track

#: What a status means; what is known beyond it comes after.
STATUS = {
    "fixed": "A fix: the position may be used.",
    "searching": "No fix: more samples are needed to tell the candidates apart.",
    "ambiguous": "No fix: two places, or more, fit about as well.",
    "at_edge": "No fix: the best candidate lies on the border of the search; the truth may lie beyond it.",
    "lost": "No fix: no candidate agrees with the readings.",
    "uninformative": "No fix: the field along the track is too flat, or too little of it is known.",
    "not_converged": "No fix: the iteration ended before it settled.",
    "rejected": "No fix: a test on the answer refused it.",
}
#: Readings whose middle lies so many spreads of the map away from it are of another quantity, or still hold the main field.
ANOTHER_LEVEL = 20.0


def status_in_words(fix: Fix) -> str:
    """One sentence on a status."""
    return STATUS.get(fix.status, fix.status)


def reasons(grid: GridMap, track: Track, fix: Fix) -> list[str]:
    """What map, track and answer show of why there is no fix: none for a fix, most likely reason first.

    Each is a sentence about something that was measured on this map and track; what cannot be seen is not guessed at.
    """
    if fix.ok:
        return []
    found = []
    on_map = float(np.mean(np.isfinite(grid.sample(track.x, track.y))))
    x, y = grid.x, grid.y
    unit, shown = ("degrees", ".6g") if grid.geographic else ("m", ".0f" if min(grid.spacing) >= 1.0 else ".3f")
    if on_map < 0.5:
        found.append(
            f"{on_map:.0%} of the indicated track lies on known parts of the map: the track covers "
            f"x {np.min(track.x):{shown}} to {np.max(track.x):{shown}}, y {np.min(track.y):{shown}} to {np.max(track.y):{shown}}, "
            f"the map x {x[0]:{shown}} to {x[-1]:{shown}}, y {y[0]:{shown}} to {y[-1]:{shown}} {unit}."
        )
    known = np.asarray(grid.values, dtype=float)
    known = known[np.isfinite(known)]
    middle, spread = float(np.median(known)), float(np.std(known))
    apart = float(np.median(track.values)) - middle
    if spread > 0 and abs(apart) > ANOTHER_LEVEL * spread:
        found.append(
            f"the readings are about {np.median(track.values):.6g}, the map about {middle:.4g}: they are of another quantity, or the "
            "main field has not been taken out of them."
        )
    misfit = getattr(fix, "misfit", None)
    if misfit is not None:
        name, estimate, gained = misfit
        found.append(
            f"the readings ask for something that was not told: {name}, about {estimate:.4g} (log evidence gained {gained:.1f})."
        )
    if fix.status in ("uninformative", "ambiguous") and on_map >= 0.5:
        along = grid.sample(track.x, track.y)
        swing = float(np.nanstd(along))
        found.append(
            f"along the indicated track the map varies by {swing:.3g} (one standard deviation): a longer track, or one across the "
            "field's features, tells more."
        )
    if fix.status == "rejected" and fix.goodness is not None and misfit is None:
        found.append(
            f"the readings fit the map nowhere as well as their stated errors allow (p = {fix.goodness:.2g}): another quantity, height "
            "or time, or larger errors than were stated."
        )
    if fix.status == "at_edge":
        found.append("widen the search if the INS may be further off.")
    return found
