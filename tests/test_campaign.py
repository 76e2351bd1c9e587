from __future__ import annotations

import os
import signal
import threading
import time
from concurrent.futures import Future, ProcessPoolExecutor, ThreadPoolExecutor
from functools import partial
from multiprocessing import get_context

import numpy as np
import pytest

import geomag
from geomag import campaign, synthetic
from geomag._statistics import binomial_interval
from geomag.campaign._plan import _Work
from geomag.campaign._workers import _completed

METHOD = campaign.iema(sigma=1.0, half_width=2000.0)


@pytest.fixture(scope="module")
def plan():
    grid = synthetic.Crust().draw((0, 0, 60_000, 50_000), seed=2).grid(500.0, units="nT")
    return campaign.Campaign(
        grid,
        tracks=campaign.RandomTracks(samples=25, spacing_m=(500.0, 1500.0), turn_deg=30.0),
        ins=synthetic.InsSpread(synthetic.Uniform((2000.0, 2000.0)), heading_sigma_deg=0.2),
        sensor=synthetic.Sensor(sigma=1.0),
        seed=11,
    )


@pytest.fixture(scope="module")
def table(plan):
    return plan.run(METHOD, 400)


def test_rows_are_the_same_for_any_subset_order_and_threads(plan, table):
    assert plan.run(METHOD, 400, threads=1).equals(table)
    assert plan.run(METHOD, 400, threads=2).equals(table)
    assert plan.run(METHOD, list(range(399, -1, -1)), chunk=7).equals(table)
    some = plan.run(METHOD, [13, 377])
    assert np.array_equal(some["error_m"], table["error_m"][[13, 377]], equal_nan=True)
    other_seed = campaign.Campaign(plan.grid, plan.tracks, plan.ins, plan.sensor, seed=12)
    assert not other_seed.run(METHOD, 400).equals(table)


def test_a_row_is_what_the_matcher_says_of_that_flight(plan, table):
    for trial in (0, 5, 200):
        flight = plan.flight(trial)
        fix = geomag.Iema(plan.grid, sigma=1.0, half_width=2000.0).run(flight.track)
        assert table["status"][trial] == fix.status
        assert table["n_samples"][trial] == fix.n_samples
        at = fix.n_samples - 1
        if np.isfinite(fix.x):
            assert table["error_m"][trial] == pytest.approx(
                np.hypot(fix.x - flight.path.x[at], fix.y - flight.path.y[at])
            )


@pytest.mark.parametrize(
    ("criterion", "options"),
    [
        ("msd", {}),
        ("hausdorff", {}),
        ("hausdorff", {"length_scale_m": 900.0, "value_scale": 25.0, "fraction": 0.8}),
    ],
)
def test_python_callables_give_the_same_rows_as_rust(plan, criterion, options):
    def by_hand(grid, track):
        return geomag.match_grid(grid, track, criterion, half_width=2500.0, **options)

    method = campaign.grid_search(criterion, half_width=2500.0, **options)
    tables = plan.compare({"rust": method, "python": by_hand}, 30)
    for column in tables["rust"]:
        ours, theirs = tables["rust"][column], tables["python"][column]
        if column == "status":
            assert ours.tolist() == theirs.tolist()
        else:
            np.testing.assert_allclose(ours, theirs, atol=1e-9, rtol=1e-12, err_msg=column)


def test_hausdorff_scales_are_told_and_count(plan):
    base = plan.run(campaign.grid_search("hausdorff", half_width=2500.0), 20)
    other = plan.run(campaign.grid_search("hausdorff", half_width=2500.0, value_scale=500.0), 20)
    assert not np.array_equal(base["score"], other["score"])
    assert np.median(base["error_m"][base["status"] == "fixed"]) < 500


def test_contour_matching_in_rust_is_that_of_the_binding(plan):
    options = {"starts": "grid", "half_width_m": 2500.0, "refine": True, "sigma": 2.0, "offset_sigma_m": 1500.0}

    def by_hand(grid, track):
        return geomag.match_contour(grid, track, **options)

    tables = plan.compare({"rust": campaign.contour(**options), "python": by_hand}, 10)
    assert tables["rust"]["status"].tolist() == tables["python"]["status"].tolist()
    np.testing.assert_allclose(tables["rust"]["error_m"], tables["python"]["error_m"], atol=1e-6)
    with pytest.raises(TypeError, match="radius"):
        plan.run(campaign.contour(radius=3), 1)


def test_posterior_matching_in_rust_is_that_of_the_binding(plan):
    options = {"half_width": (2500.0, 2500.0), "sigma": 2.0, "tolerance_m": 500.0, "heading_sigma_deg": 0.3}

    def by_hand(grid, track):
        return geomag.match_posterior(grid, track, **options)

    tables = plan.compare({"rust": campaign.posterior(**options), "python": by_hand}, 10)
    assert tables["rust"]["status"].tolist() == tables["python"]["status"].tolist()
    for column in ("error_m", "risk", "covariance_ee_m2"):
        np.testing.assert_allclose(tables["rust"][column], tables["python"][column], rtol=1e-9, err_msg=column)
    with pytest.raises(geomag.InvalidInputError, match="tolerance"):
        plan.run(campaign.posterior(half_width=100.0, tolerance=3.0), 1)


def test_compare_puts_every_method_on_the_same_flights(plan, table):
    tables = plan.compare({"iema": METHOD, "msd": campaign.grid_search("msd", half_width=2500.0)}, 400)
    assert tables["iema"].equals(table)
    assert np.array_equal(tables["msd"]["trial"], table["trial"])
    full = table["n_samples"] == 25
    assert full.any()
    for column in ("true_x", "ins_error_east_m"):
        assert np.array_equal(tables["msd"][column][full], table[column][full])


def test_summary_is_right(table):
    summary = table.summary(1000.0)
    ok = table["status"] == "fixed"
    errors = table["error_m"][ok]
    assert summary.fixed == ok.sum()
    assert summary.wrong == (errors > 1000.0).sum()
    assert summary.median_m == np.median(errors)
    assert summary.drms_m == pytest.approx(np.sqrt((errors**2).mean()))
    assert summary.wrong_rate_interval == binomial_interval(summary.wrong, summary.fixed)
    assert sum(summary.statuses.values()) == len(table)
    assert "fixed" in str(summary)
    with pytest.raises(geomag.InvalidInputError, match="tolerance_m"):
        table.summary(0.0)


@pytest.mark.parametrize(("k", "n"), [(0, 1), (0, 500), (3, 155), (50, 50), (1, 2), (400, 100_000), (99_000, 100_000)])
def test_binomial_interval_equals_the_beta_quantiles(k, n):
    beta = pytest.importorskip("scipy.stats").beta
    low, high = binomial_interval(k, n)
    assert low == pytest.approx(0.0 if k == 0 else beta.ppf(0.025, k, n - k + 1), rel=1e-7)
    assert high == pytest.approx(1.0 if k == n else beta.ppf(0.975, k + 1, n - k), rel=1e-7)


def test_normalised_error_is_that_of_the_covariance(plan):
    table = plan.run(campaign.grid_search("msd", half_width=2500.0, sigma=2.0), 200)
    ok = table["status"] == "fixed"
    values = []
    for i in np.flatnonzero(ok):
        c = np.array([[table["covariance_ee_m2"][i], table["covariance_en_m2"][i]],
                      [table["covariance_en_m2"][i], table["covariance_nn_m2"][i]]])  # fmt: skip
        e = np.array([table["error_east_m"][i], table["error_north_m"][i]])
        values.append(e @ np.linalg.solve(c, e))
    assert table.summary(500.0).nees == pytest.approx(np.mean(values))


def test_an_interrupted_run_goes_on_from_the_folder(plan, table, tmp_path):
    seen = []

    def stop(done, total):
        seen.append(done)
        if done >= 150:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        plan.run(METHOD, 400, folder=tmp_path, chunk=50, progress=stop)
    held = sorted(p.name for p in tmp_path.glob("*.npz"))
    assert 2 <= len(held) < 8
    stamps = {p: p.stat().st_mtime_ns for p in tmp_path.glob("*.npz")}
    assert plan.run(METHOD, 400, folder=tmp_path, chunk=50).equals(table)
    assert all(p.stat().st_mtime_ns == stamp for p, stamp in stamps.items())
    assert not list(tmp_path.glob("*.part"))


def test_a_folder_of_another_campaign_is_refused(plan, tmp_path):
    plan.run(METHOD, 10, folder=tmp_path)
    with pytest.raises(geomag.StateError, match="differs in methods"):
        plan.run(campaign.iema(sigma=2.0, half_width=2000.0), 10, folder=tmp_path)
    for spoilt in (b"PK spoilt", b"PK\x03\x04 spoilt"):
        next(iter(tmp_path.glob("*.npz"))).write_bytes(spoilt)
        with pytest.raises(geomag.ReadError, match="npz"):
            plan.run(METHOD, 10, folder=tmp_path)
    (tmp_path / "campaign.json").write_text("[1]")
    with pytest.raises(geomag.ReadError, match=r"campaign\.json"):
        plan.run(METHOD, 10, folder=tmp_path)


def test_a_folder_knows_all_of_the_map(plan, tmp_path):
    """Sigma, error model and the kind of coordinates change the rows as the values do."""
    grid = plan.grid
    values, x, y = grid.values[:20, :20], np.linspace(10.0, 11.0, 20), np.linspace(45.0, 46.0, 20)
    flat = geomag.GridMap(values, x, y)
    ones = np.ones(values.shape)
    model = {"nu": 3.0, "scale_spread": 0.3, "correlation": 1.0, "registration": 0.1}
    maps = [
        flat,
        geomag.GridMap(values, x, y, geographic=True),
        geomag.GridMap(values, x, y, sigma=ones),
        geomag.GridMap(values, x, y, sigma=2 * ones),
        geomag.GridMap(values, x, y, sigma=ones).with_error_model(**model, distance_m=ones),
        geomag.GridMap(values, x, y, sigma=ones).with_error_model(**model, distance_m=2 * ones),
        geomag.GridMap(values.astype("f4"), x, y),
        geomag.GridMap(values, x + 1e-9, y),
    ]

    def known(plan):
        return _Work(plan, {"method": METHOD}).fingerprint()["maps"]

    assert len({known(campaign.Campaign(m)) for m in maps}) == len(maps)
    assert len({known(campaign.Campaign(grid, truth=m)) for m in (None, *maps)}) == len(maps) + 1
    crust = synthetic.Crust()
    fields = [crust.draw((0, 0, 60_000, 50_000), seed=s) for s in (1, 2)]
    assert len({known(campaign.Campaign(grid, truth=f)) for f in fields}) == 2
    assert known(campaign.Campaign(geomag.GridMap(values, x, y))) == known(campaign.Campaign(flat))

    told = geomag.GridMap(grid.values, grid.x, grid.y, sigma=np.full(grid.shape, 3.0))
    plan.run(METHOD, 4, folder=tmp_path)
    other = campaign.Campaign(told, plan.tracks, plan.ins, plan.sensor, seed=plan.seed)
    with pytest.raises(geomag.StateError, match="differs in maps"):
        other.run(METHOD, 4, folder=tmp_path)


def by_msd(grid, track, half_width=2500.0):
    return geomag.match_grid(grid, track, "msd", half_width=half_width)


class ByMsd:
    def __init__(self, half_width):
        self.half_width = half_width

    def __call__(self, grid, track):
        return by_msd(grid, track, self.half_width)


def test_a_folder_does_not_take_one_callable_for_another(plan, tmp_path):
    pairs = [
        (partial(geomag.match_grid, half_width=900.0), partial(geomag.match_grid, half_width=2500.0)),
        (partial(by_msd, half_width=900.0), by_msd),
        (ByMsd(900.0), ByMsd(2500.0)),
        (ByMsd(900.0).__call__, ByMsd(2500.0).__call__),
        (campaign.Keyed("narrow", lambda g, t: by_msd(g, t, 900.0)), campaign.Keyed("wide", by_msd)),
    ]
    for k, (one, other) in enumerate(pairs):
        table = plan.run(one, 3, folder=tmp_path / str(k))
        assert table.equals(plan.run(one, 3, folder=tmp_path / str(k)))
        with pytest.raises(geomag.StateError, match="differs in methods"):
            plan.run(other, 3, folder=tmp_path / str(k))
    for unknown in (
        lambda g, t: by_msd(g, t, 9.0),
        partial(lambda g, t, w: by_msd(g, t, 9 * w), w=9.0),
        ByMsd(lambda: 3),
    ):
        with pytest.raises(geomag.InvalidInputError, match="Keyed"):
            plan.run(unknown, 3, folder=tmp_path / "unknown")
    plan.run(lambda g, t: by_msd(g, t, 900.0), 1)  # without a folder there is nothing to take it for


def test_a_folder_sees_that_a_function_was_edited(plan, tmp_path):
    source = "import geomag\ndef f(grid, track):\n    return geomag.match_grid(grid, track, half_width={})\n"
    functions = []
    for half_width in (900.0, 2500.0):
        space = {"__name__": "edited"}
        exec(source.format(half_width), space)
        functions.append(space["f"])
    plan.run(functions[0], 3, folder=tmp_path)
    with pytest.raises(geomag.StateError, match="differs in methods"):
        plan.run(functions[1], 3, folder=tmp_path)


def test_a_folder_gives_every_method_its_own_rows(plan, tmp_path):
    methods = {"a": METHOD, "b": campaign.grid_search("msd", half_width=2500.0)}
    plan.compare(methods, 5, folder=tmp_path)
    with pytest.raises(geomag.StateError, match="differs in methods"):
        plan.compare(dict(reversed(methods.items())), 5, folder=tmp_path)


def test_options_from_numpy_are_numbers(plan, table, tmp_path):
    method = campaign.iema(sigma=np.float32(1.0), half_width=np.int64(2000))
    assert plan.run(method, np.int64(400)).equals(table)
    options = {"starts": "indicated", "radius_m": np.float64(900.0)}
    for _ in range(2):
        plan.run(campaign.contour(**options, max_iterations=np.int64(9)), 2, folder=tmp_path)
    with pytest.raises(geomag.InvalidInputError, match="options"):
        plan.run(campaign.contour(radius_m=object()), 1)


def test_progress_is_told(plan):
    seen = []
    plan.run(METHOD, 400, progress=lambda done, total: seen.append((done, total)))
    assert seen[-1] == (400, 400)
    assert [d for d, _ in seen] == sorted(d for d, _ in seen)


def test_threads_as_an_executor(plan, table):
    with ThreadPoolExecutor(2) as pool:
        assert plan.run(METHOD, 400, executor=pool, chunk=30).equals(table)


def test_processes_as_an_executor(plan, table):
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as pool:
        assert plan.run(METHOD, 400, executor=pool, chunk=30).equals(table)


class DieOnce:
    """A matcher whose first worker process dies in the middle of its work."""

    def __init__(self, flag):
        self.flag = str(flag)

    def __call__(self, grid, track):
        try:
            os.close(os.open(self.flag, os.O_CREAT | os.O_EXCL))
            os.kill(os.getpid(), signal.SIGKILL)
        except FileExistsError:
            pass
        return geomag.match_grid(grid, track, "msd", half_width=2500.0)


def test_a_broken_pool_says_so_and_a_new_one_goes_on(plan, tmp_path):
    method = DieOnce(tmp_path / "flag")
    with (
        ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool,
        pytest.raises(geomag.GeomagError, match="folder"),
    ):
        plan.run(method, 20, executor=pool, chunk=5, folder=tmp_path / "out")
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        table = plan.run(method, 20, executor=pool, chunk=5, folder=tmp_path / "out")
    assert table.equals(plan.run(DieOnce(tmp_path / "flag"), 20))


class Stubborn:
    """A matcher that raises, and counts how often it was asked."""

    def __init__(self):
        self.calls = 0

    def __call__(self, grid, track):
        self.calls += 1
        raise ZeroDivisionError("of one's own")


def test_what_a_matcher_raises_is_not_tried_again(plan):
    method = Stubborn()
    with ThreadPoolExecutor(1) as pool, pytest.raises(ZeroDivisionError, match="of one's own") as caught:
        plan.run(method, 40, executor=pool, chunk=4)
    assert any("trials 0 to 3" in note for note in caught.value.__notes__)
    assert method.calls <= 10  # no chunk twice; some may have begun before they were called off


def test_of_chunks_that_are_done_at_once_the_first_comes_first():
    done = [Future() for _ in range(50)]
    for future in done:
        future.set_result(None)
    waiting = {future: i for i, future in enumerate(done)}
    seen = []
    for future in _completed(waiting):
        seen.append(waiting.pop(future))
    assert seen == list(range(50))


class Stays(Exception):
    """One that pickles and does not come back."""

    def __init__(self, one, two):
        super().__init__(f"{one} {two}")


def stays(grid, track):
    raise Stays("from", "a worker")


def test_an_exception_that_does_not_travel_is_told_in_words(plan):
    with (
        ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool,
        pytest.raises(geomag.GeomagError, match=r"trials \d to \d .*from a worker"),
    ):
        plan.run(stays, 4, executor=pool, chunk=2)


long = pytest.mark.skipif("GEOMAG_LONG" not in os.environ, reason="takes minutes; set GEOMAG_LONG to run it")


@pytest.mark.parametrize(("trials", "chunk"), [(6000, 100), pytest.param(100_000, 500, marks=long)])
def test_dask_cluster_with_a_killed_worker(plan, trials, chunk):
    """The same table from one thread, two threads and a cluster of processes that lose one of their number."""
    distributed = pytest.importorskip("distributed")
    expected = plan.run(METHOD, trials, threads=2)
    assert plan.run(METHOD, trials, threads=1).equals(expected)
    with (
        distributed.LocalCluster(n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None) as cluster,
        distributed.Client(cluster) as client,
    ):
        pids = list(client.run(os.getpid).values())
        assert len(set(pids)) == 2
        assert os.getpid() not in pids
        seen = []

        def watch(done, total):
            seen.append(done)
            if len(seen) == 3:  # in mid-run: some chunks are in, most are not
                os.kill(pids[0], signal.SIGKILL)

        table = plan.run(METHOD, trials, executor=client, chunk=chunk, progress=watch)
        assert len(seen) >= trials // chunk
        assert seen[2] < trials // 2
        deadline = time.monotonic() + 30
        while set(client.run(os.getpid).values()) == set(pids):
            assert time.monotonic() < deadline, "the killed worker was never replaced"
            time.sleep(0.1)
    assert np.array_equal(table["trial"], np.arange(trials))  # nothing lost, nothing twice
    assert table.equals(expected)


def test_dask_executor_interface(plan, table):
    distributed = pytest.importorskip("distributed")
    with (
        distributed.LocalCluster(n_workers=1, threads_per_worker=1, processes=True, dashboard_address=None) as cluster,
        distributed.Client(cluster) as client,
    ):
        assert plan.run(METHOD, 400, executor=client.get_executor(), chunk=100).equals(table)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda p: p.run(METHOD, 0), "trials"),
        (lambda p: p.run(METHOD, [1, 1]), "distinct"),
        (lambda p: p.run(METHOD, 2.5), "whole number"),
        (lambda p: p.flight(-1), "trials"),
        (lambda p: p.run(METHOD, [0.5]), "whole number"),
        (lambda p: campaign.iema(sigma=1, half_width="wide"), "pair"),
        (lambda p: p.run(METHOD, 5, chunk=0), "chunk"),
        (lambda p: p.run(METHOD, 5, executor=3), "executor"),
        (lambda p: p.compare({}, 5), "methods"),
        (lambda p: p.run(lambda grid, track: 3, 1), "returns a Fix"),
        (lambda p: p.run(campaign.Method("iema", {"sigmas": 1}), 1), "sigmas"),
        (lambda p: p.run(campaign.Method("magic", {}), 1), "magic"),
        (lambda p: campaign.grid_search("best", half_width=1), "criterion"),
        (lambda p: campaign.grid_search("msd", half_width=1, fraction=0.5), "hausdorff"),
        (lambda p: p.run(campaign.grid_search("hausdorff", half_width=900, fraction=1.5), 1), "fraction"),
        (lambda p: campaign.iema(sigma=1, half_width=(1, 2, 3)), "pair"),
        (lambda p: p.run(campaign.iema(sigma=-1, half_width=100.0), 1), "sigma"),
        (lambda p: campaign.Campaign(p.grid, campaign.RandomTracks(samples=10_000)).run(METHOD, 1), "fit on the map"),
        (lambda p: campaign.Campaign(p.grid, seed=-1).run(METHOD, 1), "seed"),
    ],
)
def test_bad_input_is_refused_by_name(plan, call, words):
    with pytest.raises(geomag.InvalidInputError, match=words):
        call(plan)


def test_the_interpreter_is_free_meanwhile(plan):
    ticks = []
    stop = threading.Event()

    def tick():
        while not stop.is_set():
            ticks.append(time.perf_counter())
            time.sleep(0.005)

    thread = threading.Thread(target=tick)
    thread.start()
    plan.run(METHOD, 20_000)
    stop.set()
    thread.join()
    assert len(ticks) > 5
