"""Geomagnetic and gravity map-matching navigation.

An INS drifts; the anomaly field does not. From an indicated track, measured field values and a stored map, geomag
returns a position fix with its risk.

>>> import numpy as np, geomag
>>> x = y = np.arange(0.0, 5000.0, 50.0)
>>> field = 100 * np.sin(x / 300)[None, :] * np.cos(y / 410)[:, None]
>>> grid = geomag.GridMap(field, x, y)
>>> east = np.linspace(1500, 3500, 30)
>>> north = np.linspace(2000, 2900, 30)
>>> track = geomag.Track(east - 200, north + 150, grid.sample(east, north))
>>> fix = geomag.match_grid(grid, track, criterion="msd", half_width=(500, 500))
>>> fix.status, [round(v) for v in fix.offset_m]
('fixed', [200, -150])
"""

from __future__ import annotations

from importlib import import_module
from types import ModuleType

from geomag._errors import (
    CandidateLimitError,
    DataWarning,
    GeomagError,
    InvalidInputError,
    MissingDependencyError,
    MissingFileError,
    NotFiniteError,
    NotPositiveDefiniteError,
    NumericalError,
    RankDeficientError,
    ReadError,
    ShapeError,
    StateError,
    TimeError,
    TooFewSamplesError,
    UnknownVariableError,
)
from geomag._geomag import (
    Acceptance,
    CorrectedPosition,
    DeltaModulator,
    ExtendedKalmanFilter,
    FeedbackStep,
    FieldNavigator,
    FieldNavigatorStep,
    FieldObservations,
    FieldSensor,
    Fix,
    GridMap,
    HarmonicMap,
    Iema,
    IemaStep,
    InsFeedback,
    InsModel,
    InsPrior,
    LocalFrame,
    MapStack,
    MatcherPlan,
    Navigator,
    NavigatorStep,
    PosteriorMatcher,
    PosteriorStep,
    Prediction,
    RectangularHarmonicModel,
    SearchBox,
    SlidingContour,
    Track,
    UnscentedKalmanFilter,
    __version__,
    choose_sequence,
    closest_contour_point,
    energy_bandwidth,
    fit_transform,
    instruction_set,
    instruction_sets,
    match_contour,
    match_grid,
    match_posterior,
    match_posterior_many,
    predict_many,
    tune_sequence,
)
from geomag._navigation import Navigation, navigate
from geomag._sequence import ChosenSamples, delta_modulation
from geomag._versions import show_versions
from geomag.io import read_grid, read_track

#: Modules that are imported when they are first asked for, so that `import geomag` stays light.
_MODULES = frozenset({
    "accessor", "blocks", "calibration", "campaign", "compensation", "continuation", "dafmit", "disturbances", "diurnal", "exchange", "flight_log", "flights",
    "harmonic_survey", "mainfield", "mavlink", "navigation_report", "plot", "projection", "reduction", "report", "reproduce", "stream", "stress",
    "survey", "synthetic", "vector",
})  # fmt: skip


def __getattr__(name: str) -> ModuleType:
    """Import a module of the package when it is first asked for."""
    if name in _MODULES:
        return import_module(f"geomag.{name}")
    raise AttributeError(f"module 'geomag' has no attribute '{name}'")


def __dir__() -> list[str]:
    """Names of the package, its modules among them."""
    return sorted({*globals(), *_MODULES})


__all__ = [
    "Acceptance",
    "CandidateLimitError",
    "ChosenSamples",
    "CorrectedPosition",
    "DataWarning",
    "DeltaModulator",
    "ExtendedKalmanFilter",
    "FeedbackStep",
    "FieldNavigator",
    "FieldNavigatorStep",
    "FieldObservations",
    "FieldSensor",
    "Fix",
    "GeomagError",
    "GridMap",
    "HarmonicMap",
    "Iema",
    "IemaStep",
    "InsFeedback",
    "InsModel",
    "InsPrior",
    "InvalidInputError",
    "LocalFrame",
    "MapStack",
    "MatcherPlan",
    "MissingDependencyError",
    "MissingFileError",
    "Navigation",
    "Navigator",
    "NavigatorStep",
    "NotFiniteError",
    "NotPositiveDefiniteError",
    "NumericalError",
    "PosteriorMatcher",
    "PosteriorStep",
    "Prediction",
    "RankDeficientError",
    "ReadError",
    "RectangularHarmonicModel",
    "SearchBox",
    "ShapeError",
    "SlidingContour",
    "StateError",
    "TimeError",
    "TooFewSamplesError",
    "Track",
    "UnknownVariableError",
    "UnscentedKalmanFilter",
    "__version__",
    "choose_sequence",
    "closest_contour_point",
    "delta_modulation",
    "energy_bandwidth",
    "fit_transform",
    "instruction_set",
    "instruction_sets",
    "match_contour",
    "match_grid",
    "match_posterior",
    "match_posterior_many",
    "navigate",
    "predict_many",
    "read_grid",
    "read_track",
    "show_versions",
    "tune_sequence",
]
