"""A flight along real survey lines that are not in the map: navigator, textbook filter and INS alone, with a picture.

With the Osborne survey in the folder that GEOMAG_DATA names (or given as an argument), over a part of it; otherwise over made-up lines.
Run: python examples/navigation.py [osborne_lines.csv.gz]
"""

import os
import sys
from pathlib import Path

import numpy as np

import geomag
from geomag import synthetic
from geomag.calibration import calibrate_navigation
from geomag.navigation_report import NavigationReport, fold_maps
from geomag.survey import Lines, read_lines

#: Part of the survey that is flown over: longitudes and latitudes, degrees.
PART = (140.50, 140.83, -21.97, -21.77)


def lines_of(arguments: list[str]) -> tuple[Lines, str]:
    """The real lines where they are at hand, every third sample (45 m)."""
    folder = os.environ.get("GEOMAG_DATA")
    path = Path(arguments[0]) if arguments else Path(folder or ".", "osborne-aeromag", "osborne_lines.csv.gz")
    if not path.exists():
        field = synthetic.Crust(height_m=150.0, longest_m=20_000.0, shortest_m=600.0).draw(
            (0, 0, 20_000, 14_000), seed=4
        )
        lines = synthetic.survey(field, line_spacing_m=350.0, sample_spacing_m=70.0, level_sigma=2.0, sigma=0.5)
        return lines, "made-up lines"
    lines = read_lines(path)
    inside = (lines.x > PART[0]) & (lines.x < PART[1]) & (lines.y > PART[2]) & (lines.y < PART[3])
    some = np.flatnonzero(inside)[::3]
    return Lines(
        lines.x[some], lines.y[some], lines.values[some], lines.line[some], lines.geographic
    ), "part of Osborne"


lines, name = lines_of(sys.argv[1:])
# Nearly all of the time: both maps learn their errors from lines left out again. They serve both reports.
maps = fold_maps(lines, folds=2, progress=True)
print(f"{name}: {lines.x.size} readings, two maps of every second line")
asked = {"maps": maps, "folds": 2, "hours": 0.75, "draws": 2, "flights": 1, "name": name}
reports = [
    calibrate_navigation(lines, method="navigator", **asked),
    calibrate_navigation(lines, method="ekf", reading_sigma=10.0, **asked),
]
print(NavigationReport.table(reports))
try:
    reports[0].plot("navigation.png")
except geomag.MissingDependencyError as missing:
    print(missing)
figures = reports[0].summary()
assert figures["drms_m"] < figures["unaided_drms_m"]
