"""Continuation of maps: closed forms, harmonica, the values of another package, errors that come along."""

from __future__ import annotations

import itertools
import pickle

import numpy as np
import pytest

import geomag
from geomag import continuation


def sources(height_m: float, order: int = 0, n: int = 121, cell: float = 500.0):
    """Vertical attraction of three point masses (and its derivative upward), closed form, on a grid at a height."""
    axis = (np.arange(n) - n // 2) * cell
    x, y = np.meshgrid(axis, axis)
    out = np.zeros_like(x)
    for px, py, depth, mass in ((-4e3, 3e3, 3e3, 1e9), (6e3, -5e3, 4e3, -1.6e9), (2e3, 9e3, 2.5e3, 0.5e9)):
        z = height_m + depth
        r = np.sqrt((x - px) ** 2 + (y - py) ** 2 + z**2)
        out += mass * (z / r**3 if order == 0 else 1 / r**3 - 3 * z**2 / r**5)
    return axis, out


def test_point_sources_are_continued_as_their_closed_form_says():
    axis, low = sources(0.0)
    _, high = sources(1000.0)
    grid = geomag.GridMap(low, axis, axis, sigma=0.0, height_m=200.0)
    up = grid.continue_to(1200.0)
    error = np.asarray(up.values) - high
    assert up.height_m == 1200.0
    assert np.abs(error[20:-20, 20:-20]).max() < 2e-3 * np.ptp(high)
    # Beyond what a margin is stated for nothing is off.
    assert (np.abs(error) / np.asarray(up.sigma)).max() < 3.0


def test_the_vertical_gradient_of_point_sources_is_that_of_the_closed_form():
    axis, low = sources(0.0)
    _, slope = sources(0.0, order=1)
    got = np.asarray(geomag.GridMap(low, axis, axis).vertical_gradient().values)
    assert np.abs((got - slope)[20:-20, 20:-20]).max() < 1e-2 * np.ptp(slope)


@pytest.mark.parametrize("up_m", [500.0, 2000.0])
def test_at_least_as_near_to_the_truth_as_harmonica(up_m):
    harmonica = pytest.importorskip("harmonica")
    xr = pytest.importorskip("xarray")
    axis, low = sources(0.0)
    _, high = sources(up_m)
    array = xr.DataArray(low, coords={"northing": axis, "easting": axis}, dims=("northing", "easting"))
    theirs = harmonica.upward_continuation(array, up_m).to_numpy()
    ours = np.asarray(geomag.GridMap(low, axis, axis, sigma=0.0, height_m=0.0).continue_to(up_m).values)
    inner = np.s_[12:-12, 12:-12]

    def rms(a):
        return float(np.sqrt(np.mean((a - high)[inner] ** 2)))

    assert rms(ours) <= rms(theirs)
    # Their filter on our terms: the same transform where both take the map as periodic.
    periodic = np.asarray(geomag.GridMap(low, axis, axis, height_m=0.0).continue_to(up_m, edges="periodic").values)
    assert np.abs(periodic - theirs).max() < 1e-9 * np.ptp(low)


def test_derivative_upward_is_harmonicas_where_both_are_periodic():
    harmonica = pytest.importorskip("harmonica")
    xr = pytest.importorskip("xarray")
    axis, low = sources(0.0)
    array = xr.DataArray(low, coords={"northing": axis, "easting": axis}, dims=("northing", "easting"))
    theirs = harmonica.derivative_upward(array).to_numpy()
    ours = np.asarray(geomag.GridMap(low, axis, axis).vertical_gradient(edges="periodic").values)
    sign = np.sign((theirs * ours).sum())
    assert np.abs(sign * theirs - ours).max() < 1e-9 * np.ptp(ours)
    _, slope = sources(0.0, order=1)
    assert (slope * ours).sum() > 0


def test_values_of_magnav_with_its_periodic_assumption(data_file):
    map_data = magnav(data_file)
    x = np.arange(100) * map_data["dx"]
    y = np.arange(100) * map_data["dy"]
    grid = geomag.GridMap(map_data["map"], x, y, sigma=0.0, height_m=map_data["alt"])
    up = grid.continue_to(map_data["alt"] + map_data["dz"], edges="periodic")
    assert np.abs(np.asarray(up.values) - map_data["map_out"]).max() < 1e-9


def test_the_default_errs_less_than_half_a_nanotesla_where_the_map_is_known_five_kilometres_around(data_file):
    map_data = magnav(data_file)
    x = np.arange(100) * map_data["dx"]
    y = np.arange(100) * map_data["dy"]
    whole = geomag.GridMap(map_data["map"], x, y, sigma=0.0, height_m=305.0).continue_to(405.0)
    part = np.s_[15:85, 15:85]
    cut = geomag.GridMap(map_data["map"][part], x[part[1]], y[part[0]], sigma=0.0, height_m=305.0).continue_to(405.0)
    error = np.asarray(cut.values) - np.asarray(whole.values)[part]
    assert np.abs(error[5:-5, 6:-6]).max() < 0.5
    # Nearer to the edges it is 1.8, 0.6 and 0.4 nT rms on the first three nodes, of a field of 235; sigma has it.
    assert [np.sqrt(np.mean(ring(error, k) ** 2)) < limit for k, limit in enumerate((2.0, 0.8, 0.5))] == [True] * 3
    sigma = np.asarray(geomag.GridMap(map_data["map"][part], x[part[1]], y[part[0]], sigma=0.0, height_m=305.0)
                       .continue_to(405.0, about="value").sigma)  # fmt: skip
    for k in range(12):
        assert 0.2 < np.sqrt(np.mean((ring(error, k) / ring(sigma, k)) ** 2)) < 1.2


def ring(a, k):
    """Nodes k cells inside the edge."""
    inner = a[k : a.shape[0] - k, k : a.shape[1] - k]
    return np.concatenate([inner[0], inner[-1], inner[1:-1, 0], inner[1:-1, -1]])


@pytest.mark.parametrize(
    ("path", "up_m", "track_m", "cut"),
    [
        ("osborne-aeromag/osborne_grid_from_shared_lines.nc", 300.0, 8000.0, np.s_[300:660, 150:510]),
        ("britain-aeromag/britain_grid_from_shared_lines.nc", 2000.0, 40_000.0, np.s_[180:300, 560:720]),
    ],
)
def test_what_edges_do_to_a_track_is_in_sigma_and_what_they_do_to_a_value_if_asked(data_file, path, up_m, track_m, cut):
    grid = geomag.read_grid(data_file(path))
    values = np.asarray(grid.values, dtype=float)
    cell = grid.spacing_m
    x, y = np.arange(values.shape[1]) * cell[0], np.arange(values.shape[0]) * cell[1]
    whole = np.asarray(
        geomag.GridMap(values, x, y, sigma=0.0, height_m=0.0).continue_to(up_m, edges="mirrored").values
    )[cut]
    part = geomag.GridMap(values[cut], x[cut[1]], y[cut[0]], sigma=0.0, height_m=0.0)
    assert part.holes < 0.01 * part.values.size
    up, of_value = part.continue_to(up_m), part.continue_to(up_m, about="value")
    error, sigma = np.asarray(up.values) - whole, np.asarray(up.sigma)
    along = int(track_m / cell[0])
    ratios = []
    for row in range(0, error.shape[0], 5):
        for first in range(0, error.shape[1] - along + 1, along):
            e, s = error[row, first : first + along], sigma[row, first : first + along]
            known = np.isfinite(e)
            e, weight = e[known], s[known] ** -2
            # A matcher finds the level.
            ratios.append(np.mean((e - np.average(e, weights=weight)) ** 2 * weight))
    assert 0.4 < np.sqrt(np.mean(ratios)) < 1.5
    total = (error / np.asarray(of_value.sigma)).ravel()
    assert np.sqrt(np.nanmean(total**2)) < 2.0
    assert np.nanmin(np.asarray(of_value.sigma) - sigma) >= 0


def test_levels_keep_the_slopes_of_a_map_that_is_not_sure_of_its_values():
    axis = np.arange(0.0, 40_000.0, 250.0)
    rng = np.random.default_rng(2)
    waves = [(rng.normal(0, 9), 2 * np.pi / s, *rng.uniform(0, 2 * np.pi, 2)) for s in np.geomspace(1500, 9000, 25)]

    def field(height):
        return sum(
            a * np.exp(-k * height) * np.cos(k * (np.cos(d) * axis + np.sin(d) * axis[:, None]) + p)
            for a, k, d, p in waves
        )

    heights = continuation.levels(geomag.GridMap(field(0.0), axis, axis, sigma=20.0, height_m=0.0), 0.0, 1500.0)
    for low, high in itertools.pairwise(heights):
        half_way = field(0.5 * (low + high))
        miss = 0.5 * (field(low) + field(high)) - half_way
        assert np.std(np.gradient(miss)) < 0.07 * np.std(np.gradient(half_way))
    assert heights.size <= 12


def magnav(data_file):
    scipy_io = pytest.importorskip("scipy.io")
    path = data_file("magnav-fixtures/test_data_map.mat")
    data = scipy_io.loadmat(path, squeeze_me=True, struct_as_record=False)["map_data"]
    return {k: getattr(data, k) for k in ("map", "map_out", "dx", "dy", "dz", "alt")} | {
        "map": np.asarray(data.map, dtype=float)
    }


def noise(length_m: float, shape: tuple[int, int], cell: float, rng: np.random.Generator):
    """Errors of a map that is right at its data, of that correlation length along a line and standard deviation one."""
    ky = 2 * np.pi * np.fft.fftfreq(shape[0], cell)
    kx = 2 * np.pi * np.fft.rfftfreq(shape[1], cell)
    k = np.hypot(ky[:, None], kx[None, :])
    power = (2 * k * length_m) ** 2 * (1 + (2 * k * length_m) ** 2) ** -2.5
    field = np.fft.irfft2(np.fft.rfft2(rng.standard_normal(shape)) * np.sqrt(power), s=shape)
    return field / field.std()


@pytest.mark.parametrize("up_m", [100.0, 400.0])
def test_sigma_upward_is_what_the_errors_become(up_m):
    rng = np.random.default_rng(3)
    cell, length = 100.0, 350.0
    axis = np.arange(160) * cell
    ratio = []
    for _ in range(6):
        error = 4.0 * noise(length, (160, 160), cell, rng)
        grid = geomag.GridMap(error, axis, axis, sigma=4.0, height_m=0.0).with_error_model(
            nu=5.0, scale_spread=0.3, correlation=3.5, registration=0.1, distance_m=100.0
        )
        up = grid.continue_to(up_m)
        inner = np.s_[40:-40, 40:-40]
        ratio.append(np.mean((np.asarray(up.values)[inner] / np.asarray(up.sigma)[inner]) ** 2))
        longer = up.error_model["correlation"] / 3.5
        assert longer > 1.0
        # So many as were apart go into one mean; an edge far away has hardly a part in it.
        assert 5.0 * longer < up.error_model["nu"] <= 5.0 * (longer**2 + 1)
    assert 0.75 < np.mean(ratio) < 1.3


def test_downward_gives_back_what_was_continued_up_within_its_sigma():
    axis, low = sources(0.0)
    rng = np.random.default_rng(5)
    _, high = sources(700.0)
    error = 0.004 * np.ptp(high) * noise(1000.0, high.shape, 500.0, rng)
    spread = 0.004 * np.ptp(high)
    grid = geomag.GridMap(high + error, axis, axis, sigma=spread, height_m=700.0)
    down = grid.continue_to(0.0)
    inner = np.s_[15:-15, 15:-15]
    miss = (np.asarray(down.values) - low)[inner]
    sigma = np.asarray(down.sigma)[inner]
    assert sigma.min() > spread
    assert np.sqrt(np.mean(miss**2)) < 0.6 * np.sqrt(np.mean((high - low)[inner] ** 2))
    assert 0.2 < np.sqrt(np.mean((miss / sigma) ** 2)) < 1.5


def test_a_draped_map_comes_to_a_level():
    axis, _ = sources(0.0)
    x, y = np.meshgrid(axis, axis)
    drape = 300.0 + 200.0 * np.sin(x / 5e3) * np.cos(y / 7e3)
    heights = np.linspace(100.0, 500.0, 81)
    stack = np.stack([sources(h)[1] for h in heights])
    place = (drape - 100.0) / 5.0
    at = np.clip(place.astype(int), 0, 79)
    share = place - at
    values = (
        np.take_along_axis(stack, at[None], 0)[0] * (1 - share) + np.take_along_axis(stack, at[None] + 1, 0)[0] * share
    )
    grid = geomag.GridMap(values, axis, axis, sigma=0.0, height_m=drape)
    level = grid.continue_to(500.0)
    truth = sources(500.0)[1]
    inner = np.s_[12:-12, 12:-12]
    before = np.sqrt(np.mean((values - truth)[inner] ** 2))
    assert np.sqrt(np.mean((np.asarray(level.values) - truth)[inner] ** 2)) < 0.15 * before


def test_holes_stay_holes_and_what_is_around_them_is_less_sure():
    axis, low = sources(0.0)
    holed = low.copy()
    holed[60:70, 60:70] = np.nan
    up = geomag.GridMap(holed, axis, axis, sigma=0.01, height_m=0.0).continue_to(1000.0)
    assert up.holes == 100
    sigma, error = np.asarray(up.sigma), np.abs(np.asarray(up.values) - sources(1000.0)[1])
    assert sigma[59, 65] > 3 * sigma[40, 40]
    assert (error[50:80, 50:80] / sigma[50:80, 50:80])[np.isfinite(sigma[50:80, 50:80])].max() < 4.0
    # Without a sigma, where the edge is worse than anybody would guess of the map there is none.
    bare = geomag.GridMap(low, axis, axis, height_m=0.0).continue_to(2000.0)
    assert bare.sigma is None
    assert bare.holes > 0
    assert np.isfinite(np.asarray(bare.values)[60, 60])


def test_maps_that_cannot_be_continued_are_refused_by_name():
    axis, low = sources(0.0, n=21)
    with pytest.raises(geomag.InvalidInputError, match="knows its height"):
        geomag.GridMap(low, axis, axis).continue_to(100.0)
    grid = geomag.GridMap(low, axis, axis, height_m=100.0)
    with pytest.raises(geomag.InvalidInputError, match="within the width of the map"):
        grid.continue_to(1e6)
    with pytest.raises(geomag.InvalidInputError, match="finite height"):
        grid.continue_to(np.nan)
    with pytest.raises(geomag.InvalidInputError, match="edges"):
        grid.continue_to(200.0, edges="open")
    holed = low.copy()
    holed[3, 3] = np.nan
    with pytest.raises(geomag.InvalidInputError, match="without holes"):
        geomag.GridMap(holed, axis, axis, height_m=0.0).continue_to(100.0, edges="periodic")


def test_levels_are_close_enough_for_a_straight_line_between_them():
    axis, low = sources(0.0)
    sigma = 0.01 * np.ptp(low)
    grid = geomag.GridMap(low, axis, axis, sigma=sigma, height_m=0.0)
    heights = continuation.levels(grid, 0.0, 1500.0)
    stack = grid.continue_to(heights)
    assert isinstance(stack, geomag.MapStack)
    assert len(stack) == len(heights) < 20
    between = 0.5 * (heights[1:] + heights[:-1])
    for h in between:
        miss = np.asarray(stack.at(h).values) - np.asarray(grid.continue_to(h).values)
        assert np.sqrt(np.mean(miss**2)) < 0.5 * sigma
    x, y = np.array([100.0, -3000.0]), np.array([250.0, 900.0])
    assert np.allclose(stack.sample(x, y, between[0]), stack.at(between[0]).sample(x, y), atol=1e-12 * np.ptp(low))
    assert np.isnan(stack.sample(0.0, 0.0, 1501.0))
    back = pickle.loads(pickle.dumps(stack))
    assert np.array_equal(back.heights_m, stack.heights_m)
    assert back.sample(0.0, 0.0, 700.0) == stack.sample(0.0, 0.0, 700.0)
