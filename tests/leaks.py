"""Calls over and over: resident memory must not grow. `python tests/leaks.py 1000000` is the long form.

Every public function and method of the extension has a line here, asked for by test_leaks.py. Those that take microseconds are called as
often as is asked; those that take longer, for about as long as a million microseconds.
"""

from __future__ import annotations

import contextlib
import ctypes
import gc
import pickle
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import geomag
from geomag import _geomag, synthetic
from geomag.compensation import Compensator

X = np.arange(0.0, 2000.0, 50.0)
GRID = geomag.GridMap(
    90 * np.sin(X / 140)[None, :] + 80 * np.cos(X / 120)[:, None] + 0.02 * X[None, :], X, X, sigma=1.0, height_m=0.0
)
UPPER = geomag.GridMap(0.8 * GRID.values, X, X, sigma=1.0, height_m=300.0)
STACK = geomag.MapStack([GRID, UPPER])
K = np.arange(12.0)
TRUE = 500.0 + 40.0 * K, 600.0 + 30.0 * K
TRACK = geomag.Track(TRUE[0] - 30.0, TRUE[1] + 20.0, GRID.sample(*TRUE), K)
CRUST = synthetic.Crust(waves=8, dipoles=2).draw((0, 0, 4000, 4000), seed=1)
PATH = synthetic.Path.straight((500, 500), course_deg=50, speed_m_s=40, interval_s=1.0, samples=12)
NORTH, EAST = (a.ravel() for a in np.meshgrid(*[np.linspace(-5e3, 5e3, 7)] * 2))
FIELD = np.stack([-30 * np.sin(NORTH / 1e3), 20 * np.cos(EAST / 700), 30 * np.cos(NORTH / 1e3)], -1)
MODEL = geomag.RectangularHarmonicModel.fit(NORTH, EAST, 0.0, FIELD, order=2, frame=geomag.LocalFrame(50.0, 10.0))
SENSED = MODEL.to_map("down", down_m=0.0)
FRAME = geomag.LocalFrame(50.0, 10.0)
OBSERVED = geomag.FieldObservations()
OBSERVED.add_vector(NORTH, EAST, 0.0, FIELD)
FIX = geomag.match_grid(GRID, TRACK, half_width=100.0)
INS = geomag.InsModel.navigation()

IEMA = geomag.Iema(GRID, sigma=2.0, half_width=200.0, max_misses=5)
POSTERIOR = geomag.PosteriorMatcher(GRID, half_width=100.0, sigma=0.5, max_samples=6)
SLIDING = geomag.SlidingContour(GRID, length=4, transform="translation", radius_m=300.0)
NAVIGATOR = geomag.Navigator(GRID, position_sigma_m=100.0, matcher=None)
WALKER = geomag.FieldNavigator(GRID, start=(500.0, 600.0), covariance_m2=900.0, reading_sigma=1.0)
UKF = geomag.UnscentedKalmanFilter([0.0, 1.0], np.diag([4.0, 1.0]))
EKF = geomag.ExtendedKalmanFilter([0.0, 1.0], np.diag([4.0, 1.0]))
FEEDBACK = geomag.InsFeedback()
DELTA = geomag.DeltaModulator(2.0)
COMPENSATOR = Compensator([1.0] * 18, max_gap_s=2.0)
CLOCK = iter(range(1 << 60))
EYE = [[1.0, 0.0], [0.0, 1.0]]


def refused(work: Callable[[], object]) -> Callable[[], None]:
    """The way of errors leaks too, where it does."""

    def call() -> None:
        with contextlib.suppress(geomag.GeomagError, OSError):
            work()

    return call


def looked_at(thing: object) -> Callable[[], None]:
    """Every attribute, and the words."""
    names = [n for n in dir(thing) if not n.startswith("_")]
    names = [n for n in names if not callable(getattr(type(thing), n, None))]

    def call() -> None:
        for n in names:
            with contextlib.suppress(geomag.GeomagError):
                getattr(thing, n)
        repr(thing)

    return call


def start_over(navigator: geomag.Navigator) -> None:
    with contextlib.suppress(geomag.GeomagError):
        navigator.step(float(next(CLOCK)), 520.0, 610.0)


#: name in the extension -> a call of it.
CALLS: dict[str, Callable[[], object]] = {
    "Compensator.update": lambda: COMPENSATOR.update(float(next(CLOCK)), [3e4, 5e2, 4e4], 5e4),
    "DeltaModulator.reset": DELTA.reset,
    "DeltaModulator.update": lambda: DELTA.update(float(next(CLOCK) % 17)),
    "ExtendedKalmanFilter.predict": lambda: EKF.predict([0.0, 1.0], [[0.5, 0.0], [0.0, 0.5]], 0.1),
    "ExtendedKalmanFilter.update": lambda: EKF.update([1.0], [0.5], [[1.0, 0.0]], 4.0),
    "FieldNavigator.bound": lambda: WALKER.bound([[500.0, 600.0], [520.0, 610.0]], 1.0, 5.0, 50.0),
    "FieldNavigator.step": lambda: WALKER.step(1.0, 0.0, 50.0, 30.0),
    "FieldObservations.add_anomaly": lambda: geomag.FieldObservations().add_anomaly([0.0], [1.0], [2.0], [3.0], main_field=[1.0, 0.0, 2.0]),
    "FieldObservations.add_intensity": lambda: geomag.FieldObservations().add_intensity([0.0], [1.0], [2.0], [3.0], main_field=[1.0, 0.0, 2.0]),
    "FieldObservations.add_vector": lambda: geomag.FieldObservations().add_vector([0.0], [1.0], [2.0], [[3.0, 1.0, 2.0]]),
    "FieldSensor.read": lambda: geomag.FieldSensor(GRID).read(500.0, 600.0),
    "Fix.to_dict": FIX.to_dict,
    "GridMap.bounds": lambda: GRID.bounds(500.0, 500.0, half_width=100.0),
    "GridMap.continue_to": lambda: GRID.continue_to(50.0),
    "GridMap.from_xarray": lambda: geomag.GridMap.from_xarray(GRID.to_xarray()),
    "GridMap.gradient": lambda: GRID.gradient(500.0, 600.0),
    "GridMap.metres_per_unit": lambda: GRID.metres_per_unit(10.0),
    "GridMap.open": refused(lambda: geomag.GridMap.open("/no/such/map")),
    "GridMap.sample": lambda: GRID.sample(500.0, 600.0),
    "GridMap.save": refused(lambda: GRID.save("/no/such/folder/map.nc")),
    "GridMap.to_xarray": GRID.to_xarray,
    "GridMap.vertical_gradient": GRID.vertical_gradient,
    "GridMap.with_error_model": lambda: GRID.with_error_model(nu=3.0, scale_spread=0.2, correlation=0.5, registration=0.1, distance_m=50.0),
    "GridMap.with_ground_scale": lambda: GRID.with_ground_scale([[1.0, 1.0]] * X.size),
    "HarmonicMap.gradient": lambda: SENSED.gradient(10.0, 20.0),
    "HarmonicMap.sample": lambda: SENSED.sample(10.0, 20.0),
    "HarmonicMap.to_grid": lambda: SENSED.to_grid(np.arange(3.0), np.arange(3.0)),
    "Iema.reset": IEMA.reset,
    "Iema.run": lambda: IEMA.run(TRACK),
    "Iema.update": lambda: IEMA.update(500.0, 600.0, 20.0),
    "InsFeedback.step": lambda: FEEDBACK.step(float(next(CLOCK)), 5.0, 6.0, offset_m=(1.0, 2.0), covariance_m2=[[9.0, 0.0], [0.0, 9.0]]),
    "InsModel.navigation": geomag.InsModel.navigation,
    "InsModel.tactical": geomag.InsModel.tactical,
    "InsModel.to_dict": INS.to_dict,
    "LocalFrame.forward": lambda: FRAME.forward(50.1, 10.1, 5.0),
    "LocalFrame.inverse": lambda: FRAME.inverse(10.0, 20.0, 30.0),
    "LocalFrame.rotate_from_origin": lambda: FRAME.rotate_from_origin(50.1, 10.1, [1.0, 2.0, 3.0]),
    "LocalFrame.rotate_to_origin": lambda: FRAME.rotate_to_origin(50.1, 10.1, [1.0, 2.0, 3.0]),
    "_contour_settings": lambda: _geomag._contour_settings(GRID, starts="grid", half_width_m=100.0),
    "Acceptance.to_dict": lambda: _geomag.Acceptance(max_risk=0.02).to_dict(),
    "InsPrior.to_dict": lambda: _geomag.InsPrior(scale_sigma=0.01).to_dict(),
    "MatcherPlan.to_dict": lambda: geomag.MatcherPlan().to_dict(),
    "SearchBox.to_dict": lambda: _geomag.SearchBox(half_width=(1.0, 1.0)).to_dict(),
    "MainFieldModel.field": lambda: MAIN.field(50.0, 10.0, 0.0, 2000.5),
    "MapStack.at": lambda: STACK.at(100.0),
    "MapStack.metres_per_unit": lambda: STACK.metres_per_unit(5.0),
    "MapStack.sample": lambda: STACK.sample(500.0, 600.0, 100.0),
    "Navigator.correct": refused(lambda: NAVIGATOR.correct(FIX)),
    "Navigator.correct_position": refused(lambda: NAVIGATOR.correct_position((1.0, 2.0), [[9.0, 0.0], [0.0, 9.0]])),
    "Navigator.correct_velocity": refused(lambda: NAVIGATOR.correct_velocity((1.0, 2.0), 0.5)),
    "Navigator.predict_bound": refused(lambda: NAVIGATOR.predict_bound([0.0, 1.0], [500.0, 510.0], [600.0, 605.0])),
    "Navigator.reset": refused(lambda: NAVIGATOR.reset(500.0, 600.0, [[900.0, 0.0], [0.0, 900.0]])),
    "Navigator.step": refused(lambda: NAVIGATOR.step(float(next(CLOCK)), 500.0, 600.0, (0.0, 0.0), 50.0, 20.0)),
    "Path.along_legs": lambda: synthetic.Path.along_legs((0, 0), course_deg=10.0, speed_m_s=10.0, interval_s=1.0, legs=[(3, 1.0)]),
    "Path.offset_m": refused(lambda: PATH.offset_m(TRACK)),
    "Path.straight": lambda: synthetic.Path.straight((0, 0), course_deg=10.0, speed_m_s=10.0, interval_s=1.0, samples=4),
    "PosteriorMatcher.fix": refused(POSTERIOR.fix),
    "PosteriorMatcher.reset": POSTERIOR.reset,
    "PosteriorMatcher.run": lambda: POSTERIOR.run(TRACK),
    "PosteriorMatcher.update": lambda: POSTERIOR.update(500.0, 600.0, 20.0),
    "RectangularHarmonicModel.field": lambda: MODEL.field(10.0, 20.0, 0.0),
    "RectangularHarmonicModel.field_geographic": lambda: MODEL.field_geographic(50.0, 10.0, 0.0),
    "RectangularHarmonicModel.field_grid": lambda: MODEL.field_grid([0.0, 1.0], [0.0, 1.0], down_m=0.0),
    "RectangularHarmonicModel.fit": lambda: geomag.RectangularHarmonicModel.fit(NORTH, EAST, 0.0, FIELD, order=1),
    "RectangularHarmonicModel.fit_observations": lambda: geomag.RectangularHarmonicModel.fit_observations(OBSERVED, order=1),
    "RectangularHarmonicModel.from_coefficients": lambda: geomag.RectangularHarmonicModel.from_coefficients(2, MODEL.periods_m, MODEL.coefficients, region=MODEL.region),
    "RectangularHarmonicModel.from_json": refused(lambda: geomag.RectangularHarmonicModel.from_json("{}")),
    "RectangularHarmonicModel.gradient": lambda: MODEL.gradient(10.0, 20.0, 0.0),
    "RectangularHarmonicModel.intensity": lambda: MODEL.intensity(10.0, 20.0, 0.0, main_field=[2e4, 0.0, 4e4]),
    "RectangularHarmonicModel.leave_out": lambda: geomag.RectangularHarmonicModel.leave_out(OBSERVED, order=1, folds=2),
    "RectangularHarmonicModel.potential": lambda: MODEL.potential(10.0, 20.0, 0.0),
    "RectangularHarmonicModel.sample_to_grid": lambda: MODEL.sample_to_grid([0.0, 1.0], [0.0, 1.0], down_m=0.0),
    "RectangularHarmonicModel.select": lambda: geomag.RectangularHarmonicModel.select(OBSERVED, order=[1, 2], folds=2),
    "RectangularHarmonicModel.sigma": lambda: MODEL.sigma(10.0, 20.0, 0.0),
    "RectangularHarmonicModel.terms": lambda: MODEL.terms(2),
    "RectangularHarmonicModel.to_json": MODEL.to_json,
    "RectangularHarmonicModel.to_map": lambda: MODEL.to_map("down", down_m=0.0),
    "SlidingContour.reset": SLIDING.reset,
    "SlidingContour.run": lambda: SLIDING.run(TRACK),
    "SlidingContour.update": lambda: SLIDING.update(500.0, 600.0, 20.0),
    "SyntheticField.grid": lambda: CRUST.grid(2000.0),
    "SyntheticField.sample": lambda: CRUST.sample(500.0, 600.0),
    "Track.distance_m": TRACK.distance_m,
    "UnscentedKalmanFilter.predict": lambda: UKF.predict([[0.5, 0.0], [0.0, 0.5]], 0.1),
    "UnscentedKalmanFilter.sigma_points": UKF.sigma_points,
    "UnscentedKalmanFilter.update": lambda: UKF.update([1.0], lambda x: [x[0]], 4.0),
    "closest_contour_point": lambda: geomag.closest_contour_point(GRID, 500.0, 600.0, 20.0),
    "choose_sequence": lambda: geomag.choose_sequence(10.0 * K, TRACK.values, quantum=1.0, cell_m=5.0),
    "energy_bandwidth": lambda: geomag.energy_bandwidth(TRACK.values, 10.0),
    "fit_transform": lambda: geomag.fit_transform([[0.0, 0.0], [1.0, 0.0]], [[1.0, 1.0], [2.0, 1.0]]),
    "match_contour": lambda: geomag.match_contour(GRID, TRACK, radius_m=200.0, max_iterations=5),
    "match_grid": lambda: geomag.match_grid(GRID, TRACK, half_width=60.0),
    "match_posterior": lambda: geomag.match_posterior(GRID, TRACK, half_width=60.0, sigma=0.5),
    "match_posterior_many": lambda: geomag.match_posterior_many(GRID, [TRACK], half_width=60.0, sigma=0.5),
    "predict_many": lambda: geomag.predict_many(GRID, [TRACK], half_width=60.0, sigma=0.5, flights=2),
    "tune_sequence": lambda: geomag.tune_sequence(GRID, TRACK, sigma=1.0, offset_m=50.0, draws=1, quanta=[2.0], max_iterations=3),
    # Not of the extension itself, or not by that name.
    "delta_modulation": lambda: geomag.delta_modulation(TRACK.values, 2.0),
    "navigate": lambda: geomag.navigate(GRID, TRACK.time_s, TRACK.x, TRACK.y, readings=TRACK.values, position_sigma_m=50.0, matcher=None),
    "fly": lambda: synthetic.fly(CRUST, PATH, sensor=synthetic.Sensor(sigma=1.0)),
    "GridMap": lambda: geomag.GridMap(np.ones((3, 3)), [0.0, 1.0, 2.0], [0.0, 1.0, 2.0]),
    "GridMap refused": refused(lambda: geomag.GridMap(np.ones((3, 3)), [0.0, 1.0, 5.0], [0.0, 1.0, 2.0])),
    "Track": lambda: geomag.Track(K, K, K),
    "Track refused": refused(lambda: geomag.Track(K, K, K[:3])),
    "pickle GridMap": lambda: pickle.loads(pickle.dumps(GRID)),
    "pickle Fix": lambda: pickle.loads(pickle.dumps(FIX)),
    "pickle Navigator": lambda: pickle.loads(pickle.dumps(NAVIGATOR)),
    "pickle PosteriorMatcher": lambda: pickle.loads(pickle.dumps(POSTERIOR)),
    "attributes": looked_at(GRID),
    "attributes of a fix": looked_at(FIX),
    "attributes of filters": looked_at(UKF),
    "attributes of a navigator": looked_at(NAVIGATOR),
}  # fmt: skip

MAIN = geomag.mainfield.load("igrf14").model

#: Of the extension, without a name that users see: called by what is called here, or by campaigns, which start processes.
INSIDE = {
    "_delta_modulation", "_displacements_m", "_distances_to_data", "_minimum_curvature", "_navigate", "_radii_m", "bound_block", "bound_reach",
    "campaign_flight", "campaign_rows", "draw_ins_error", "fly", "tolles_lawson_terms",
}  # fmt: skip


def public() -> set[str]:
    """Functions and methods of the extension."""
    names = set()
    for name in dir(_geomag):
        thing = getattr(_geomag, name)
        if name.startswith("__") or not callable(thing):
            continue
        if isinstance(thing, type):
            if not issubclass(thing, BaseException):
                names |= {f"{name}.{m}" for m in dir(thing) if not m.startswith("_") and callable(getattr(thing, m))}
        elif name not in INSIDE:
            names.add(name)
    return names


def resident_kib() -> int:
    with Path("/proc/self/status").open() as status:
        return next(int(line.split()[1]) for line in status if line.startswith("VmRSS"))


def settle() -> None:
    gc.collect()
    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL("libc.so.6").malloc_trim(0)


def grown_kib(call: Callable[[], Any], count: int, seconds: float) -> tuple[int, int]:
    """What a call adds to the resident memory, from the end of the first third to that of the last; and how often it was made.

    What is kept once (pools, caches, a thread's buffers) is there by then; what is kept a call goes on growing.
    """
    begun = time.perf_counter()
    for _ in range(3):
        call()
    each = max((time.perf_counter() - begun) / 3, 1e-7)
    third = max(int(min(count, seconds / each)) // 3, 3)
    for _ in range(third):
        call()
    settle()
    before = resident_kib()
    for _ in range(2 * third):
        call()
    settle()
    return resident_kib() - before, 3 * third


def main() -> int:
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 1_000_000
    seconds = float(sys.argv[2]) if len(sys.argv) > 2 else 20.0
    only = sys.argv[3:]
    worst = 0
    for name, call in CALLS.items():
        if only and name not in only:
            continue
        # Pools take memory by the megabyte, once; what is kept a call grows every time. Eight bytes a call show from some 100,000 on.
        for _ in range(3):
            grown, made = grown_kib(call, count, seconds)
            leak = grown > max(1024, 0.004 * made)
            if not leak:
                break
        worst = max(worst, grown)
        print(f"{name:45} {made:9,} calls  {grown:6} KiB{'  LEAK' if leak else ''}", flush=True)
        if leak:
            return 1
    print(f"no call keeps memory; greatest growth {worst} KiB")
    return 0


if __name__ == "__main__":
    sys.exit(main())
