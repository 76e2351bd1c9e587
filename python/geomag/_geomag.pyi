"""Signatures of the compiled module; the docstrings are on the objects themselves."""

from collections.abc import Callable, Sequence
from os import PathLike
from typing import Any, Literal, TypeAlias, TypedDict, Unpack, final

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

__version__: str
instruction_set: str
instruction_sets: tuple[str, ...]

_Floats: TypeAlias = NDArray[np.float64]
_Pair: TypeAlias = float | Sequence[float] | _Floats
_Progress: TypeAlias = bool | Callable[[int, int], object] | None
_Status: TypeAlias = Literal[
    "fixed", "searching", "ambiguous", "at_edge", "lost", "uninformative", "not_converged", "rejected"
]

_Field: TypeAlias = GridMap | HarmonicMap | MapStack
_Channel: TypeAlias = tuple[_Field, ArrayLike, float | None]

@final
class GridMap:
    def __new__(
        cls,
        values: ArrayLike,
        x: ArrayLike,
        y: ArrayLike,
        *,
        geographic: bool = False,
        sigma: ArrayLike | None = None,
        correlation_m: float | None = None,
        height_m: ArrayLike | None = None,
        name: str | None = None,
        units: str | None = None,
        crs: str | None = None,
        ground_scale: ArrayLike | None = None,
        line_spacing_m: float | None = None,
    ) -> GridMap: ...
    @property
    def ground_scale(self) -> _Floats | None: ...
    def with_ground_scale(self, ground_scale: ArrayLike) -> GridMap: ...
    @staticmethod
    def from_xarray(data_array: xr.DataArray, **options: Any) -> GridMap: ...
    def to_xarray(self) -> xr.DataArray: ...
    def continue_to(self, height_m: ArrayLike, **options: Any) -> Any: ...
    def vertical_gradient(self, **options: Any) -> GridMap: ...
    def save(self, path: str | PathLike[str]) -> None: ...
    @staticmethod
    def open(path: str | PathLike[str]) -> GridMap: ...
    @property
    def x(self) -> _Floats: ...
    @property
    def y(self) -> _Floats: ...
    @property
    def values(self) -> NDArray[np.float32] | _Floats: ...
    @property
    def sigma(self) -> float | _Floats | None: ...
    @property
    def correlation_m(self) -> float | None: ...
    @property
    def height_m(self) -> float | _Floats | None: ...
    def with_error_model(
        self,
        *,
        nu: float,
        scale_spread: float,
        correlation: float,
        registration: float,
        distance_m: ArrayLike,
        sample_factor: float | None = None,
        batch_factor: float | None = None,
        crossover: float | None = None,
        registration_m_per_d: float | None = None,
        registration_length: float | None = None,
        misfit_threshold: float | None = None,
        recalibration: tuple[float, float] | None = None,
        forecast: tuple[float, float, float] | tuple[float, float] | None = None,
        layout: Literal["given", "values"] = "given",
        lapses: tuple[float, float] | None = None,
        covariance_factor: float | None = None,
    ) -> GridMap: ...
    @property
    def error_model(self) -> dict[str, Any] | None: ...
    @property
    def shape(self) -> tuple[int, int]: ...
    @property
    def spacing(self) -> tuple[float, float]: ...
    @property
    def spacing_m(self) -> tuple[float, float]: ...
    @property
    def geographic(self) -> bool: ...
    @property
    def holes(self) -> int: ...
    @property
    def mean(self) -> float: ...
    @property
    def name(self) -> str | None: ...
    @property
    def units(self) -> str | None: ...
    @property
    def crs(self) -> str | None: ...
    @property
    def line_spacing_m(self) -> float | None: ...
    def metres_per_unit(self, y: float) -> tuple[float, float]: ...
    def sample(
        self,
        x: ArrayLike,
        y: ArrayLike,
        *,
        interpolation: Literal["bilinear", "bicubic"] = "bilinear",
        method: Literal["bilinear", "bicubic"] | None = None,
    ) -> Any: ...
    def gradient(
        self,
        x: ArrayLike,
        y: ArrayLike,
        *,
        interpolation: Literal["bilinear", "bicubic"] = "bilinear",
        method: Literal["bilinear", "bicubic"] | None = None,
    ) -> tuple[Any, Any]: ...
    def bounds(self, x: ArrayLike, y: ArrayLike, *, half_width: _Pair) -> tuple[Any, Any]: ...
    def __reduce__(self) -> tuple[Any, ...]: ...
    @staticmethod
    def _restore(
        values: ArrayLike,
        axes: tuple[tuple[float, float], tuple[float, float]],
        geographic: bool,
        errors: tuple[ArrayLike | None, float | None],
        text: tuple[str | None, str | None, str | None],
        model: dict[str, Any] | None,
        height_m: ArrayLike | None = None,
        ground_scale: ArrayLike | None = None,
        turned: tuple[bool, bool] = ...,
        line_spacing_m: float | None = None,
    ) -> GridMap: ...

@final
class MapStack:
    def __new__(cls, levels: Sequence[GridMap]) -> MapStack: ...
    @property
    def heights_m(self) -> _Floats: ...
    @property
    def levels(self) -> tuple[GridMap, ...]: ...
    def metres_per_unit(self, y: float) -> tuple[float, float]: ...
    @property
    def spacing(self) -> tuple[float, float]: ...
    @property
    def geographic(self) -> bool: ...
    def sample(
        self,
        x: ArrayLike,
        y: ArrayLike,
        height_m: ArrayLike,
        *,
        interpolation: Literal["bilinear", "bicubic"] = "bilinear",
        method: Literal["bilinear", "bicubic"] | None = None,
    ) -> Any: ...
    def at(self, height_m: float) -> GridMap: ...
    def __len__(self) -> int: ...
    def __reduce__(self) -> tuple[Any, ...]: ...

@final
class Track:
    def __new__(
        cls,
        x: ArrayLike,
        y: ArrayLike,
        values: ArrayLike,
        time_s: ArrayLike | None = None,
        *,
        height_m: ArrayLike | None = None,
        geographic: bool | None = None,
    ) -> Track: ...
    @property
    def geographic(self) -> bool | None: ...
    @property
    def x(self) -> _Floats: ...
    @property
    def y(self) -> _Floats: ...
    @property
    def values(self) -> _Floats: ...
    @property
    def time_s(self) -> _Floats | None: ...
    @property
    def height_m(self) -> _Floats | None: ...
    def distance_m(self, *, geographic: bool = False) -> _Floats: ...
    def __len__(self) -> int: ...
    def __getitem__(self, index: slice, /) -> Track: ...
    def __reduce__(self) -> tuple[Any, ...]: ...
    @staticmethod
    def _restore(
        x: ArrayLike,
        y: ArrayLike,
        values: ArrayLike,
        time_s: ArrayLike | None,
        height_m: ArrayLike | None,
        geographic: bool | None = None,
    ) -> Track: ...

@final
class Fix:
    @property
    def x(self) -> float: ...
    @property
    def y(self) -> float: ...
    @property
    def offset(self) -> tuple[float, float]: ...
    @property
    def offset_m(self) -> tuple[float, float]: ...
    @property
    def heading_deg(self) -> float: ...
    @property
    def scale(self) -> float: ...
    @property
    def bias(self) -> float | None: ...
    @property
    def covariance_m2(self) -> _Floats | None: ...
    @property
    def risk(self) -> float | None: ...
    @property
    def goodness(self) -> float | None: ...
    @property
    def misfit(self) -> tuple[str, float, float] | None: ...
    @property
    def status(self) -> _Status: ...
    @property
    def ok(self) -> bool: ...
    @property
    def score(self) -> float: ...
    @property
    def runner_up(self) -> float: ...
    @property
    def n_samples(self) -> int: ...
    @property
    def iterations(self) -> int: ...
    @property
    def track(self) -> _Floats: ...
    @property
    def heights_m(self) -> tuple[float, float] | None: ...
    @property
    def surface(self) -> _Floats | None: ...
    @property
    def surface_axes(self) -> tuple[_Floats, _Floats] | None: ...
    def to_dict(self) -> dict[str, Any]: ...
    def __reduce__(self) -> tuple[Any, ...]: ...
    @staticmethod
    def _restore(bytes: bytes) -> Fix: ...

@final
class IemaStep:
    @property
    def status(self) -> _Status: ...
    @property
    def n_samples(self) -> int: ...
    @property
    def n_feasible(self) -> int: ...
    @property
    def extent(self) -> tuple[float, float]: ...
    @property
    def best_offset(self) -> tuple[float, float]: ...
    @property
    def log_score(self) -> float: ...
    @property
    def runner_up(self) -> float: ...
    @property
    def fix(self) -> Fix: ...

@final
class Iema:
    def __new__(
        cls,
        grid: _Field,
        sigma: float,
        *,
        half_width: _Pair | None = None,
        half_width_m: _Pair | None = None,
        step_m: _Pair | None = None,
        tolerance: _Pair | None = None,
        tolerance_m: _Pair | None = None,
        step: _Pair | None = None,
        max_candidates: int = 268_435_456,
        max_misses: int = 0,
        unknown: Literal["keep", "drop"] = "keep",
        gate_sigmas: float = 3.0,
        search: SearchBox | None = None,
        gate: float | None = None,
    ) -> Iema: ...
    def update(self, x: float, y: float, value: float, height_m: float | None = None) -> IemaStep: ...
    def run(self, track: Track) -> Fix: ...
    def reset(self) -> None: ...
    @property
    def feasible(self) -> NDArray[np.bool_]: ...
    @property
    def log_scores(self) -> _Floats: ...
    @property
    def offsets(self) -> tuple[_Floats, _Floats]: ...
    @property
    def n_samples(self) -> int: ...
    @property
    def n_feasible(self) -> int: ...
    def __reduce__(self) -> tuple[Any, ...]: ...
    @staticmethod
    def _restore(grid: _Field, bytes: bytes) -> Iema: ...

def match_grid(
    grid: _Field,
    track: Track,
    criterion: Literal["msd", "mad", "prod", "ncc", "hausdorff"] = "msd",
    *,
    half_width: _Pair | None = None,
    half_width_m: _Pair | None = None,
    step_m: _Pair | None = None,
    step: _Pair | None = None,
    max_candidates: int = 268_435_456,
    heading_deg: ArrayLike | None = None,
    scale: ArrayLike | None = None,
    pivot: Literal["newest", "centroid"] = "newest",
    remove_mean: bool = False,
    weights: ArrayLike | None = None,
    interpolation: Literal["bilinear", "bicubic"] = "bilinear",
    sigma: float | None = None,
    min_overlap: float = 0.8,
    ambiguity: float = 0.01,
    refine: bool = True,
    surface: bool = False,
    robust: Literal["huber", "student_t"] | None = None,
    robust_scale: float | None = None,
    nu: float = 3.0,
    length_scale_m: float | None = None,
    value_scale: float | None = None,
    fraction: float = 1.0,
    search: SearchBox | None = None,
    threads: int | None = None,
    progress: _Progress = None,
    method: Literal["bilinear", "bicubic"] | None = None,
) -> Fix: ...

# Behind geomag.synthetic.

@final
class SyntheticField:
    def __new__(cls, spec_json: str, extent: Sequence[float], geographic: bool, seed: int) -> SyntheticField: ...
    @property
    def extent(self) -> list[float]: ...
    @property
    def geographic(self) -> bool: ...
    def sample(self, x: ArrayLike, y: ArrayLike) -> Any: ...
    def grid(
        self,
        step: float | None = None,
        *,
        x: ArrayLike | None = None,
        y: ArrayLike | None = None,
        name: str | None = None,
        units: str | None = None,
        crs: str | None = None,
    ) -> GridMap: ...
    def __reduce__(self) -> tuple[Any, ...]: ...
    @staticmethod
    def _restore(bytes: bytes) -> SyntheticField: ...

@final
class Path:
    def __new__(cls, x: ArrayLike, y: ArrayLike, time_s: ArrayLike, *, geographic: bool = False) -> Path: ...
    @staticmethod
    def straight(
        start: Sequence[float],
        *,
        course_deg: float,
        speed_m_s: float,
        interval_s: float,
        samples: int,
        geographic: bool = False,
    ) -> Path: ...
    @staticmethod
    def along_legs(
        start: Sequence[float],
        legs: Sequence[tuple[int, float]],
        *,
        course_deg: float,
        speed_m_s: float,
        interval_s: float,
        geographic: bool = False,
    ) -> Path: ...
    @property
    def x(self) -> _Floats: ...
    @property
    def y(self) -> _Floats: ...
    @property
    def time_s(self) -> _Floats: ...
    @property
    def geographic(self) -> bool: ...
    def offset_m(self, track: Track) -> tuple[float, float]: ...
    def __len__(self) -> int: ...
    def __reduce__(self) -> tuple[Any, ...]: ...
    @staticmethod
    def _restore(bytes: bytes) -> Path: ...

def draw_ins_error(spread_json: str, seed: int) -> str: ...
def fly(
    field: SyntheticField | GridMap, path: Path, ins_json: str, sensor_json: str, seed: int
) -> tuple[Track, _Floats]: ...

# Behind geomag.campaign.

def campaign_rows(
    grid: GridMap,
    truth: GridMap | SyntheticField | None,
    campaign_json: str,
    methods: Sequence[tuple[str, str, dict[str, Any]]],
    trials: Sequence[int],
    threads: int | None = None,
    progress: _Progress = None,
) -> list[dict[str, Any]]: ...
def campaign_flight(
    grid: GridMap, truth: GridMap | SyntheticField | None, campaign_json: str, trial: int
) -> tuple[Path, Track, _Floats]: ...

# Behind geomag.blocks.

def bound_reach(
    options_json: str, spacing: Sequence[float], geographic: bool, latitude_deg: float
) -> tuple[int, int]: ...
def bound_block(
    values: ArrayLike, y: ArrayLike, spacing: Sequence[float], geographic: bool, options_json: str
) -> list[tuple[_Floats, _Floats]]: ...

# Contour matching, matching sequences, INS feedback.

_Transform: TypeAlias = Literal["translation", "rigid", "similarity", "affine"]

def closest_contour_point(
    grid: GridMap, x: ArrayLike, y: ArrayLike, value: ArrayLike, *, radius_m: float = ...
) -> tuple[Any, Any, Any]: ...
def fit_transform(
    source: ArrayLike, target: ArrayLike, *, kind: _Transform = "rigid", weights: ArrayLike | None = None
) -> tuple[_Floats, _Floats]: ...
def match_contour(
    grid: GridMap | MapStack,
    track: Track,
    *,
    sigma: float | None = None,
    weights: ArrayLike | None = None,
    channels: Sequence[_Channel] | None = None,
    transform: _Transform = "rigid",
    radius_m: float | None = None,
    starts: Literal["indicated", "grid"] | ArrayLike | None = None,
    refine: bool = False,
    stiffness: float = 0.0,
    converged_m: float = 1.0,
    max_iterations: int = 300,
    min_points: int | None = None,
    acceleration: int = 0,
    max_rotation_deg: float | None = None,
    half_width_m: float | None = None,
    step_m: float | None = None,
    keep_starts: int = 12,
    max_candidates: int = 1_000_000,
    offset_sigma_m: float | None = None,
    heading_sigma_deg: float | None = None,
    scale_sigma: float | None = None,
    bias_sigma: float | None = None,
    interpolation: Literal["bicubic", "bilinear"] = "bicubic",
    map_correlation_m: float | None = None,
    tolerance_m: float | None = None,
    max_risk: float = 0.01,
    min_goodness: float = 0.001,
    min_overlap: float = 0.8,
    search: SearchBox | None = None,
    prior: InsPrior | None = None,
    accept: Acceptance | None = None,
    fix_radius_m: float | None = None,
) -> Fix: ...

@final
class SlidingContour:
    def __new__(
        cls,
        grid: GridMap | MapStack,
        *,
        length: int,
        sigma: float | None = None,
        floor_m: float = 10.0,
        height_m: float | None = None,
        transform: _Transform = "rigid",
        radius_m: float | None = None,
        starts: Literal["indicated", "grid"] | ArrayLike | None = None,
        refine: bool = False,
        stiffness: float = 0.0,
        converged_m: float = 1.0,
        max_iterations: int = 300,
        min_points: int | None = None,
        acceleration: int = 0,
        max_rotation_deg: float | None = None,
        half_width_m: float | None = None,
        step_m: float | None = None,
        keep_starts: int = 12,
        max_candidates: int = 1_000_000,
        offset_sigma_m: float | None = None,
        heading_sigma_deg: float | None = None,
        scale_sigma: float | None = None,
        bias_sigma: float | None = None,
        interpolation: Literal["bicubic", "bilinear"] = "bicubic",
        map_correlation_m: float | None = None,
        tolerance_m: float | None = None,
        max_risk: float = 0.01,
        min_goodness: float = 0.001,
        min_overlap: float = 0.8,
        search: SearchBox | None = None,
        prior: InsPrior | None = None,
        accept: Acceptance | None = None,
        fix_radius_m: float | None = None,
    ) -> SlidingContour: ...
    def update(self, x: float, y: float, value: float, height_m: float | None = None) -> Fix: ...
    def reset(self) -> None: ...
    def run(self, track: Track) -> list[Fix]: ...
    @property
    def settled(self) -> dict[str, Any] | None: ...
    @property
    def averaged(self) -> list[dict[str, Any]]: ...
    @property
    def length(self) -> int: ...
    @property
    def count(self) -> int: ...
    def __reduce__(self) -> tuple[Any, ...]: ...

def _delta_modulation(values: ArrayLike, quantum: float) -> tuple[NDArray[np.int64], NDArray[np.uint8]]: ...

@final
class DeltaModulator:
    def __new__(cls, quantum: float) -> DeltaModulator: ...
    def reset(self) -> None: ...
    def update(self, value: float) -> bool: ...
    @property
    def quantum(self) -> float: ...
    @property
    def count(self) -> int: ...
    @property
    def staircase(self) -> float | None: ...
    def __reduce__(self) -> tuple[Any, ...]: ...

def energy_bandwidth(values: ArrayLike, spacing_m: float, *, share: float = 0.96) -> float: ...
def choose_sequence(
    along_m: ArrayLike,
    values: ArrayLike,
    *,
    quantum: float,
    cell_m: float,
    min_cells: float = 1.0,
    energy_share: float = 0.96,
) -> dict[str, Any]: ...
def tune_sequence(
    grid: GridMap,
    track: Track,
    *,
    sigma: float,
    offset_m: float,
    heading_sigma_deg: float = 0.0,
    scale_sigma: float = 0.0,
    min_length: int = 3,
    max_length: int | None = None,
    quanta: ArrayLike | None = None,
    weights: tuple[float, float] = ...,
    error_range_m: tuple[float, float] | None = None,
    cost_range: tuple[float, float] | None = None,
    cost_per_work: float = 1.0,
    draws: int = 30,
    seed: int = 0,
    transform: _Transform = "rigid",
    radius_m: float | None = None,
    converged_m: float = 1.0,
    max_iterations: int = 300,
    method: Literal["exhaustive", "bpso"] = "exhaustive",
    particles: int = 30,
    iterations: int = 100,
    threads: int | None = None,
    progress: _Progress = None,
) -> dict[str, Any]: ...

@final
class CorrectedPosition:
    @property
    def x(self) -> float: ...
    @property
    def y(self) -> float: ...
    @property
    def offset_m(self) -> tuple[float, float]: ...
    @property
    def covariance_m2(self) -> _Floats: ...

@final
class FeedbackStep:
    @property
    def before(self) -> CorrectedPosition: ...
    @property
    def after(self) -> CorrectedPosition: ...
    @property
    def nis(self) -> float | None: ...
    @property
    def accepted(self) -> bool: ...

_NavigationStatus: TypeAlias = Literal["acquiring", "tracking", "coasting", "lost"]

@final
class InsModel:
    def __new__(
        cls,
        *,
        gyro_bias_deg_h: float = 0.02,
        gyro_time_constant_s: float = 14400.0,
        gyro_walk_deg_sqrt_h: float = 0.003,
        accelerometer_bias_ug: float = 50.0,
        accelerometer_time_constant_s: float = 14400.0,
        velocity_walk_m_s_sqrt_h: float = 0.01,
        velocity_sigma_m_s: float = 0.2,
        tilt_sigma_mrad: float = 0.05,
        heading_sigma_mrad: float = 1.0,
    ) -> InsModel: ...
    @staticmethod
    def navigation() -> InsModel: ...
    @staticmethod
    def tactical() -> InsModel: ...
    @property
    def gyro_bias_deg_h(self) -> float: ...
    @property
    def gyro_time_constant_s(self) -> float: ...
    @property
    def gyro_walk_deg_sqrt_h(self) -> float: ...
    @property
    def accelerometer_bias_ug(self) -> float: ...
    @property
    def accelerometer_time_constant_s(self) -> float: ...
    @property
    def velocity_walk_m_s_sqrt_h(self) -> float: ...
    @property
    def velocity_sigma_m_s(self) -> float: ...
    @property
    def tilt_sigma_mrad(self) -> float: ...
    @property
    def heading_sigma_mrad(self) -> float: ...
    def to_dict(self) -> dict[str, Any]: ...
    def __eq__(self, other: object, /) -> bool: ...
    def __ne__(self, other: object, /) -> bool: ...
    def __reduce__(self) -> tuple[Any, ...]: ...
    @classmethod
    def _restore(cls, values: dict[str, Any]) -> InsModel: ...

@final
class MatcherPlan:
    def __new__(
        cls,
        *,
        every_s: float = 60.0,
        wide_every_s: float = 600.0,
        samples: int = 40,
        spacing_m: float | None = None,
        tolerance_m: float | None = None,
        max_risk: float = 0.01,
        reach_m: float = 40000.0,
    ) -> MatcherPlan: ...
    @property
    def every_s(self) -> float: ...
    @property
    def wide_every_s(self) -> float: ...
    @property
    def samples(self) -> int: ...
    @property
    def spacing_m(self) -> float | None: ...
    @property
    def tolerance_m(self) -> float | None: ...
    @property
    def max_risk(self) -> float: ...
    @property
    def reach_m(self) -> float: ...
    def to_dict(self) -> dict[str, Any]: ...
    def __eq__(self, other: object, /) -> bool: ...
    def __ne__(self, other: object, /) -> bool: ...
    def __reduce__(self) -> tuple[Any, ...]: ...
    @classmethod
    def _restore(cls, values: dict[str, Any]) -> MatcherPlan: ...

class _NavigatorOptions(TypedDict, total=False):
    position_sigma_m: float | None
    ins: InsModel | None
    start: _Pair | None
    covariance_m2: ArrayLike | None
    reading_sigma: float
    bias_sigma: float
    bias_walk_sqrt_s: float
    batch_m: float | None
    registration: float | None
    nu: float
    linear_m: float | None
    integrity_risk: float
    terms_covariance: ArrayLike | None
    gravity: bool
    matcher: MatcherPlan | Literal["default"] | None
    method: Literal["navigator", "ekf", "rbpf"]
    latitude_deg: float

@final
class NavigatorStep:
    @property
    def x(self) -> float: ...
    @property
    def y(self) -> float: ...
    @property
    def covariance_m2(self) -> _Floats: ...
    @property
    def covariance_filter_m2(self) -> _Floats: ...
    @property
    def velocity_error_m_s(self) -> tuple[float, float]: ...
    @property
    def heading_error_deg(self) -> float: ...
    @property
    def tilt_error_mrad(self) -> tuple[float, float]: ...
    @property
    def bias(self) -> float: ...
    @property
    def status(self) -> _NavigationStatus: ...
    @property
    def reason(self) -> str: ...
    @property
    def outcome(self) -> Literal["waiting", "updated", "downweighted", "off_map"]: ...
    @property
    def nis(self) -> float | None: ...
    @property
    def running_nis(self) -> float: ...
    @property
    def protection_level_m(self) -> float: ...
    @property
    def last_fix(self) -> float | None: ...
    @property
    def resets(self) -> int: ...

@final
class Navigator:
    def __new__(cls, grid: GridMap | MapStack | HarmonicMap, **options: Unpack[_NavigatorOptions]) -> Navigator: ...
    def step(
        self,
        time_s: float,
        x: float,
        y: float,
        velocity_m_s: _Pair | None = None,
        heading_deg: float | None = None,
        value: float | None = None,
        *,
        height_m: float | None = None,
        terms: ArrayLike | None = None,
    ) -> NavigatorStep: ...
    def correct(self, fix: Fix) -> tuple[float, bool]: ...
    def correct_position(self, offset_m: _Pair, covariance_m2: ArrayLike) -> tuple[float, bool]: ...
    def correct_velocity(self, velocity_m_s: _Pair, sigma_m_s: float) -> tuple[float, bool]: ...
    def reset(self, x: float, y: float, covariance_m2: ArrayLike) -> None: ...
    def predict_bound(
        self,
        time_s: ArrayLike,
        x: ArrayLike,
        y: ArrayLike,
        *,
        velocity_m_s: ArrayLike | None = None,
        heading_deg: ArrayLike | None = None,
        height_m: ArrayLike | None = None,
    ) -> _Floats: ...
    @property
    def status(self) -> _NavigationStatus: ...
    @property
    def inputs(self) -> Literal["full", "velocity", "positions"]: ...
    @property
    def steps(self) -> int: ...
    @property
    def state(self) -> _Floats: ...
    @property
    def covariance(self) -> _Floats: ...
    def __reduce__(self) -> tuple[Any, ...]: ...

def _navigate(
    grid: _Field,
    log: dict[str, Any],
    *,
    lag_s: float | None = None,
    progress: _Progress = None,
    **options: Unpack[_NavigatorOptions],
) -> dict[str, Any]: ...
def _displacements_m(geographic: bool, x: ArrayLike, y: ArrayLike, to_x: ArrayLike, to_y: ArrayLike) -> _Floats: ...
def _radii_m(covariances_m2: ArrayLike, probability: float) -> _Floats: ...

@final
class InsFeedback:
    def __new__(
        cls,
        *,
        position_sigma_m: float = 500.0,
        velocity_sigma_m_s: float = 0.5,
        heading_sigma_deg: float = 0.1,
        position_walk_m_sqrt_s: float = 0.1,
        velocity_walk_m_s_sqrt_s: float = 0.001,
        heading_walk_deg_sqrt_s: float = 0.0005,
        velocity_time_constant_s: float | None = None,
        geographic: bool = False,
        gate_probability: float = 0.999,
        position_walk_m: float | None = None,
        velocity_walk_m_s: float | None = None,
        heading_walk_deg: float | None = None,
    ) -> InsFeedback: ...
    def step(
        self,
        time_s: float,
        x: float,
        y: float,
        fix: Fix | None = None,
        *,
        offset_m: ArrayLike | None = None,
        covariance_m2: ArrayLike | None = None,
    ) -> FeedbackStep: ...
    @property
    def velocity_error_m_s(self) -> tuple[float, float]: ...
    @property
    def heading_error_deg(self) -> float: ...
    @property
    def state(self) -> _Floats: ...
    @property
    def covariance(self) -> _Floats: ...
    @property
    def accepted(self) -> int: ...
    @property
    def refused(self) -> int: ...
    def __reduce__(self) -> tuple[Any, ...]: ...

# ---- frames, harmonic models, filters, field navigation

_Earth: TypeAlias = Literal["wgs84", "sphere"]
_Reading: TypeAlias = Literal["vector", "north", "east", "down", "projection", "anomaly", "intensity"]
_Quantity: TypeAlias = Literal["north", "east", "down", "projection", "anomaly", "intensity"]

@final
class LocalFrame:
    def __new__(
        cls,
        latitude_deg: float,
        longitude_deg: float,
        height_m: float = 0.0,
        *,
        earth: _Earth = "wgs84",
        radius_m: float = ...,
    ) -> LocalFrame: ...
    @property
    def latitude_deg(self) -> float: ...
    @property
    def longitude_deg(self) -> float: ...
    @property
    def height_m(self) -> float: ...
    @property
    def earth(self) -> _Earth: ...
    @property
    def radius_m(self) -> float | None: ...
    def forward(
        self, latitude_deg: ArrayLike, longitude_deg: ArrayLike, height_m: ArrayLike | None = None
    ) -> tuple[Any, Any, Any]: ...
    def inverse(self, north_m: ArrayLike, east_m: ArrayLike, down_m: ArrayLike) -> tuple[Any, Any, Any]: ...
    def rotate_to_origin(self, latitude_deg: ArrayLike, longitude_deg: ArrayLike, *vector: ArrayLike) -> Any: ...
    def rotate_from_origin(self, latitude_deg: ArrayLike, longitude_deg: ArrayLike, *vector: ArrayLike) -> Any: ...
    def __eq__(self, other: object, /) -> bool: ...
    def __ne__(self, other: object, /) -> bool: ...
    __hash__: None  # type: ignore[assignment]
    def __reduce__(self) -> tuple[Any, ...]: ...
    @staticmethod
    def _restore(latitude_deg: float, longitude_deg: float, height_m: float, radius_m: float | None) -> LocalFrame: ...

@final
class FieldObservations:
    def __new__(cls) -> FieldObservations: ...
    def add_vector(
        self,
        north_m: ArrayLike,
        east_m: ArrayLike,
        down_m: ArrayLike,
        field: ArrayLike,
        *,
        sigma: ArrayLike | None = None,
    ) -> FieldObservations: ...
    def add_anomaly(
        self,
        north_m: ArrayLike,
        east_m: ArrayLike,
        down_m: ArrayLike,
        values: ArrayLike,
        *,
        main_field: ArrayLike,
        sigma: ArrayLike | None = None,
    ) -> FieldObservations: ...
    def add_intensity(
        self,
        north_m: ArrayLike,
        east_m: ArrayLike,
        down_m: ArrayLike,
        values: ArrayLike,
        *,
        main_field: ArrayLike,
        sigma: ArrayLike | None = None,
    ) -> FieldObservations: ...
    def __len__(self) -> int: ...

class _FitOptions(TypedDict, total=False):
    order: int | Sequence[int]
    period_ratio: float | Sequence[float]
    periods_m: _Pair | None
    ridge: float | Sequence[float]
    truncation: float | None
    damping_m: float | Sequence[float]
    spectrum_power: float | Sequence[float]
    anisotropy: float | Sequence[float]
    misfit: bool
    huber: float | None
    max_iterations: int
    covariance: bool
    frame: LocalFrame | None
    unit: str
    folds: int
    groups: ArrayLike | None
    seed: int

@final
class RectangularHarmonicModel:
    @staticmethod
    def fit(
        north_m: ArrayLike,
        east_m: ArrayLike,
        down_m: ArrayLike,
        field: ArrayLike,
        *,
        main_field: ArrayLike | None = None,
        kind: Literal["anomaly", "intensity"] = "anomaly",
        sigma: ArrayLike | None = None,
        threads: int | None = None,
        progress: _Progress = None,
        **options: Unpack[_FitOptions],
    ) -> RectangularHarmonicModel: ...
    @staticmethod
    def fit_observations(
        observations: FieldObservations,
        *,
        threads: int | None = None,
        progress: _Progress = None,
        **options: Unpack[_FitOptions],
    ) -> RectangularHarmonicModel: ...
    @staticmethod
    def select(
        observations: FieldObservations,
        *,
        threads: int | None = None,
        progress: _Progress = None,
        **options: Unpack[_FitOptions],
    ) -> tuple[dict[str, float], list[dict[str, float]]]: ...
    @staticmethod
    def leave_out(
        observations: FieldObservations,
        *,
        threads: int | None = None,
        progress: _Progress = None,
        **options: Unpack[_FitOptions],
    ) -> dict[str, Any]: ...
    @staticmethod
    def from_coefficients(
        order: int,
        periods_m: _Pair,
        coefficients: ArrayLike,
        *,
        region: ArrayLike,
        frame: LocalFrame | None = None,
        unit: str = "nT",
        covariance: ArrayLike | None = None,
    ) -> RectangularHarmonicModel: ...
    @staticmethod
    def terms(order: int) -> list[tuple[int, int, str, str]]: ...
    def field(
        self, north_m: ArrayLike, east_m: ArrayLike, down_m: ArrayLike, *, extrapolate: bool = False
    ) -> _Floats: ...
    def intensity(
        self,
        north_m: ArrayLike,
        east_m: ArrayLike,
        down_m: ArrayLike,
        *,
        main_field: ArrayLike | None = None,
        extrapolate: bool = False,
    ) -> Any: ...
    def potential(
        self, north_m: ArrayLike, east_m: ArrayLike, down_m: ArrayLike, *, extrapolate: bool = False
    ) -> Any: ...
    def gradient(
        self, north_m: ArrayLike, east_m: ArrayLike, down_m: ArrayLike, *, extrapolate: bool = False
    ) -> _Floats: ...
    def sigma(
        self,
        north_m: ArrayLike,
        east_m: ArrayLike,
        down_m: ArrayLike,
        *,
        direction: ArrayLike | None = None,
        extrapolate: bool = False,
    ) -> Any: ...
    def field_grid(
        self, north_m: ArrayLike, east_m: ArrayLike, down_m: float, *, extrapolate: bool = False
    ) -> _Floats: ...
    def field_geographic(
        self, latitude_deg: ArrayLike, longitude_deg: ArrayLike, height_m: ArrayLike, *, extrapolate: bool = False
    ) -> _Floats: ...
    def to_map(
        self,
        quantity: _Quantity = "down",
        *,
        main_field: ArrayLike | None = None,
        down_m: float | None = None,
        height_m: float | None = None,
    ) -> HarmonicMap: ...
    def sample_to_grid(
        self,
        x: ArrayLike,
        y: ArrayLike,
        *,
        quantity: _Quantity = "down",
        main_field: ArrayLike | None = None,
        down_m: float | None = None,
        height_m: float | None = None,
    ) -> GridMap: ...
    def to_json(self, path: str | PathLike[str] | None = None, *, covariance: bool = True) -> str | None: ...
    @staticmethod
    def from_json(path: str | PathLike[str]) -> RectangularHarmonicModel: ...
    @property
    def order(self) -> int: ...
    @property
    def periods_m(self) -> tuple[float, float]: ...
    @property
    def coefficients(self) -> _Floats: ...
    @property
    def covariance(self) -> _Floats | None: ...
    @property
    def region(self) -> _Floats: ...
    @property
    def frame(self) -> LocalFrame | None: ...
    @property
    def unit(self) -> str: ...
    @property
    def misfit(self) -> tuple[float, float]: ...
    @property
    def summary(self) -> dict[str, Any] | None: ...
    def __eq__(self, other: object, /) -> bool: ...
    def __ne__(self, other: object, /) -> bool: ...
    __hash__: None  # type: ignore[assignment]
    def __reduce__(self) -> tuple[Any, ...]: ...

@final
class HarmonicMap:
    def sample(self, x: ArrayLike, y: ArrayLike) -> Any: ...
    def gradient(self, x: ArrayLike, y: ArrayLike) -> tuple[Any, Any]: ...
    def to_grid(self, x: ArrayLike, y: ArrayLike) -> GridMap: ...
    @property
    def geographic(self) -> bool: ...
    @property
    def spacing(self) -> tuple[float, float]: ...
    @property
    def mean(self) -> float: ...
    @property
    def model(self) -> RectangularHarmonicModel: ...
    @property
    def quantity(self) -> _Quantity: ...
    def __reduce__(self) -> tuple[Any, ...]: ...
    @staticmethod
    def _restore(
        model: RectangularHarmonicModel,
        quantity: str,
        main_field: Sequence[float] | None,
        down_m: float | None,
        height_m: float | None,
    ) -> HarmonicMap: ...

@final
class UnscentedKalmanFilter:
    def __new__(
        cls,
        x: ArrayLike,
        P: ArrayLike,
        *,
        alpha: float = 1.0,
        beta: float = 2.0,
        kappa: float = 0.0,
    ) -> UnscentedKalmanFilter: ...
    def predict(self, f: Callable[[_Floats], ArrayLike] | ArrayLike, Q: ArrayLike) -> None: ...
    def update(
        self,
        z: ArrayLike,
        h: Callable[[_Floats], ArrayLike] | FieldSensor | ArrayLike,
        R: ArrayLike,
        *,
        max_nis: float | None = None,
        gate: float | None = None,
    ) -> bool: ...
    x: Any
    P: Any
    @property
    def alpha(self) -> float: ...
    @property
    def beta(self) -> float: ...
    @property
    def kappa(self) -> float: ...
    @property
    def nis(self) -> float | None: ...
    @property
    def innovation(self) -> _Floats | None: ...
    @property
    def S(self) -> _Floats | None: ...
    @property
    def K(self) -> _Floats | None: ...
    @property
    def regularisations(self) -> int: ...
    def sigma_points(self) -> _Floats: ...
    def __reduce__(self) -> tuple[Any, ...]: ...
    @staticmethod
    def _restore(bytes: bytes) -> UnscentedKalmanFilter: ...

@final
class ExtendedKalmanFilter:
    def __new__(cls, x: ArrayLike, P: ArrayLike) -> ExtendedKalmanFilter: ...
    def predict(self, state: ArrayLike, F: ArrayLike, Q: ArrayLike) -> None: ...
    def update(
        self,
        z: ArrayLike,
        expected: ArrayLike,
        H: ArrayLike,
        R: ArrayLike,
        *,
        max_nis: float | None = None,
        gate: float | None = None,
    ) -> bool: ...
    x: Any
    P: Any
    @property
    def nis(self) -> float | None: ...
    @property
    def innovation(self) -> _Floats | None: ...
    @property
    def regularisations(self) -> int: ...
    def __reduce__(self) -> tuple[Any, ...]: ...
    @staticmethod
    def _restore(bytes: bytes) -> ExtendedKalmanFilter: ...

@final
class FieldSensor:
    def __new__(
        cls,
        source: RectangularHarmonicModel | GridMap | MapStack | HarmonicMap,
        *,
        reading: _Reading | None = None,
        main_field: ArrayLike | None = None,
        down_m: float | None = None,
        height_m: float | None = None,
        interpolation: Literal["bilinear", "bicubic"] = "bicubic",
    ) -> FieldSensor: ...
    def __call__(self, state: ArrayLike) -> _Floats: ...
    def read(self, x: ArrayLike, y: ArrayLike) -> _Floats: ...
    def __len__(self) -> int: ...
    def __reduce__(self) -> tuple[Any, ...]: ...
    @staticmethod
    def _restore(
        source: Any,
        reading: str | None,
        main_field: Sequence[float] | None,
        down_m: float | None,
        height_m: float | None,
        interpolation: str,
    ) -> FieldSensor: ...

@final
class FieldNavigatorStep:
    @property
    def x(self) -> float: ...
    @property
    def y(self) -> float: ...
    @property
    def covariance_m2(self) -> _Floats: ...
    @property
    def outcome(self) -> Literal["updated", "predicted", "rejected", "off_field"]: ...
    @property
    def nis(self) -> float | None: ...
    @property
    def dof(self) -> int: ...
    @property
    def diverged(self) -> bool: ...

@final
class FieldNavigator:
    def __new__(
        cls,
        model: RectangularHarmonicModel | GridMap | MapStack | HarmonicMap | FieldSensor,
        *,
        start: Sequence[float] | _Floats,
        covariance_m2: ArrayLike,
        reading_sigma: ArrayLike,
        gate: float | None = ...,
        position_noise_m2_s: float = 0.01,
        speed_sigma_m_s: float = 0.0,
        speed_walk_m_s_sqrt_s: float = 0.0,
        heading_sigma_deg: float = 0.0,
        heading_walk_deg_sqrt_s: float = 0.0,
        bias_sigma: float = 0.0,
        bias_walk_sqrt_s: float = 0.0,
        field_sigma: bool = True,
        method: Literal["unscented", "extended"] = "unscented",
        alpha: float = 1.0,
        beta: float = 2.0,
        kappa: float = 0.0,
        reading: _Reading | None = None,
        main_field: ArrayLike | None = None,
        down_m: float | None = None,
        height_m: float | None = None,
        interpolation: Literal["bilinear", "bicubic"] = "bicubic",
        speed_walk: float | None = None,
        heading_walk_deg: float | None = None,
        bias_walk: float | None = None,
    ) -> FieldNavigator: ...
    def step(
        self, dt_s: float, speed_m_s: float, course_deg: float, reading: ArrayLike | None = None
    ) -> FieldNavigatorStep: ...
    def bound(self, path: ArrayLike, dt_s: float, speed_m_s: float, course_deg: float) -> _Floats: ...
    @property
    def position(self) -> tuple[float, float]: ...
    @property
    def covariance_m2(self) -> _Floats: ...
    @property
    def x(self) -> _Floats: ...
    @property
    def P(self) -> _Floats: ...
    @property
    def speed_error_m_s(self) -> tuple[float, float] | None: ...
    @property
    def heading_error_deg(self) -> tuple[float, float] | None: ...
    @property
    def bias(self) -> list[tuple[float, float]]: ...
    @property
    def diverged(self) -> bool: ...
    @property
    def nis(self) -> float | None: ...
    @property
    def time_s(self) -> float: ...
    @property
    def n_steps(self) -> int: ...
    @property
    def regularisations(self) -> int: ...
    @property
    def sensor(self) -> FieldSensor: ...
    def __reduce__(self) -> tuple[Any, ...]: ...
    @staticmethod
    def _restore(sensor: FieldSensor, bytes: bytes) -> FieldNavigator: ...

# Calibrated matching.

def match_posterior(
    grid: _Field,
    track: Track,
    *,
    half_width: _Pair | None = None,
    half_width_m: _Pair | None = None,
    step_m: _Pair | None = None,
    sigma: float | None = None,
    min_overlap: float = 0.8,
    step: _Pair | None = None,
    max_candidates: int = 4_000_000,
    tolerance_m: float | None = None,
    max_risk: float = 0.01,
    min_goodness: float = 0.001,
    misfit_threshold: float | None = None,
    drift_sigma_m: float = 0.0,
    heading_sigma_deg: float = 0.0,
    scale_sigma: float = 0.0,
    position_sigma_m: float = 0.0,
    bias_sigma: float | None = None,
    leg_bias_sigma: float = 0.0,
    bias_drift_sigma: float = 0.0,
    height_sigma_m: float = 0.0,
    nu: float | None = None,
    interpolation: Literal["bilinear", "bicubic"] = "bilinear",
    search: SearchBox | None = None,
    prior: InsPrior | None = None,
    accept: Acceptance | None = None,
    surface: bool = False,
    channels: Sequence[_Channel] | None = None,
    threads: int | None = None,
    more: Sequence[_Channel] | None = None,
) -> Fix: ...
def match_posterior_many(
    grid: _Field,
    tracks: Sequence[Track],
    *,
    half_width: _Pair | None = None,
    half_width_m: _Pair | None = None,
    step_m: _Pair | None = None,
    sigma: float | None = None,
    min_overlap: float = 0.8,
    step: _Pair | None = None,
    max_candidates: int = 4_000_000,
    tolerance_m: float | None = None,
    max_risk: float = 0.01,
    min_goodness: float = 0.001,
    misfit_threshold: float | None = None,
    drift_sigma_m: float = 0.0,
    heading_sigma_deg: float = 0.0,
    scale_sigma: float = 0.0,
    position_sigma_m: float = 0.0,
    bias_sigma: float | None = None,
    leg_bias_sigma: float = 0.0,
    bias_drift_sigma: float = 0.0,
    height_sigma_m: float = 0.0,
    nu: float | None = None,
    interpolation: Literal["bilinear", "bicubic"] = "bilinear",
    search: SearchBox | None = None,
    prior: InsPrior | None = None,
    accept: Acceptance | None = None,
    streaming: bool = False,
    threads: int | None = None,
    progress: _Progress = None,
) -> list[Fix]: ...
def predict_many(
    grid: _Field,
    tracks: Sequence[Track],
    *,
    half_width: _Pair | None = None,
    half_width_m: _Pair | None = None,
    step_m: _Pair | None = None,
    sigma: float | None = None,
    min_overlap: float = 0.8,
    step: _Pair | None = None,
    max_candidates: int = 4_000_000,
    tolerance_m: float | None = None,
    max_risk: float = 0.01,
    min_goodness: float = 0.001,
    misfit_threshold: float | None = None,
    drift_sigma_m: float = 0.0,
    heading_sigma_deg: float = 0.0,
    scale_sigma: float = 0.0,
    position_sigma_m: float = 0.0,
    bias_sigma: float | None = None,
    leg_bias_sigma: float = 0.0,
    bias_drift_sigma: float = 0.0,
    height_sigma_m: float = 0.0,
    nu: float | None = None,
    interpolation: Literal["bilinear", "bicubic"] = "bilinear",
    search: SearchBox | None = None,
    prior: InsPrior | None = None,
    accept: Acceptance | None = None,
    flights: int = 20,
    seed: int = 0,
    threads: int | None = None,
    progress: _Progress = None,
) -> list[Prediction | None]: ...

@final
class SearchBox:
    def __new__(
        cls,
        *,
        half_width: _Pair | None = None,
        half_width_m: _Pair | None = None,
        step_m: _Pair | None = None,
        step: _Pair | None = None,
        max_candidates: int = 4_000_000,
    ) -> SearchBox: ...
    @property
    def half_width(self) -> tuple[float, float] | None: ...
    @property
    def half_width_m(self) -> tuple[float, float] | None: ...
    @property
    def step_m(self) -> tuple[float, float] | None: ...
    @property
    def step(self) -> tuple[float, float] | None: ...
    @property
    def max_candidates(self) -> int: ...
    def to_dict(self) -> dict[str, Any]: ...
    def __eq__(self, other: object, /) -> bool: ...
    def __ne__(self, other: object, /) -> bool: ...
    def __reduce__(self) -> tuple[Any, ...]: ...
    @classmethod
    def _restore(cls, values: dict[str, Any]) -> SearchBox: ...

@final
class InsPrior:
    def __new__(
        cls,
        *,
        drift_sigma_m: float = 0.0,
        heading_sigma_deg: float = 0.0,
        scale_sigma: float = 0.0,
        position_sigma_m: float = 0.0,
    ) -> InsPrior: ...
    @property
    def drift_sigma_m(self) -> float: ...
    @property
    def heading_sigma_deg(self) -> float: ...
    @property
    def scale_sigma(self) -> float: ...
    @property
    def position_sigma_m(self) -> float: ...
    def to_dict(self) -> dict[str, Any]: ...
    def __eq__(self, other: object, /) -> bool: ...
    def __ne__(self, other: object, /) -> bool: ...
    def __reduce__(self) -> tuple[Any, ...]: ...
    @classmethod
    def _restore(cls, values: dict[str, Any]) -> InsPrior: ...

@final
class Acceptance:
    def __new__(
        cls,
        *,
        tolerance_m: float | None = None,
        max_risk: float = 0.01,
        min_goodness: float = 0.001,
        misfit_threshold: float | None = None,
        min_overlap: float = 0.8,
    ) -> Acceptance: ...
    @property
    def tolerance_m(self) -> float | None: ...
    @property
    def max_risk(self) -> float: ...
    @property
    def min_goodness(self) -> float: ...
    @property
    def misfit_threshold(self) -> float | None: ...
    @property
    def min_overlap(self) -> float: ...
    def to_dict(self) -> dict[str, Any]: ...
    def __eq__(self, other: object, /) -> bool: ...
    def __ne__(self, other: object, /) -> bool: ...
    def __reduce__(self) -> tuple[Any, ...]: ...
    @classmethod
    def _restore(cls, values: dict[str, Any]) -> Acceptance: ...

@final
class PosteriorStep:
    @property
    def status(self) -> _Status: ...
    @property
    def n_feasible(self) -> int: ...
    @property
    def extent(self) -> tuple[float, float]: ...
    @property
    def risk(self) -> float: ...
    @property
    def fix(self) -> Fix | None: ...

@final
class PosteriorMatcher:
    def __new__(
        cls,
        grid: _Field,
        *,
        half_width: _Pair | None = None,
        half_width_m: _Pair | None = None,
        step_m: _Pair | None = None,
        sigma: float | None = None,
        min_overlap: float = 0.8,
        step: _Pair | None = None,
        max_candidates: int = 4_000_000,
        tolerance_m: float | None = None,
        max_risk: float = 0.01,
        min_goodness: float = 0.001,
        misfit_threshold: float | None = None,
        drift_sigma_m: float = 0.0,
        heading_sigma_deg: float = 0.0,
        scale_sigma: float = 0.0,
        position_sigma_m: float = 0.0,
        bias_sigma: float | None = None,
        leg_bias_sigma: float = 0.0,
        bias_drift_sigma: float = 0.0,
        height_sigma_m: float = 0.0,
        nu: float | None = None,
        interpolation: Literal["bilinear", "bicubic"] = "bilinear",
        search: SearchBox | None = None,
        prior: InsPrior | None = None,
        accept: Acceptance | None = None,
        max_samples: int = 200,
    ) -> PosteriorMatcher: ...
    def update(self, x: float, y: float, value: float, height_m: float | None = None) -> PosteriorStep: ...
    def run(self, track: Track) -> Fix: ...
    def fix(self) -> Fix: ...
    def reset(self) -> None: ...
    @property
    def n_samples(self) -> int: ...
    @property
    def n_feasible(self) -> int: ...
    def __reduce__(self) -> tuple[Any, ...]: ...
    @staticmethod
    def _restore(grid: _Field, state: bytes) -> PosteriorMatcher: ...

@final
class Prediction:
    @property
    def bound_m2(self) -> _Floats: ...
    @property
    def covariance_m2(self) -> _Floats: ...
    @property
    def samples_to_fix(self) -> int | None: ...
    @property
    def fix_probability(self) -> float: ...
    @property
    def wrong_share(self) -> float: ...
    @property
    def flights(self) -> int: ...

# Behind geomag.survey.

def _minimum_curvature(
    x: ArrayLike,
    y: ArrayLike,
    values: ArrayLike,
    x_axis: tuple[float, float, int],
    y_axis: tuple[float, float, int],
    *,
    aspect: float,
    weight: float = ...,
    reach: float = ...,
    sweeps: int = 120,
    progress: _Progress = None,
) -> _Floats: ...
def _distances_to_data(
    x: ArrayLike,
    y: ArrayLike,
    x_axis: tuple[float, float, int],
    y_axis: tuple[float, float, int],
    *,
    cell_m: tuple[float, float],
) -> tuple[_Floats, _Floats]: ...

@final
class MainFieldModel:
    def __new__(cls, epochs: ArrayLike, g: ArrayLike, h: ArrayLike, *, degree: int) -> MainFieldModel: ...
    @property
    def degree(self) -> int: ...
    @property
    def epochs(self) -> _Floats: ...
    @property
    def g(self) -> _Floats: ...
    @property
    def h(self) -> _Floats: ...
    def field(
        self,
        longitude: ArrayLike,
        latitude: ArrayLike,
        height_m: ArrayLike,
        year: ArrayLike,
        *,
        progress: _Progress = None,
    ) -> _Floats: ...
    @staticmethod
    def _restore(epochs: ArrayLike, g: ArrayLike, h: ArrayLike, degree: int) -> MainFieldModel: ...
    def __eq__(self, other: object, /) -> bool: ...
    def __reduce__(self) -> tuple[Any, tuple[Any, ...]]: ...

def tolles_lawson_terms(field_nt: ArrayLike, time_s: ArrayLike | None, max_gap_s: float) -> _Floats: ...

@final
class Compensator:
    def __new__(cls, coefficients: ArrayLike, *, max_gap_s: float = 0.25) -> Compensator: ...
    def update(self, time_s: float, field_nt: ArrayLike, reading_nt: float) -> float: ...
    @property
    def coefficients(self) -> _Floats: ...
    @property
    def max_gap_s(self) -> float: ...
    @staticmethod
    def _restore(bytes: bytes) -> Compensator: ...
    def __reduce__(self) -> tuple[Any, tuple[Any, ...]]: ...
