"""The same bits for any number of threads and from run to run; between instruction sets a bound, measured by running each that the machine has."""

from __future__ import annotations

import json
import os
import subprocess
import sys

import numpy as np
import pytest

import geomag

#: What is computed, in a process of its own, since the set is chosen once. Prints names and numbers.
WORK = """
import json, sys
import numpy as np, geomag
threads = int(sys.argv[1])
out = {}
rng = np.random.default_rng(5)
waves = [(a, *w, p) for a, w, p in zip(rng.normal(0, 20, 40), rng.normal(0, 1 / 900, (40, 2)), rng.uniform(0, 6, 40))]
axis = np.arange(120.0) * 200
def value(x, y):
    return sum(a * np.sin(u * x + v * y + p) for a, u, v, p in waves)
for kind in ("float64", "float32"):
    grid = geomag.GridMap(value(axis, axis[:, None]).astype(kind), axis, axis, sigma=2.0)
    k = np.arange(30)
    x, y = 9000 + 170.0 * k, 8000 + 140.0 * k
    values = value(x, y)
    track = geomag.Track(x - 430, y + 310, values)
    out[kind + " sample"] = np.concatenate([grid.sample(x, y, interpolation=m) for m in ("bilinear", "bicubic")])
    for criterion in ("msd", "mad", "prod", "ncc"):
        fix = geomag.match_grid(grid, track, criterion, half_width=1500.0, surface=True, threads=threads)
        out[f"{kind} {criterion} surface"] = np.asarray(fix.surface, dtype=float).ravel()
        out[f"{kind} {criterion} offset"] = np.array(fix.offset)
    fix = geomag.match_posterior(grid, track, half_width=1500.0, sigma=2.0, tolerance_m=200.0)
    out[kind + " posterior"] = np.array([*fix.offset, fix.risk, *np.ravel(fix.covariance_m2)])
    fix = geomag.match_contour(grid, track, radius_m=1500.0, starts="grid", refine=True, sigma=2.0)
    out[kind + " contour"] = np.array(fix.offset)
    iema = geomag.Iema(grid, sigma=4.0, half_width=1500.0)
    for a, b, v in zip(x - 430, y + 310, values):
        step = iema.update(a, b, v)
    out[kind + " iema"] = np.array(step.best_offset)
rng = np.random.default_rng(3)
points = rng.uniform(-2e5, 2e5, 300), rng.uniform(-2e5, 2e5, 300), rng.uniform(-1e4, 0, 300)
model = geomag.RectangularHarmonicModel.fit(*points, np.column_stack([np.sin(points[0] / 5e4), np.cos(points[1] / 4e4), points[2] / 1e4]), order=6, period_ratio=1.5, ridge=1e-6)
out["harmonic field"] = model.field(*points).ravel()
out["harmonic gradient"] = model.gradient(*points).ravel()
print(json.dumps({"set": geomag.instruction_set, "numbers": {k: [float(v).hex() for v in a] for k, a in out.items()}}))
"""


def run(instruction_set, threads):
    environment = {**os.environ, "GEOMAG_INSTRUCTION_SET": instruction_set}
    done = subprocess.run(
        [sys.executable, "-c", WORK, str(threads)],
        env=environment,
        capture_output=True,
        check=False,
        text=True,
        timeout=120,
    )
    assert done.returncode == 0, done.stderr
    answer = json.loads(done.stdout)
    assert answer["set"] == instruction_set
    return {k: np.array([float.fromhex(v) for v in a]) for k, a in answer["numbers"].items()}


@pytest.fixture(scope="module")
def answers():
    return {s: run(s, 1) for s in geomag.instruction_sets}


def test_threads_and_runs_do_not_change_a_bit(answers):
    best = geomag.instruction_sets[-1]
    for threads in (2, 3):
        again = run(best, threads)
        for name, numbers in answers[best].items():
            assert numbers.tobytes() == again[name].tobytes(), name


def test_sets_differ_in_the_last_digits_alone(answers):
    reference = answers["scalar"]
    for instruction_set, numbers in answers.items():
        for name, wanted in reference.items():
            single = name.startswith("float32") and ("surface" in name or "posterior" in name or "offset" in name)
            assert np.mean(np.isfinite(wanted)) > 0.5, name
            scale = np.nanmax(np.abs(wanted))
            difference = np.nanmax(np.abs(numbers[name] - wanted)) / scale
            assert np.array_equal(np.isnan(numbers[name]), np.isnan(wanted)), (instruction_set, name)
            assert difference <= (3e-5 if single else 1e-9), (instruction_set, name, difference)


def test_a_set_that_the_machine_has_not_is_refused_by_name():
    environment = {**os.environ, "GEOMAG_INSTRUCTION_SET": "x86-64-v9"}
    done = subprocess.run(
        [sys.executable, "-c", "import geomag._geomag"], env=environment, capture_output=True, check=False, text=True
    )
    assert done.returncode != 0
    for word in ("GEOMAG_INSTRUCTION_SET", "scalar", "x86-64-v9"):
        assert word in done.stderr


if __name__ == "__main__":
    everything = {s: run(s, 1) for s in geomag.instruction_sets}
    for name, wanted in everything["scalar"].items():
        differences = [np.nanmax(np.abs(a[name] - wanted)) / np.nanmax(np.abs(wanted)) for a in everything.values()]
        print(f"{name:<28}", *(f"{s} {d:.1e}" for s, d in zip(everything, differences, strict=True)))
