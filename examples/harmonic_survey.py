"""A harmonic model of aeromagnetic lines at their own heights, beside the gridded map of the same lines.

Whole lines are left out of both. With the Osborne survey in the folder that GEOMAG_DATA names (or given as an argument),
over blocks of three sizes; otherwise on made-up lines. Run: python examples/harmonic_survey.py [osborne_lines.csv.gz]
"""

import os
import sys
from pathlib import Path

import numpy as np

from geomag import synthetic
from geomag.harmonic_survey import Comparison, compare_with_map
from geomag.survey import Lines

#: Middle (longitude, latitude) and side (km). The prior was chosen on other blocks: see TUNED.
BLOCKS = [
    (140.70, -21.90, 4), (140.64, -22.08, 6), (140.78, -21.95, 5), (140.60, -21.80, 5), (140.54, -22.05, 5),
    (140.68, -22.02, 5), (140.62, -21.87, 6), (140.76, -22.10, 6), (140.53, -21.93, 4), (140.66, -22.13, 4),
    (140.79, -21.86, 4), (140.70, -22.06, 8), (140.58, -22.02, 8),
]  # fmt: skip
#: Blocks on which power, depth, ridge and anisotropy were looked for.
TUNED = [(140.66, -21.95, 5), (140.55, -21.85, 4), (140.75, -22.00, 4), (140.58, -21.95, 6), (140.72, -21.82, 6)]
#: North, east, down, nT (IGRF 1990).
MAIN_FIELD = (31_300.0, 3_400.0, -40_800.0)
#: The strike of the region is north to south.
ANISOTROPY = 1.15


def compare_block(table: Path, longitude: float, latitude: float, side_km: float) -> Comparison:
    """Compare on the lines of a block, every second sample (about 30 m)."""
    import pandas as pd

    rows = pd.read_csv(table)
    near = (abs(rows.latitude - latitude) < 0.5 * side_km / 110.7) & (
        abs(rows.longitude - longitude) < 0.5 * side_km / (111.3 * np.cos(np.radians(latitude)))
    )
    rows = rows[near].groupby("line").filter(lambda one: len(one) >= 40)
    rows = rows.groupby("line", group_keys=False).nth(slice(None, None, 2))
    lines = Lines(rows.longitude, rows.latitude, rows.total_field_anomaly_nt, rows.line, geographic=True)
    return compare_with_map(lines, rows.height_m, MAIN_FIELD, anisotropy=ANISOTROPY)


def main() -> None:
    """Print one line a block and what they come to."""
    given = (
        Path(sys.argv[1])
        if len(sys.argv) > 1
        else Path(os.environ.get("GEOMAG_DATA", "")) / "osborne-aeromag" / "osborne_lines.csv.gz"
    )
    if not given.is_file():
        field = synthetic.Crust(texture_rms=60.0, height_m=150.0).draw((0, 0, 4000, 4000), seed=3)
        x, y = (a.ravel() for a in np.meshgrid(np.arange(200.0, 3801.0, 40.0), np.arange(200.0, 3801.0, 200.0)))
        print("made-up lines:", compare_with_map(Lines(x, y, field.sample(x, y), y), 150.0, MAIN_FIELD))
        return
    for name, blocks in (("chosen on", TUNED), ("not seen", BLOCKS)):
        found = []
        for block in blocks:
            found.append(compare_block(given, *block))
            print(name, block, found[-1], flush=True)
        ratios = np.array([c.model_rms / c.grid_rms for c in found])
        normalised = np.mean([c.normalised for c in found])
        print(f"{name}: rms over the map's, geometric mean {np.exp(np.log(ratios).mean()):.3f}, {ratios.min():.2f} to "
              f"{ratios.max():.2f}; squared errors over variances {normalised:.2f}")  # fmt: skip


if __name__ == "__main__":
    main()
