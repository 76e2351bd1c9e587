"""Does a declared risk hold? Calibration reports, and where on a map one can fix at all.

`calibrate_lines` takes survey lines, makes a map of two thirds of them with everything that `map_from_lines` learns from those alone,
and matches the third that the map has never seen; `calibrate_simulated` flies over a map that is right. Both return a
`Calibration`: declared risk in bins against the observed share of wrong answers with its binomial interval, fix rate, errors,
normalised error squared. `suitability` looks ahead: over the map and by heading, the expected position error and the
probability of a fix.
"""

from __future__ import annotations

from geomag.calibration._answers import RISK_BINS, Calibration, one_sided_limit
from geomag.calibration._assess import assess
from geomag.calibration._lines import calibrate_lines
from geomag.calibration._simulated import calibrate_simulated
from geomag.calibration._suitability import Suitability, suitability
from geomag.navigation_report import NavigationReport, calibrate_navigation

__all__ = [
    "RISK_BINS",
    "Calibration",
    "NavigationReport",
    "Suitability",
    "assess",
    "calibrate_lines",
    "calibrate_navigation",
    "calibrate_simulated",
    "one_sided_limit",
    "suitability",
]
