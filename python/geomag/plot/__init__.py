"""Pictures: one style, readable in print and by the colour-blind, units on every axis.

Every function draws on the axes that it is given, or makes a figure, and returns what it drew on; nothing is shown or
written unless asked for (`save`). Needs matplotlib: `pip install 'geomag-nav[plot]'`.

=====================  ==============================================================================
`field_map`            a map with its colour bar, scale bar and north arrow
`tracks`, `ellipse`    indicated, true and matched tracks; error ellipses of fixes
`match_figure`         all about one match on one sheet
`match_map`            the part of the map about a match, with its tracks
`score_surface`        scores over the offset lattice
`frames`, `animate`    a feasible set or a posterior, sample by sample
`residuals`            measured against map values along the track
`calibration_diagram`  declared risk against observed rate of wrong fixes
`reliability_points`   the same from bins that were counted elsewhere
`navigation_figure`    a navigated flight: map, log and bounds
`suitability_map`      where on the map a fix can be had
`sequence_choice`      which samples were chosen on the field's profile
`filter_errors`        errors of a filter with the bands of its own covariance
`error_distribution`   distribution of position errors of one or more methods
=====================  ==============================================================================
"""

from __future__ import annotations

from geomag.plot._diagrams import (
    calibration_diagram,
    error_distribution,
    filter_errors,
    reliability_points,
    residuals,
    sequence_choice,
)
from geomag.plot._frames import Frame, animate, frames, score_surface
from geomag.plot._maps import ellipse, field_map, north_arrow, scale_bar, suitability_map, tracks
from geomag.plot._match import match_figure, match_map
from geomag.plot._navigation import navigation_figure
from geomag.plot._style import COLOURS, save, style

__all__ = [
    "COLOURS",
    "Frame",
    "animate",
    "calibration_diagram",
    "ellipse",
    "error_distribution",
    "field_map",
    "filter_errors",
    "frames",
    "match_figure",
    "match_map",
    "navigation_figure",
    "north_arrow",
    "reliability_points",
    "residuals",
    "save",
    "scale_bar",
    "score_surface",
    "sequence_choice",
    "style",
    "suitability_map",
    "tracks",
]
