"""E5: ICCP on delta-modulation sequences, flat region (the Mediterranean) [DM-ICCP 3.3]."""

from __future__ import annotations

from geomag.reproduce import Context, Report, Table
from geomag.reproduce._iccp import Region
from geomag.reproduce._iccp import run as run_region

REGION = Region(
    key="E5",
    file="emm2017_mediterranean_15_17E_33p8_35p8N_h0.nc",
    quantum=7.0,
    length=7,
    quanta=tuple(float(q) for q in range(1, 9)),
    max_length=10,
    noise_variance=0.5,
    published=Table(
        "Published, one track each",
        ("path", "noise variance", "sequence", "points", "error m", "s per iteration (MATLAB)"),
        [
            ["one", 0, "equal spacing, same number", 7, 784.53, "-"],
            ["one", 0, "equal spacing, same distance", "more", 161.65, 17.27],
            ["one", 0, "delta modulation", 7, 159.92, 0.50],
            ["both", 0.5, "delta modulation", 7, "still corrects", 0.50],
        ],
    ),
)


def run(context: Context) -> Report:
    """Reproduce E5."""
    return run_region(context, REGION)
