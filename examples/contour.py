"""Contour matching: ICCP to the letter beside the recommended pipeline, on a field of our own.

Run: python examples/contour.py
"""

import numpy as np

import geomag

rng = np.random.default_rng(4)
axis = 250.0 * np.arange(320)
field = (
    150 * np.sin(axis / 5200)[None, :] * np.cos(axis / 6100)[:, None]
    + 80 * np.cos((axis[None, :] + 2 * axis[:, None]) / 9000)
    + 30 * np.sin((2 * axis[None, :] - axis[:, None]) / 4300)
)
grid = geomag.GridMap(field, axis, axis, units="nT")

# 22 points, 840 m apart; the INS is 790 m off at the newest point and half a degree off in heading.
steps = -840.0 * np.arange(21, -1, -1)
newest = np.array([52_000.0, 47_000.0])
course = np.radians(40.0)
truth = newest + steps[:, None] * [np.sin(course), np.cos(course)]
wrong = course - np.radians(0.5)
indicated = newest - [560.0, -557.0] + steps[:, None] * [np.sin(wrong), np.cos(wrong)]
sigma = 2.2
readings = grid.sample(truth[:, 0], truth[:, 1], interpolation="bicubic") + sigma * rng.normal(size=22)
track = geomag.Track(indicated[:, 0], indicated[:, 1], readings)

letter = geomag.match_contour(grid, track, radius_m=2400.0)
held = geomag.match_contour(grid, track, radius_m=2400.0, sigma=sigma, offset_sigma_m=560.0, heading_sigma_deg=0.5)
best = geomag.match_contour(
    grid,
    track,
    starts="grid",
    refine=True,
    sigma=sigma,
    offset_sigma_m=560.0,
    heading_sigma_deg=0.5,
    tolerance_m=500.0,
)
print(f"INS alone                         {np.hypot(*(indicated[-1] - truth[-1])):6.0f} m off")
for name, fix in (
    ("ICCP to the letter", letter),
    ("ICCP held by the INS's accuracy", held),
    ("lattice + Gauss-Newton", best),
):
    error = np.hypot(fix.x - newest[0], fix.y - newest[1])
    print(
        f"{name:33} {error:6.0f} m off, heading {fix.heading_deg:+.2f} deg, {fix.status}, {fix.iterations} iterations"
    )
print(best)
assert best.ok
assert np.hypot(best.x - newest[0], best.y - newest[1]) < 300

# The same as a stream: a fix a sample once the window is full, and a better one for the sample that leaves it.
window = geomag.SlidingContour(
    grid, length=16, starts="grid", refine=True, sigma=sigma, offset_sigma_m=560.0, heading_sigma_deg=0.5
)
for (x, y), value in zip(indicated, readings, strict=True):
    fix = window.update(x, y, value)
point = window.settled
away = np.hypot(point["x"] - truth[point["number"], 0], point["y"] - truth[point["number"], 1])
print(f"sliding window: sample {point['number']}, averaged over {point['estimates']} windows, {away:.0f} m off")
