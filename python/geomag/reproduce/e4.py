"""E4: ICCP on delta-modulation sequences, rough region (the Volga) [DM-ICCP 2.2, 3.1, 3.2]."""

from __future__ import annotations

from geomag.reproduce import Context, Report, Table
from geomag.reproduce._iccp import Region
from geomag.reproduce._iccp import run as run_region

REGION = Region(
    key="E4",
    file="emm2017_volga_45_47E_54p8_56p8N_h0.nc",
    quantum=15.0,
    length=22,
    quanta=tuple(float(q) for q in range(1, 16)),
    max_length=31,
    noise_variance=5.0,
    published=Table(
        "Published, one track each",
        ("path", "noise variance", "sequence", "points", "error m", "s per iteration (MATLAB)"),
        [
            ["one", 0, "equal spacing, same number", 22, 665.30, 1.64],
            ["one", 0, "delta modulation", 22, 267.97, 1.87],
            ["one", 0, "equal spacing, same distance", "more", "similar or worse", 27.21],
            ["three", 5, "delta modulation", "-", 381.51, "-"],
            ["three", 5, "equal spacing, same number", "-", 465.99, "-"],
            ["three", 5, "equal spacing, same distance", "-", 566.83, "-"],
        ],
    ),
)


def run(context: Context) -> Report:
    """Reproduce E4."""
    return run_region(context, REGION)
