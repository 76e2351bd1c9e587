"""The vehicle's own field, found from a calibration flight and taken off readings: Tolles and Lawson (1950).

A scalar magnetometer on a vehicle reads the vehicle too: its permanent magnetisation, what the Earth's field induces in it, and eddy
currents where it turns. Eighteen terms describe it (3, 6 and 9), known from the direction of the field in the vehicle's axes: a vector
magnetometer's, or the main field turned by the attitude. The order is: log a calibration flight (pitch, roll and yaw on four
headings, where the crust is quiet or known), `fit` it, save it, `Compensation.apply` it to logs or `Compensation.stream` to readings
as they come.

`deinterf` fits the same terms, but with coefficients and samples of one log only: no gaps, no covariance, no stream. The terms
are therefore in the Rust core, the fit is here.

>>> import numpy as np
>>> from geomag import compensation, synthetic
>>> flight = synthetic.calibration_box(seed=3)
>>> found = compensation.fit(flight.time_s, flight.reading_nt, flight.field_nt)
>>> quiet = found.apply(flight.time_s, flight.reading_nt, flight.field_nt)
>>> left = np.std(quiet - flight.clean_nt)
>>> bool(left < 0.02 * np.std(flight.interference_nt)), found.improvement_ratio > 20
(True, True)
"""

from __future__ import annotations

from geomag._geomag import Compensator
from geomag.compensation._attitude import field_in_vehicle
from geomag.compensation._fit import fit, solve
from geomag.compensation._model import TERM_NAMES, Compensation, Leftover, figure_of_merit, terms

__all__ = [
    "TERM_NAMES",
    "Compensation",
    "Compensator",
    "Leftover",
    "field_in_vehicle",
    "figure_of_merit",
    "fit",
    "solve",
    "terms",
]
