"""Long calls hear Ctrl-C, and leave the interpreter to other threads; so do the getters of what is in a long call."""

import os
import signal
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

import geomag
from geomag.synthetic import Crust

#: Seconds from Ctrl-C to the exception, on a machine that others use as well.
SOON = 2.0
AXIS = np.arange(0.0, 20000.0, 100.0)


@pytest.fixture(autouse=True)
def ctrl_c_raises():
    """Also where the tests run in the background of a shell, which has its jobs ignore Ctrl-C."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.fixture(scope="module")
def grid():
    return geomag.GridMap(90 * np.sin(AXIS / 400)[None, :] * np.cos(AXIS / 500)[:, None], AXIS, AXIS)


def flown(grid, samples, step=(1.0, 0.7)):
    k = np.arange(float(samples))
    x, y = 6000 + step[0] * k, 6000 + step[1] * k
    return geomag.Track(x, y, grid.sample(x + 210, y - 125))


def long_calls(grid):
    long = flown(grid, 3000)
    sliding = geomag.SlidingContour(grid, length=1000, transform="translation", converged_m=1e-12, max_iterations=10**6)
    # Every candidate is kept for ever.
    iema = geomag.Iema(grid, sigma=1e6, half_width=5000.0, step=(7.0, 7.0))
    return {
        "contour, lattice of starts": lambda: geomag.match_contour(
            grid, long, starts="grid", half_width_m=5000.0, step_m=10.0, max_candidates=2_000_000
        ),
        "sliding window": lambda: sliding.run(long),
        "IEMA": lambda: iema.run(long),
        "synthetic map": lambda: Crust(waves=5000, dipoles=5000).draw((0, 0, 1e6, 1e6), seed=1).grid(500.0),
        "synthetic map on axes": lambda: (
            Crust(waves=5000, dipoles=5000).draw((0, 0, 1e6, 1e6), seed=1).grid(x=np.arange(0, 1e6, 500.0),
                                                                              y=np.arange(0, 1e6, 500.0))
        ),
        "synthetic field at points": lambda: (
            Crust(waves=5000, dipoles=5000).draw((0, 0, 1e6, 1e6), seed=1).sample(np.linspace(0, 1e6, 10**6), 5e5)
        ),
        "posterior": lambda: geomag.match_posterior(grid, flown(grid, 300), half_width=3000.0, step=4.0, sigma=1.0),
        "prediction": lambda: geomag.predict_many(
            grid, [flown(grid, 40, (90.0, 60.0))], half_width=1000.0, sigma=1.0, tolerance_m=100.0, flights=10**6
        ),
        "energy bandwidth": lambda: geomag.energy_bandwidth(np.sin(np.arange(400_000.0)), 1.0),
        "tuning": lambda: geomag.tune_sequence(
            grid, flown(grid, 100, (90.0, 60.0)), sigma=0.5, offset_m=250.0, max_length=10, quanta=[2.0], draws=10**6
        ),
    }  # fmt: skip


CALLS = [
    "contour, lattice of starts", "sliding window", "IEMA", "synthetic map", "synthetic map on axes",
    "synthetic field at points", "posterior", "prediction", "energy bandwidth", "tuning",
]  # fmt: skip


@pytest.mark.parametrize("name", CALLS)
def test_ctrl_c_is_heard(grid, name):
    call = long_calls(grid)[name]
    sent = []

    def interrupt():
        sent.append(time.monotonic())
        os.kill(os.getpid(), signal.SIGINT)

    timer = threading.Timer(1.0, interrupt)
    timer.start()
    try:
        with pytest.raises(KeyboardInterrupt):
            call()
        heard = time.monotonic()
    finally:
        timer.cancel()
        timer.join()
    assert heard - sent[0] < SOON


def longest_pause(work, look):
    """Seconds of the longest pause of this thread while `work` runs in a second and a third looks at the object."""
    with ThreadPoolExecutor(2) as pool:
        running = pool.submit(work)
        time.sleep(0.1)
        pause, now = 0.0, time.monotonic()
        looking = pool.submit(look)
        while not running.done():
            time.sleep(0.005)
            before, now = now, time.monotonic()
            pause = max(pause, now - before)
        looking.result(), running.result()
    return pause


def busy(grid, kind, size):
    """A matcher with a track that keeps it busy, the longer the larger the size."""
    if kind == "iema":
        step = 20.0 / size
        return geomag.Iema(grid, sigma=1e6, half_width=5000.0, step=(step, step)), flown(grid, 150)
    if kind == "sliding":
        track = flown(grid, round(400 * size))
        return geomag.SlidingContour(grid, length=200, transform="translation", converged_m=1e-9), track
    step = 12.0 / size
    return geomag.PosteriorMatcher(grid, half_width=5000.0, sigma=1e3, step=(step, step)), flown(grid, 60)


LOOKS = {
    "iema": lambda matcher: (matcher.n_feasible, matcher.feasible, repr(matcher)),
    "sliding": lambda matcher: (matcher.count, matcher.averaged, repr(matcher)),
    "posterior": lambda matcher: (matcher.n_feasible, matcher.n_samples, repr(matcher)),
}


@pytest.mark.parametrize("kind", LOOKS)
def test_a_getter_does_not_stop_the_other_threads(grid, kind):
    for size in (1.0, 1.4, 2.0):  # on a fast machine it takes more to tell
        matcher, track = busy(grid, kind, size)
        begun = time.monotonic()
        matcher.run(track)
        alone = time.monotonic() - begun
        if alone > 0.3:
            break
    else:
        pytest.skip(f"too short to tell: {alone:.2f} s")
    matcher, track = busy(grid, kind, size)
    pause = longest_pause(lambda: matcher.run(track), lambda: LOOKS[kind](matcher))
    assert pause < 0.5 * alone


def test_a_matcher_may_be_fed_by_several_threads(grid):
    matcher = geomag.PosteriorMatcher(grid, half_width=1000.0, sigma=1.0, tolerance_m=100)
    track = flown(grid, 40, (90.0, 60.0))

    def feed(part):
        for k in part:
            matcher.update(track.x[k], track.y[k], track.values[k])

    with ThreadPoolExecutor(4) as pool:
        for done in [pool.submit(feed, range(i, 40, 4)) for i in range(4)]:
            done.result()
    assert matcher.n_samples == 40
