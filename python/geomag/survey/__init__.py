"""Survey lines to a map that knows its own errors.

`map_from_lines` grids the lines, leaves a part of them out at a time, matches those against a map of the others, and
learns from what it sees how large the errors of a gridded map are, how far along a track they go together, and how far whole
features stand displaced. The `GridMap` that comes back carries all of it; `match_posterior` needs nothing else.

The model, in the distance D to the data, the local root mean square gradient G and the local root mean square
second derivative C of the map:

    sigma^2 = n^2 + (a D / L)^2 + (0.1 cell * G)^2 + (b G D)^2 + (c C D^2)^2

with D the harmonic mean of the distance to the nearest datum and of that to the nearest on the other side (what lies between two lines is known better than what
lies as far beyond one), L half the line spacing and n the noise of the lines themselves (from their second differences). `b G D` is a feature displaced
by a part of the gap, `c C D^2` one that no line has seen, `a` what is between the lines where the map is flat. All of them vanish on
a line: that is what keeps a track in a gap from being taken for the next line, which it resembles most. Samples follow a
Student-t law; their effective number follows from a correlation length in units of D. What the formula leaves out goes over kilometres: sigma is
multiplied by a factor from place to place, the errors of the lines left out over their sigma, smoothed over three line spacings. Source: geomag's own, from the statistics of
two aeromagnetic surveys (docs/calibration-report.md); the gridding is Briggs (1974), Smith and Wessel (1990).

A map honours its lines, unless those that are left out clearly fit a smoother one: then it is a smoothing spline (Wahba, Spline models for
observational data, SIAM, 1990), its length is chosen by those lines (`ErrorModel.smoothing_m`), and n is at least what the lines are missed by.
"""

from __future__ import annotations

from geomag.survey._flights import learn_from_flights
from geomag.survey._learn import learn_errors
from geomag.survey._lines import Lines, read_lines, smooth_lines
from geomag.survey._maps import map_from_lines, with_errors, with_line_spacing
from geomag.survey._model import ErrorModel, limit_of_mean
from geomag.survey._survey import Survey, folds_of, line_spacing_m

__all__ = ["ErrorModel", "Lines", "Survey", "folds_of", "learn_errors", "learn_from_flights", "limit_of_mean", "line_spacing_m", "map_from_lines", "read_lines", "smooth_lines",
           "with_errors", "with_line_spacing"]  # fmt: skip
