"""Objects that several threads use: no update is lost, no argument is converted under a lock."""

from __future__ import annotations

import multiprocessing
import subprocess
import sys
import threading

import numpy as np
import pytest

import geomag


def together(count, work):
    threads = [threading.Thread(target=work, args=(k,), daemon=True) for k in range(count)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(timeout=60)
    assert not any(thread.is_alive() for thread in threads), "deadlock"


def test_callables_lose_no_update():
    ukf = geomag.UnscentedKalmanFilter([0.0], 1.0)
    rounds = 300

    def work(_):
        for _ in range(rounds):
            ukf.predict(lambda x: [x[0]], 1.0)

    together(4, work)
    assert float(ukf.P[0, 0]) == pytest.approx(1.0 + 4 * rounds, rel=1e-9)


def test_a_model_may_look_at_its_filter_and_not_change_it():
    ukf = geomag.UnscentedKalmanFilter([1.0], 1.0)
    ukf.predict(lambda x: [x[0] + float(ukf.x[0])], 0.5)
    assert float(ukf.x[0]) == pytest.approx(2.0)
    before = repr(ukf.x), repr(ukf.P)
    with pytest.raises(geomag.InvalidInputError, match="leaves the filter that calls it as it is"):
        ukf.predict(lambda x: ukf.predict([[1.0]], 1.0) or x, 0.5)
    assert (repr(ukf.x), repr(ukf.P)) == before
    ukf.predict([[1.0]], 0.5)


class Curious:
    """An array-like that asks the object that it is given to."""

    def __init__(self, ask, value):
        self.ask, self.value = ask, value

    def __array__(self, dtype=None, copy=None):
        self.ask()
        return np.array(self.value)


def test_arguments_are_converted_before_the_lock():
    feedback = geomag.InsFeedback()
    feedback.step(0.0, 0.0, 0.0)
    done = []

    def work(_):
        offset = Curious(lambda: (feedback.state, feedback.accepted), [30.0, -20.0])
        spread = Curious(lambda: feedback.covariance, [[2500.0, 0.0], [0.0, 2500.0]])
        done.append(feedback.step(60.0, 600.0, 0.0, offset_m=offset, covariance_m2=spread).accepted)

    together(1, work)
    assert done == [True]


def test_readings_of_a_navigator_too():
    x = np.arange(0.0, 1000.0, 20.0)
    grid = geomag.GridMap(90 * np.sin(x / 140)[None, :] + 80 * np.cos(x / 120)[:, None], x, x)
    nav = geomag.FieldNavigator(grid, start=(300.0, 500.0), covariance_m2=100.0, reading_sigma=1.0)
    together(1, lambda _: nav.step(1.0, 5.0, 90.0, Curious(lambda: nav.position, [3.0])))
    assert nav.n_steps == 1


FORKED = """
import multiprocessing, sys
import numpy as np, geomag
X = np.arange(0.0, 4000.0, 50.0)
GRID = geomag.GridMap(np.random.default_rng(1).normal(0, 30, (80, 80)), X, X)
K = np.arange(20.0)
TRACK = geomag.Track(1000 + 40 * K, 1200 + 30 * K, GRID.sample(1000 + 40 * K, 1200 + 30 * K))


def work(deeper):
    matcher = geomag.PosteriorMatcher(GRID, half_width=300.0, sigma=0.5)
    stream = [repr(matcher.update(x, y, z)) for x, y, z in zip(TRACK.x[:8], TRACK.y[:8], TRACK.values[:8])]
    out = [repr(geomag.match_grid(GRID, TRACK, half_width=1900.0)), repr(geomag.match_posterior(GRID, TRACK, half_width=300.0, sigma=0.5)), stream]
    if deeper:
        queue = multiprocessing.get_context("fork").Queue()
        child = multiprocessing.get_context("fork").Process(target=lambda: queue.put(work(False)))
        child.start()
        out.append(queue.get(timeout=60) == out)
        child.join()
    return out


if __name__ == "__main__":
    alone = work(False)
    with multiprocessing.get_context(sys.argv[1]).Pool(2) as pool:
        got = pool.map_async(work, [False] * 4).get(timeout=90)
    assert all(g == alone for g in got)
    if sys.argv[1] == "fork":
        assert work(True)[-1]
    print("the same")
"""


@pytest.mark.parametrize("how", ["spawn", "forkserver", "fork"])
def test_other_processes_compute_the_same(how, tmp_path):
    """A fork copies no thread but one: a child of a process that has computed with several must not wait for the others."""
    if how not in multiprocessing.get_all_start_methods():
        pytest.skip("this system starts no processes that way")
    script = tmp_path / "forked.py"
    script.write_text(FORKED)
    out = subprocess.run([sys.executable, str(script), how], capture_output=True, text=True, timeout=150, check=False)
    assert out.stdout.strip() == "the same", out.stderr[-2000:]
