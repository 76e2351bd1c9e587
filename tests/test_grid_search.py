"""Grid search against a naive oracle for each measure and option, and its contracts."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from fields import rough
from oracles import lattice, score, shifted

import geomag

CRITERIA = ["msd", "mad", "prod", "ncc", "hausdorff"]


def case(seed, *, n=12, holes=0.0, dtype="float64"):
    rng = np.random.default_rng(seed)
    ny, nx = 30, 34
    values = (500 + rough(rng, ny, nx)).astype(dtype)
    if holes:
        values[rng.random((ny, nx)) < holes] = np.nan
    x, y = 100.0 + 50 * np.arange(nx), -300.0 + 40 * np.arange(ny)
    truth = np.column_stack([rng.uniform(500, 700) + 55 * np.arange(n), rng.uniform(100, 200) + 31 * np.arange(n)])
    offset = rng.uniform(-150, 150, 2)
    grid = geomag.GridMap(values, x, y)
    readings = np.nan_to_num(grid.sample(truth[:, 0], truth[:, 1]), nan=500.0) + rng.normal(0, 3, n)
    indicated = truth - offset
    return rng, grid, values, x, y, geomag.Track(indicated[:, 0], indicated[:, 1], readings), offset


def oracle_surface(values, x, y, track, ox, oy, criterion, *, min_overlap=0.8, w=None, **options):
    m = shifted(values, x, y, track.x, track.y, ox, oy)
    s = track.distance_m()
    out = np.full(m.shape[:2], np.nan)
    for r, c in itertools.product(range(len(oy)), range(len(ox))):
        known = ~np.isnan(m[r, c])
        if known.sum() < max(np.ceil(min_overlap * len(known) - 1e-9), 1):
            continue
        own_w = None if w is None else w[known]
        out[r, c] = score(
            criterion, track.values[known], m[r, c, known], np.nanmean(values), w=own_w, s=s[known], **options
        )
    return out


@pytest.mark.parametrize("criterion", CRITERIA)
@pytest.mark.parametrize("step", [None, (25.0, 10.0), (37.0, 40.0)], ids=["spacing", "fractions", "odd"])
@pytest.mark.parametrize("seed", range(4))
def test_surface_equals_the_oracle(criterion, step, seed):
    _, grid, values, x, y, track, _ = case(seed, holes=0.01 if seed == 3 else 0.0)
    half = (310.0, 250.0)
    ox, oy = lattice(half[0], step[0] if step else 50.0), lattice(half[1], step[1] if step else 40.0)
    options = {"length_scale_m": 60.0, "value_scale": 20.0} if criterion == "hausdorff" else {}
    expected = oracle_surface(values, x, y, track, ox, oy, criterion, scales=(60.0, 20.0))
    fix = geomag.match_grid(grid, track, criterion, half_width=half, step=step, surface=True, **options)
    np.testing.assert_allclose(fix.surface, expected, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(fix.surface_axes[0], ox, atol=1e-9)
    np.testing.assert_allclose(fix.surface_axes[1], oy, atol=1e-9)
    best = np.nanmax(expected) if criterion in ("prod", "ncc") else np.nanmin(expected)
    assert fix.score == pytest.approx(best, rel=1e-9)


@pytest.mark.parametrize(
    ("criterion", "options", "oracle"),
    [
        ("msd", {"remove_mean": True}, {"remove_mean": True}),
        ("mad", {"remove_mean": True}, {"remove_mean": True}),
        ("hausdorff", {"fraction": 0.7}, {"fraction": 0.7}),
        (
            "msd",
            {"robust": "huber", "robust_scale": 8.0},
            {"loss": lambda r: np.where(np.abs(r) <= 8, r**2, 8 * (2 * np.abs(r) - 8))},
        ),
        (
            "msd",
            {"robust": "student_t", "robust_scale": 5.0, "nu": 3.0, "remove_mean": True},
            {"loss": lambda r: 4 * np.log1p(r**2 / 75), "remove_mean": True},
        ),
    ],
    ids=["msd-mean", "mad-median", "partial-hausdorff", "huber", "student"],
)
@pytest.mark.parametrize("seed", range(3))
def test_options_equal_the_oracle(criterion, options, oracle, seed):
    _, grid, values, x, y, track, _ = case(20 + seed, holes=0.01 if seed == 2 else 0.0)
    half = (200.0, 160.0)
    scales = {"length_scale_m": 60.0, "value_scale": 20.0} if criterion == "hausdorff" else {}
    expected = oracle_surface(
        values, x, y, track, lattice(200, 50), lattice(160, 40), criterion, scales=(60.0, 20.0), **oracle
    )
    fix = geomag.match_grid(grid, track, criterion, half_width=half, surface=True, **options, **scales)
    np.testing.assert_allclose(fix.surface, expected, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("criterion", ["msd", "mad", "prod", "ncc"])
@pytest.mark.parametrize("remove_mean", [False, True])
def test_weights_equal_the_oracle(criterion, remove_mean):
    if remove_mean and criterion not in ("msd", "mad"):
        pytest.skip("these measures take no constant out")
    rng, grid, values, x, y, track, _ = case(31, holes=0.005)
    w = rng.uniform(0, 2, len(track))
    expected = oracle_surface(
        values, x, y, track, lattice(200, 50), lattice(160, 40), criterion, w=w, remove_mean=remove_mean
    )
    fix = geomag.match_grid(
        grid, track, criterion, half_width=(200.0, 160.0), surface=True, weights=w, remove_mean=remove_mean
    )
    np.testing.assert_allclose(fix.surface, expected, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("criterion", CRITERIA)
def test_track_near_the_border_scores_what_it_has(criterion):
    """Candidates that leave the map are scored on at least min_overlap of the samples, or not at all."""
    _, grid, values, x, y, track, _ = case(40)
    west = geomag.Track(track.x - 620.0, track.y, track.values)
    ox, oy = lattice(300, 50), lattice(160, 40)
    scales = {"length_scale_m": 60.0, "value_scale": 20.0} if criterion == "hausdorff" else {}
    expected = oracle_surface(values, x, y, west, ox, oy, criterion, scales=(60.0, 20.0), min_overlap=0.6)
    assert np.isnan(expected).any()
    assert np.isfinite(expected).any()
    fix = geomag.match_grid(grid, west, criterion, half_width=(300, 160), surface=True, min_overlap=0.6, **scales)
    np.testing.assert_allclose(fix.surface, expected, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("criterion", CRITERIA)
def test_finds_the_offset_below_the_lattice_step(criterion):
    errors = []
    for seed in range(100, 112):
        _, grid, _, _, _, track, offset = case(seed, n=14)
        fix = geomag.match_grid(grid, track, criterion, half_width=(400, 400), sigma=3.0)
        errors.append(np.hypot(*(np.array(fix.offset) - offset)))
    # Product correlation is drawn to large values wherever they are; the others must be within half a cell.
    limit = 250.0 if criterion == "prod" else 25.0
    assert np.median(errors) < limit


def test_heading_and_scale_are_found():
    _rng, grid, _, _, _, _, _ = case(50)
    n = 16
    truth = np.column_stack([600 + 60 * np.arange(n), 100 + 35 * np.arange(n)])
    readings = grid.sample(truth[:, 0], truth[:, 1])
    # Indicated: turned 6 degrees anticlockwise and 4 % short about the newest point, then displaced.
    angle, stretch = np.deg2rad(6.0), 1 / 1.04
    d = truth - truth[-1]
    back = np.column_stack(
        [d[:, 0] * np.cos(angle) - d[:, 1] * np.sin(angle), d[:, 0] * np.sin(angle) + d[:, 1] * np.cos(angle)]
    )
    indicated = truth[-1] + stretch * back - [70.0, -55.0]
    track = geomag.Track(indicated[:, 0], indicated[:, 1], readings)
    fix = geomag.match_grid(
        grid,
        track,
        half_width=(200, 200),
        step=(12.5, 10.0),
        heading_deg=np.arange(-10, 11, 2.0),
        scale=[0.96, 1.0, 1.04],
    )
    assert fix.heading_deg == 6.0
    assert fix.scale == 1.04
    assert fix.offset == pytest.approx((70.0, -55.0), abs=4.0)
    np.testing.assert_allclose(fix.track, truth, atol=6.0)


def test_same_bits_for_any_number_of_threads():
    _, grid, _, _, _, track, _ = case(60)
    surfaces = [
        geomag.match_grid(grid, track, half_width=(400, 400), step=(12.5, 10), surface=True, threads=t).surface
        for t in (1, 2, 3, None)
    ]
    for s in surfaces[1:]:
        assert s.tobytes() == surfaces[0].tobytes()


@pytest.mark.parametrize("criterion", ["msd", "mad", "ncc", "prod"])
def test_float32_agrees_with_float64(criterion):
    _, grid, values, x, y, track, _ = case(61)
    small = geomag.GridMap(values.astype("float32"), x, y)
    options = {"half_width": (400, 400), "surface": True}
    a, b = geomag.match_grid(small, track, criterion, **options), geomag.match_grid(grid, track, criterion, **options)
    np.testing.assert_allclose(a.surface, b.surface, rtol=2e-4, atol=2e-3)
    assert a.offset == pytest.approx(b.offset, abs=0.1)


def test_descending_axes_and_strided_views_change_nothing():
    _, grid, values, x, y, track, _ = case(62)
    plain = geomag.match_grid(grid, track, half_width=300)
    wide = np.zeros((60, 68))
    wide[::2, ::2] = values
    for other in (
        geomag.GridMap(values[::-1], x, y[::-1]),
        geomag.GridMap(values[:, ::-1], x[::-1], y),
        geomag.GridMap(values[::-1, ::-1], x[::-1], y[::-1]),
        geomag.GridMap(wide[::2, ::2], x, y),
        geomag.GridMap(np.asfortranarray(values), x, y),
    ):
        assert geomag.match_grid(other, track, half_width=300).offset == plain.offset


def test_covariance_is_consistent_with_the_errors():
    """Normalised squared errors of refined fixes over seeds, noise known, against chi-square with two degrees."""
    nees = []
    for seed in range(300):
        rng = np.random.default_rng(1000 + seed)
        values = rough(rng, 40, 40, smooth=4.0)
        axis = 50.0 * np.arange(40)
        grid = geomag.GridMap(values, axis, axis)
        n = 25
        truth = np.column_stack([500 + 40 * np.arange(n), 700 + 25 * np.arange(n)])
        offset = rng.uniform(-60, 60, 2)
        readings = grid.sample(truth[:, 0], truth[:, 1]) + rng.normal(0, 8.0, n)
        track = geomag.Track(truth[:, 0] - offset[0], truth[:, 1] - offset[1], readings)
        fix = geomag.match_grid(grid, track, half_width=200, step=12.5, sigma=8.0)
        error = np.array(fix.offset_m) - offset
        nees.append(error @ np.linalg.solve(fix.covariance_m2, error))
    # Mean of 300 chi-square(2) draws: 2 +- 0.35 at three standard deviations; the map is bilinear, its slope uneven.
    assert 1.5 < np.mean(nees) < 2.6


def test_edge_ambiguous_and_uninformative_are_no_fixes():
    _, grid, values, x, y, track, offset = case(70)
    far = geomag.Track(track.x + offset[0] - 130.0, track.y + offset[1], track.values)
    edge = geomag.match_grid(grid, far, half_width=(100, 100), step=10)
    assert edge.status == "at_edge"
    assert not edge.ok
    flat = geomag.GridMap(np.full_like(values, 7.0), x, y)
    nothing = geomag.match_grid(flat, geomag.Track(track.x, track.y, np.full(len(track), 7.0)), half_width=200)
    assert not nothing.ok
    periodic = geomag.GridMap(100 * np.sin(2 * np.pi * x / 250)[None, :] + 50 * np.cos(y / 90)[:, None], x, y)
    k = np.arange(15)
    sample = geomag.Track(500 + 40 * k, 100 + 30 * k, periodic.sample(500 + 40 * k, 100 + 30 * k))
    two = geomag.match_grid(periodic, sample, half_width=(400, 200))
    assert two.status == "ambiguous"


def test_a_hole_is_a_status():
    _, _, values, x, y, track, _ = case(71)
    hollow = values.copy()
    hollow[2:-2, 2:-2] = np.nan
    fix = geomag.match_grid(geomag.GridMap(hollow, x, y), track, half_width=100, surface=True)
    assert fix.status == "uninformative"
    assert np.isnan(fix.surface).all()


@pytest.mark.parametrize(
    ("options", "match"),
    [
        ({"criterion": "cosine"}, "criterion"),
        ({"half_width": -1}, "half_width"),
        ({"half_width": 0}, "half_width"),  # one candidate is neither ambiguous nor at an edge, wherever it is
        ({"step": 0}, "step"),
        ({"heading_deg": []}, "heading_deg"),
        ({"heading_deg": [np.nan]}, "heading_deg"),
        ({"scale": [0.0]}, "scale"),
        ({"weights": [1.0, 2.0]}, "weights"),
        ({"weights": -np.ones(12)}, "weights"),
        ({"weights": np.zeros(12)}, "weights"),
        ({"robust": "huber"}, "robust_scale"),
        ({"robust": "huber", "robust_scale": -1.0}, "robust_scale"),
        ({"criterion": "prod", "remove_mean": True}, "remove_mean"),
        ({"criterion": "mad", "robust": "huber", "robust_scale": 1.0}, "robust"),
        ({"criterion": "hausdorff", "fraction": 0.0}, "fraction"),
        ({"min_overlap": 0.0}, "min_overlap"),
        ({"sigma": 0.0}, "sigma"),
        ({"interpolation": "nearest"}, "interpolation"),
        ({"pivot": "oldest"}, "pivot"),
        ({"threads": 0}, "threads"),
        ({"progress": 3.5}, "progress"),
    ],
)
def test_bad_options_say_what_is_wrong(options, match):
    _, grid, _, _, _, track, _ = case(72)
    with pytest.raises(geomag.InvalidInputError, match=match):
        geomag.match_grid(grid, track, **{"half_width": 100, **options})


def test_one_sample():
    _, grid, _, _, _, track, _ = case(73)
    assert not geomag.match_grid(grid, track[:1], half_width=200).ok
    for options in ({"criterion": "ncc"}, {"remove_mean": True}):
        with pytest.raises(geomag.TooFewSamplesError, match="needed at least 2 samples, got 1"):
            geomag.match_grid(grid, track[:1], half_width=200, **options)


def test_a_lattice_of_a_billion_is_refused():
    _, grid, _, _, _, track, _ = case(74)
    with pytest.raises(geomag.CandidateLimitError, match="candidates") as caught:
        geomag.match_grid(grid, track, half_width=16_000, step=1.0)
    assert isinstance(caught.value, ValueError)
    with pytest.raises(geomag.CandidateLimitError):
        geomag.match_grid(grid, track, half_width=1e300, step=1e-300)


def test_progress_is_called_and_may_stop_the_search():
    _, grid, _, _, _, track, _ = case(75)
    seen = []
    geomag.match_grid(grid, track, half_width=400, step=1.0, progress=lambda done, total: seen.append((done, total)))
    assert seen[-1][0] == seen[-1][1] > 0

    class StopError(Exception):
        pass

    def stop(done, total):
        raise StopError

    with pytest.raises(StopError):
        geomag.match_grid(grid, track, half_width=3000, step=1.0, progress=stop)


def test_bicubic_surface_equals_sampling_on_its_own():
    _, grid, _, _, _, track, _ = case(76)
    fix = geomag.match_grid(grid, track, half_width=(100, 80), interpolation="bicubic", surface=True)
    ox, oy = fix.surface_axes
    for r, b in enumerate(oy):
        for c, a in enumerate(ox):
            m = grid.sample(track.x + a, track.y + b, interpolation="bicubic")
            assert fix.surface[r, c] == pytest.approx(np.mean((track.values - m) ** 2), rel=1e-9)


def smooth():
    """A smooth map and a straight track on it, indicated 2 west and 3 north of the truth."""
    x, k = np.arange(60.0), np.arange(20.0)
    grid = geomag.GridMap(90 * np.sin(x / 4)[None, :] * np.cos(x / 5)[:, None], x, x)
    return grid, geomag.Track(18.3 + k, 25.6 + 0.7 * k, grid.sample(20.3 + k, 22.6 + 0.7 * k))


def straight(heading, values):
    k = np.arange(len(values))
    return geomag.Track(30 + 0.5 * np.cos(heading) * k, 30 + 0.5 * np.sin(heading) * k, values)


@pytest.mark.parametrize("level", [-3.1, 50_000.1])
def test_constant_readings_correlate_with_nothing(level):
    grid, _ = smooth()
    weights = np.linspace(0.5, 1.7, 18)
    for heading in np.random.default_rng(29).uniform(0, 6.3, 30):
        track = straight(heading, np.full(18, level))
        for given in (None, weights):
            fix = geomag.match_grid(grid, track, "ncc", half_width=6, weights=given)
            assert fix.status == "uninformative"
            assert np.isnan(fix.score)


@pytest.mark.parametrize("dtype", ["float64", "float32"])
def test_a_constant_map_correlates_with_nothing(dtype):
    x = np.arange(60.0)
    grid = geomag.GridMap(np.full((60, 60), 50_000.1, dtype), x, x)
    for seed in range(20):
        rng = np.random.default_rng(seed)
        track = straight(rng.uniform(0, 6.3), 50_000 + rng.normal(0, 20, 18))
        assert geomag.match_grid(grid, track, "ncc", half_width=6).status == "uninformative"


def assert_same_answer(fix, expected):
    for name, value in expected.to_dict().items():
        if isinstance(value, (float, tuple)):
            np.testing.assert_allclose(getattr(fix, name), value, rtol=1e-9, atol=1e-9, err_msg=name)
        else:
            np.testing.assert_equal(getattr(fix, name), value, err_msg=name)


@pytest.mark.parametrize(
    "options",
    [
        {"robust": "huber", "robust_scale": 1.0, "remove_mean": True},
        {"remove_mean": True},
        {"criterion": "mad", "remove_mean": True},
        {"criterion": "mad"},
        {"criterion": "ncc"},
        {"criterion": "prod"},
        {"criterion": "hausdorff"},
        {"sigma": 1.0},
    ],
    ids=str,
)
def test_a_sample_of_weight_zero_is_as_if_it_were_not_there(options):
    grid, track = smooth()
    values, weights = track.values.copy(), np.ones(20)
    values[:11] += 500
    weights[:11] = 0
    fix = geomag.match_grid(grid, geomag.Track(track.x, track.y, values), half_width=5, weights=weights, **options)
    good = geomag.Track(track.x[11:], track.y[11:], values[11:])
    assert_same_answer(fix, geomag.match_grid(grid, good, half_width=5, **options))
    assert fix.n_samples == 9
    assert len(fix.track) == 20


def test_samples_of_weight_zero_do_not_count_as_overlap():
    grid, track = smooth()
    away = geomag.Track(np.r_[track.x - 400, track.x], np.r_[track.y, track.y], np.r_[track.values, track.values], None)
    weights = np.r_[np.zeros(20), np.ones(20)]
    fix = geomag.match_grid(grid, away, half_width=5, weights=weights)
    assert_same_answer(fix, geomag.match_grid(grid, track, half_width=5))


def test_one_weight_is_too_few_about_a_free_mean():
    grid, track = smooth()
    weights = np.zeros(20)
    weights[9] = 1
    with pytest.raises(geomag.TooFewSamplesError, match="needed at least 2 samples, got 1"):
        geomag.match_grid(grid, track, half_width=5, weights=weights, remove_mean=True)


def test_a_robust_constant_follows_the_weights():
    grid, track = smooth()
    values, weights = track.values.copy(), np.full(20, 1.0)
    values[:11] += 500
    weights[:11] = 1e-6
    options = {"robust": "huber", "robust_scale": 1.0, "remove_mean": True}
    fix = geomag.match_grid(grid, geomag.Track(track.x, track.y, values), half_width=5, weights=weights, **options)
    np.testing.assert_allclose(fix.offset, (2, -3), atol=0.2)


def test_a_track_off_the_map_is_lost():
    grid, track = smooth()
    away = geomag.Track(track.x + 500, track.y, track.values)
    for criterion in CRITERIA:
        fix = geomag.match_grid(grid, away, criterion, half_width=5, surface=True)
        assert fix.status == "lost"
        assert not fix.ok
        assert np.isnan([fix.x, fix.y, *fix.offset, *fix.offset_m, fix.score, fix.runner_up]).all()
        assert np.isnan(fix.surface).all()


@pytest.mark.parametrize("threads", [0, 513, 10**6])
def test_threads_have_a_limit(threads):
    grid, track = smooth()
    with pytest.raises(geomag.InvalidInputError, match="threads: needed 1 to 512"):
        geomag.match_grid(grid, track, half_width=5, threads=threads)


@pytest.mark.parametrize(
    "option",
    [
        {"fraction": -3.0},
        {"fraction": np.nan},
        {"length_scale_m": -3.0},
        {"value_scale": 0.0},
        {"robust_scale": -1.0},
        {"nu": np.nan},
    ],
    ids=str,
)
def test_nonsense_is_refused_where_another_criterion_would_use_it(option):
    grid, track = smooth()
    with pytest.raises(geomag.InvalidInputError, match=next(iter(option))):
        geomag.match_grid(grid, track, "mad", half_width=5, **option)


@pytest.mark.parametrize(("half_width", "limit"), [(1e5, 2**40), (1e9, 2**63)])
def test_no_raised_limit_takes_memory_without_bound(half_width, limit):
    grid, track = smooth()
    with pytest.raises(geomag.CandidateLimitError, match="the limit is 2147483648"):
        geomag.match_grid(grid, track, half_width=half_width, max_candidates=limit)
    with pytest.raises(geomag.CandidateLimitError, match="the limit is 2147483648"):
        geomag.Iema(grid, sigma=1.0, half_width=half_width, max_candidates=limit)


def coarse_map(seed):
    """A right map as coarse as its features: cells of 400 m, features of 1 km."""
    rng = np.random.default_rng(seed)
    x = 400.0 * np.arange(60)
    return geomag.GridMap(rough(rng, 60, 60, smooth=1.6), x, x)


def test_the_covariance_is_that_of_the_refined_minimum():
    """On a coarse map a quadratic through scores a cell apart misses the minimum by far more than its covariance says."""
    squares = []
    for seed in range(60):
        grid, rng = coarse_map(seed % 6), np.random.default_rng(1000 + seed)
        k = np.arange(40.0)
        x, y = 6000 + 220 * k, 7000 + 170 * k
        offset = rng.uniform(-1200, 1200, 2)
        track = geomag.Track(x - offset[0], y - offset[1], grid.sample(x, y) + rng.normal(0, 1.0, len(k)))
        fix = geomag.match_grid(grid, track, half_width=2000.0, sigma=1.0)
        if fix.ok:
            error = np.array(fix.offset_m) - offset
            squares.append(error @ np.linalg.solve(fix.covariance_m2, error))
    assert len(squares) >= 40
    # Chi-square with two degrees of freedom: 0.3 % beyond 11.8.
    assert np.sum(np.array(squares) > 11.8) <= 2
    assert 1.2 < np.mean(squares) < 3.0


@pytest.mark.parametrize("pivot", ["newest", "centroid"])
def test_whatever_turns_the_track_the_covariance_is_of_its_newest_point(pivot):
    squares = []
    x = np.arange(0.0, 9000.0, 50.0)
    for seed in range(50):
        rng = np.random.default_rng(seed)
        grid = geomag.GridMap(rough(rng, 180, 180, smooth=6.0), x, x)
        k = np.arange(60.0)
        px, py = 2500 + 60 * k, 3000 + 40 * k
        turn, offset = np.radians(rng.uniform(-2.0, 2.0)), rng.uniform(-150, 150, 2)
        # Indicated: turned back about the newest true point, and shifted.
        dx, dy = px - px[-1], py - py[-1]
        ix = px[-1] + dx * np.cos(turn) - dy * np.sin(turn) - offset[0]
        iy = py[-1] + dx * np.sin(turn) + dy * np.cos(turn) - offset[1]
        track = geomag.Track(ix, iy, grid.sample(px, py) + rng.normal(0, 2.0, len(k)))
        fix = geomag.match_grid(
            grid, track, half_width=300.0, sigma=2.0, heading_deg=np.linspace(-3, 3, 61), pivot=pivot
        )
        if fix.ok:
            error = np.array([fix.x - px[-1], fix.y - py[-1]])
            squares.append(error @ np.linalg.solve(fix.covariance_m2, error))
    assert len(squares) >= 35
    assert 1.2 < np.mean(squares) < 3.0


def test_without_refinement_the_covariance_holds_the_step():
    grid = coarse_map(1)
    k = np.arange(40.0)
    track = geomag.Track(6000 + 220 * k - 130, 7000 + 170 * k, grid.sample(6000 + 220 * k, 7000 + 170 * k))
    fix = geomag.match_grid(grid, track, half_width=800.0, sigma=50.0, refine=False)
    assert np.diag(fix.covariance_m2).min() > 400.0**2 / 12
