"""Everything that streams, through any order of calls, against a twin that nobody disturbs: a new stream is a line in test_streams.py."""

from __future__ import annotations

import contextlib
import copy
import os
import pickle
import threading

import numpy as np
import pytest
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import (
    RuleBasedStateMachine,
    initialize,
    invariant,
    precondition,
    rule,
    run_state_machine_as_test,
)
from test_streams import GRID, INDICATED, READINGS, STREAMS, state

import geomag
from geomag.stream import Sample, feed

LONG = "GEOMAG_LONG" in os.environ

#: What some streams take beside samples: name -> calls by number.
BESIDE = {
    "Navigator": [
        lambda s: s.correct_position((-20.0, 30.0), [[400.0, 10.0], [10.0, 300.0]]),
        lambda s: s.correct_velocity((40.5, 29.0), 0.5),
        lambda s: s.reset(900.0, 1100.0, [[900.0, 0.0], [0.0, 900.0]]),
        lambda s: s.predict_bound([9e3, 9001.0], [900.0, 940.0], [1000.0, 1030.0]),
    ],
    "FieldNavigator": [lambda s: s.bound([[900.0, 1000.0], [950.0, 1040.0]], 10.0, 5.0, 53.13)],
    "PosteriorMatcher": [lambda s: s.fix()],
    "Iema": [lambda s: s.fix() if hasattr(s, "fix") else None],
}


def in_a_thread(work):
    """What a call gives, or raises, in a thread of its own."""
    out = []

    def run():
        try:
            out.append(repr(work()))
        except geomag.GeomagError as error:
            out.append(repr(error))

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    thread.join(timeout=60)
    assert out, "deadlock"
    return out[0]


def here(work):
    try:
        return repr(work())
    except geomag.GeomagError as error:
        return repr(error)


def machine(name):
    make, step, refused = STREAMS[name]

    class Twins(RuleBasedStateMachine):
        """One stream takes everything, its twin only what is taken."""

        @initialize()
        def begin(self):
            self.tried, self.twin, self.k = make(), make(), 0

        @rule(thread=st.booleans())
        @precondition(lambda self: self.k < 40)
        def update(self, thread):
            got = (in_a_thread if thread else here)(lambda: step(self.tried, self.k))
            assert got == here(lambda: step(self.twin, self.k))
            self.k += 1

        @rule(which=st.integers(0, 9), thread=st.booleans())
        def refuse(self, which, thread):
            if name == "InsFeedback" and which % len(refused) == 0:
                return  # its first bad call begins with a good one
            before = state(self.tried)
            bad = refused[which % len(refused)]
            got = (in_a_thread if thread else here)(lambda: bad(self.tried))
            assert "Error(" in got, got
            assert state(self.tried) == before

        @rule(how=st.sampled_from(["pickle", "copy", "deepcopy", "thread"]))
        def move(self, how):
            if how == "thread":
                data = pickle.dumps(self.tried)
                moved = []
                thread = threading.Thread(target=lambda: moved.append(pickle.loads(data)))
                thread.start()
                thread.join(timeout=60)
                self.tried = moved[0]
            elif how == "pickle":
                self.tried = pickle.loads(pickle.dumps(self.tried))
            else:
                self.tried = getattr(copy, how)(self.tried)

        @rule()
        def a_copy_goes_its_own_way(self):
            before = state(self.tried)
            other = copy.copy(self.tried)
            here(lambda: step(other, self.k))
            here(lambda: step(other, self.k + 1))
            assert state(self.tried) == before

        @rule()
        @precondition(lambda self: hasattr(self.tried, "reset") and name != "Navigator")
        def reset(self):
            self.tried.reset()
            self.twin.reset()
            assert state(self.tried) == state(make())

        @rule(which=st.integers(0, 9))
        @precondition(lambda _: name in BESIDE)
        def call_beside(self, which):
            call = BESIDE[name][which % len(BESIDE[name])]
            assert here(lambda: call(self.tried)) == here(lambda: call(self.twin))

        @rule()
        def look_from_threads(self):
            """Readers of an object change nothing, however many they are."""
            before = state(self.tried)
            names = [n for n in dir(self.tried) if not n.startswith("_") and not callable(getattr(self.tried, n, None))]

            def look():
                for n in names:
                    with contextlib.suppress(geomag.GeomagError):
                        getattr(self.tried, n)
                pickle.dumps(self.tried)
                return "looked"

            threads = [threading.Thread(target=look, daemon=True) for _ in range(3)]
            for thread in threads:
                thread.start()
            for thread in threads:
                thread.join(timeout=60)
                assert not thread.is_alive(), "deadlock"
            assert state(self.tried) == before

        @invariant()
        def is_as_its_twin(self):
            if hasattr(self, "tried"):
                assert state(self.tried) == state(self.twin)

    return Twins


@pytest.mark.parametrize("name", STREAMS)
def test_any_order_of_calls_is_as_undisturbed(name):
    examples, steps = (200, 60) if LONG else (10, 25)
    quiet = [HealthCheck.too_slow, HealthCheck.filter_too_much, HealthCheck.data_too_large]
    run_state_machine_as_test(
        machine(name),
        settings=settings(
            max_examples=examples, stateful_step_count=steps, deadline=None, database=None, derandomize=True,
            suppress_health_check=quiet,
        ),
    )  # fmt: skip


@pytest.mark.parametrize("name", STREAMS)
def test_threads_on_one_stream_lose_no_update(name):
    """Samples from four threads at once, and readers between: every update is whole, and as many are seen as were taken."""
    make, step, _ = STREAMS[name]
    stream, taken, lock = make(), [], threading.Lock()

    def feeding(first):
        for k in range(first, 24, 4):
            try:
                step(stream, k)
            except geomag.GeomagError:
                continue  # a time that another thread has passed
            with lock:
                taken.append(k)
            pickle.dumps(stream)

    threads = [threading.Thread(target=feeding, args=(first,), daemon=True) for first in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(timeout=120)
        assert not thread.is_alive(), "deadlock"
    count = next((getattr(stream, n) for n in ("n_samples", "n_steps", "steps", "count") if hasattr(stream, n)), None)
    assert taken
    if isinstance(count, int):
        assert count == len(taken)
    restore, arguments = stream.__reduce__()
    assert state(restore(*arguments)) == state(stream)


@pytest.mark.parametrize("name", ["Iema", "PosteriorMatcher", "SlidingContour"])
@pytest.mark.parametrize("restart", [True, False])
def test_fed_from_a_pipe_in_pieces_is_as_at_once(name, restart):
    samples = [
        Sample(float(x), float(y), float(z), float(k))
        for k, (x, y, z) in enumerate(zip(*INDICATED, READINGS, strict=True))
    ]
    whole, pieces = STREAMS[name][0](), STREAMS[name][0]()
    at_once = [repr(event) for event in feed(whole, samples, restart=restart)]
    by_piece = []
    for begin in range(0, len(samples), 7):
        pieces = pickle.loads(pickle.dumps(pieces))
        by_piece += [repr(event) for event in feed(pieces, samples[begin : begin + 7], restart=restart)]
    assert by_piece == at_once
    assert state(pieces) == state(whole)


def test_many_threads_on_one_map():
    """One map, eight threads that read it in every way: to the last bit what one thread reads."""
    track = geomag.Track(*INDICATED, READINGS)
    place = np.linspace(100, 3800, 500)

    def all_of_it():
        sampled = GRID.sample(place, place[::-1], interpolation="bicubic")
        fix = geomag.match_grid(GRID, track, half_width=150.0)
        posterior = geomag.match_posterior(GRID, track, half_width=150.0, sigma=0.5)
        return sampled.tobytes(), repr(fix), repr(posterior), pickle.dumps(GRID)

    alone, got = all_of_it(), []
    threads = [threading.Thread(target=lambda: got.append(all_of_it()), daemon=True) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(timeout=120)
    assert len(got) == 8
    assert all(g == alone for g in got)
