"""Matching sequences: delta modulation, the sampling rules, tuning."""

import pickle

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import geomag

values = st.lists(st.floats(-1e3, 1e3), max_size=120)


def oracle(v, quantum):
    """The recursion as it is printed."""
    staircase, codes, keep = None, [], []
    for k, value in enumerate(v):
        if staircase is None:
            staircase = value
            continue
        plus = value - staircase >= 0
        staircase += quantum if plus else -quantum
        codes.append(int(plus))
        if len(codes) > 1 and codes[-1] == codes[-2]:
            keep.append(k)
    return keep, codes


def test_the_papers_code_chooses_seven():
    code = "010111111000"
    staircase, v = 0.0, [0.0]
    for c in code:
        sign = 1 if c == "1" else -1
        v.append(staircase + 0.3 * sign)
        staircase += sign
    keep = geomag.delta_modulation(v, 1.0)
    assert "".join(map(str, keep.codes)) == code
    assert len(keep) == 7


@given(values, st.floats(0.01, 100))
def test_batch_streaming_and_oracle_agree(v, quantum):
    keep = geomag.delta_modulation(v, quantum)
    expected, codes = oracle(v, quantum)
    assert keep.tolist() == expected
    assert keep.codes.tolist() == codes
    stream = geomag.DeltaModulator(quantum)
    chosen = []
    for k, value in enumerate(v):
        stream = pickle.loads(pickle.dumps(stream))
        if stream.update(value):
            chosen.append(k)
    assert chosen == expected


@given(st.integers(0, 10_000), st.floats(0.5, 20), st.floats(20, 200))
def test_rules_one_and_two_hold(seed, quantum, cell):
    rng = np.random.default_rng(seed)
    along = np.cumsum(rng.uniform(1, 80, 150))
    v = 40 * np.sin(along / rng.uniform(100, 3000)) + rng.normal(size=150)
    chosen = geomag.choose_sequence(along, v, quantum=quantum, cell_m=cell)
    at = along[chosen["keep"]]
    assert (np.diff(at) >= cell * (1 - 1e-9)).all()
    if chosen["sampled_enough"]:
        assert (np.diff(np.concatenate([along[:1], at])) <= chosen["greatest_gap_m"] * (1 + 1e-9)).all()
    assert set(chosen["filled"]) <= set(chosen["keep"])


def test_bandwidth_agrees_with_numpy():
    rng = np.random.default_rng(0)
    for n in (64, 101):
        v = np.cumsum(rng.normal(size=n)) + 50_000
        power = np.abs(np.fft.rfft(v - v.mean())[1:]) ** 2 * 2
        if n % 2 == 0:
            power[-1] /= 2
        share = np.cumsum(power) / power.sum()
        expected = (1 + np.searchsorted(share, 0.96)) / (n * 30.0)
        assert geomag.energy_bandwidth(v, 30.0) == pytest.approx(expected)
    assert geomag.energy_bandwidth(np.full(20, 7.0), 30.0) == 0


def test_errors():
    with pytest.raises(geomag.InvalidInputError, match="quantum"):
        geomag.delta_modulation([1.0, 2.0], 0.0)
    with pytest.raises(geomag.NotFiniteError):
        geomag.delta_modulation([1.0, np.nan], 1.0)
    with pytest.raises(geomag.NotFiniteError):
        geomag.DeltaModulator(1.0).update(np.inf)
    with pytest.raises(geomag.InvalidInputError):
        geomag.choose_sequence([0.0, 2.0, 1.0], [0.0, 1.0, 2.0], quantum=1.0, cell_m=1.0)


def test_tuning():
    x = np.arange(0.0, 50_000.0, 250.0)
    grid = geomag.GridMap(150 * np.sin(x / 5100)[None, :] * np.cos(x / 6100)[:, None], x, x)
    k = np.arange(110.0)
    tx, ty = 8000 + 230 * k, 9000 + 170 * k
    planned = geomag.Track(tx, ty, grid.sample(tx, ty))
    options = {"sigma": 1.0, "offset_m": 790.0, "max_length": 10, "quanta": np.arange(1.0, 8.0), "draws": 6, "seed": 3}
    best = geomag.tune_sequence(grid, planned, **options)
    again = geomag.tune_sequence(grid, planned, threads=1, **options)
    np.testing.assert_equal(best, again)
    assert len(best["settings"]) == 8 * 7
    assert best["objective"] == min(s["objective"] for s in best["settings"])
    swarm = geomag.tune_sequence(grid, planned, method="bpso", **options)
    assert swarm["objective"] <= 1.01 * best["objective"]
    calls = []
    geomag.tune_sequence(grid, planned, progress=lambda done, total: calls.append((done, total)), **options)
    assert calls[-1][0] == calls[-1][1]
    with pytest.raises(geomag.InvalidInputError, match="at least one weight > 0"):
        geomag.tune_sequence(grid, planned, weights=(0, 0), **options)
    with pytest.raises(geomag.InvalidInputError, match="method"):
        geomag.tune_sequence(grid, planned, method="annealing", **options)
    with pytest.raises(geomag.TooFewSamplesError):
        geomag.tune_sequence(grid, planned, **{**options, "quanta": [1e6]})
