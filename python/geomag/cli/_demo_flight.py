"""The flight that the demo ends with: half an hour over the map that it matched on, with an outage."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from geomag._geomag import GridMap, InsModel
from geomag._navigation import navigate

#: Legs to and fro within the map: their ends in shares of its width and height.
_LEGS = ((0.15, 0.15), (0.85, 0.25), (0.85, 0.4), (0.15, 0.5), (0.15, 0.65), (0.85, 0.8))
SPEED_M_S, STEP_S = 70.0, 1.5
#: Without readings from here to there, shares of the flight.
SILENT = (0.5, 0.58)


def fly(grid: GridMap, seed: int, out: Path) -> tuple[dict[str, float], str]:
    """Fly the legs with an INS of navigation grade, navigate, draw; figures of the flight, and what to say of it."""
    from geomag.plot import navigation_figure, save
    from geomag.plot._navigation import words
    from geomag.synthetic import draw_inertial_error, indicate

    low = np.array([grid.x[0], grid.y[0]])
    size = np.array([grid.x[-1], grid.y[-1]]) - low
    corners = low + np.array(_LEGS) * size
    scale = np.array(grid.metres_per_unit(float(corners[:, 1].mean())))
    way = np.concatenate([[0.0], np.cumsum(np.hypot(*(np.diff(corners, axis=0) * scale).T))])
    time = np.arange(0.0, way[-1] / SPEED_M_S, STEP_S)
    x, y = (np.interp(SPEED_M_S * time, way, c) for c in corners.T)
    rng = np.random.default_rng([seed, 1])
    ins = InsModel.navigation()
    start = draw_inertial_error(ins, rng, 200.0)
    shown = indicate(time, x, y, geographic=grid.geographic, error=start, ins=ins, seed=rng)
    readings = grid.sample(x, y, interpolation="bicubic") + rng.normal(0, 1.0, time.size) + rng.normal(0, 20.0)
    spoilt = rng.random(time.size) < 0.02
    readings[spoilt] += rng.normal(0, 60.0, int(spoilt.sum()))
    readings[int(SILENT[0] * time.size) : int(SILENT[1] * time.size)] = np.nan
    # The map is read between its nodes by another rule than the filter's, which is its error here.
    known = GridMap(
        np.asarray(grid.values), grid.x, grid.y, geographic=grid.geographic, sigma=1.0, name=grid.name, units=grid.units
    )
    flight = navigate(
        known, time, shown.x, shown.y, velocity_m_s=shown.velocity_m_s, heading_deg=shown.heading_deg, readings=readings, ins=ins,
        position_sigma_m=200.0,
    )  # fmt: skip
    figures = flight.summary((x, y))
    alone = np.hypot((shown.x - x) * scale[0], (shown.y - y) * scale[1])
    figures["unaided_m"] = float(alone[-1])
    save(navigation_figure(known, flight, (shown.x, shown.y), readings, truth=(x, y)), out)
    said = f"{words(flight)}; error {figures['drms_m']:.0f} m rms after the first ten minutes, the INS alone ends {alone[-1]:.0f} m off"
    return figures, said
