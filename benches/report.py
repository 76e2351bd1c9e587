"""Makes docs/reports/benchmarks.md of the newest record: `python benches/report.py [record.json]`."""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "reports" / "benchmarks.md"
RECORDS = ROOT / "benches" / "records"

#: Multiply-adds a vector of offsets and a sample, and how many an instruction set starts at a time (head of lattice/mod.rs).
LATTICE_MULTIPLY_ADDS = 4.1
LANES = {"x86-64-v4": 8, "x86-64-v3": 4, "neon": 2, "scalar": 1}

HEAD = """# Benchmark report

Made by `python benches/report.py` of the record that `python benches/peers/run.py --record` kept (`make bench` runs both tables); nothing here is
written by hand. Every row compares its answer with that of the others before it counts. Times are the least of several, all of one run; ratios carry
over between machines, times do not.
"""

LIMITS = """
## The lattice kernel and its limit

The limit of the kernel is its multiply-adds, {adds} for a vector of offsets and one sample (worked out at the head of `lattice/mod.rs`), and a loop of nothing
but independent multiply-adds of the same width, timed in the same run, tells what one takes. Each instruction set of the machine in turn, one thread; with two threads of
{set}: {two64:.3f} ns in float64, {two32:.3f} in float32. Memory is read at {large:.1f} GB/s, what fits the first caches at {small:.0f} GB/s.

| instruction set | ns a multiply-add | float64, ns an offset and sample | times its limit | float32 | times its limit |
|---|---|---|---|---|---|
"""

NUMBA = """
That explains the distance from a compiled Numba loop below: it gathers the four nodes of every offset one by one and gains little from wider vectors, while the
kernel shares weights and reads whole rows, so that its time is that of the multiply-adds.
"""


def took(seconds):
    """A time as a person reads it."""
    for unit, size in (("us", 1e-6), ("ms", 1e-3)):
        if seconds < 1e3 * size:
            return f"{seconds / size:.3g} {unit}"
    return f"{seconds:.3g} s"


def limits(record):
    """The kernels against what the machine can do."""
    best = record["probe"][record["instruction_set"]]
    yield LIMITS.format(
        adds=LATTICE_MULTIPLY_ADDS,
        set=record["instruction_set"],
        two64=best["lattice_float64_2_threads_ns"],
        two32=best["lattice_float32_2_threads_ns"],
        large=best["read_large_gigabytes_per_s"],
        small=best["read_small_gigabytes_per_s"],
    ).rstrip()
    for name, probe in record["probe"].items():
        limit = LATTICE_MULTIPLY_ADDS * probe["multiply_add_ns"] / LANES[name]
        double, single = (probe[f"lattice_{kind}_1_threads_ns"] for kind in ("float64", "float32"))
        # Without vectors of ours the compiler makes its own, and the loop's limit is not the kernel's.
        shares = ("", "") if name == "scalar" else (f"{double / limit:.2f}", f"{2 * single / limit:.2f}")
        yield f"| {name} | {probe['multiply_add_ns']:.3f} | {double:.3f} | {shares[0]} | {single:.3f} | {shares[1]} |"
    yield NUMBA
    yield "| points scattered over 300 x 300 nodes | ns a point |\n|---|---|"
    for kind in ("float64", "float32"):
        for method in ("bilinear", "bicubic"):
            yield f"| {method}, {kind} | {best[f'sample_{method}_{kind}_ns']:.1f} |"


def tables(record):
    """Rows side by side, a table a case."""
    yield "\n## Side by side\n\nRatio: times as long as geomag.\n"
    yield "| case | what | time | ratio |\n|---|---|---|---|"
    last = None
    for row in record["rows"]:
        yield f"| {'' if row['case'] == last else row['case']} | {row['what']} | {took(row['seconds'])} | {row['ratio']:.3g} |"
        last = row["case"]


def exponent(sizes, seconds):
    """Slope of the logarithms by least squares."""
    x, y = [math.log(n) for n in sizes], [math.log(s) for s in seconds]
    mx, my = sum(x) / len(x), sum(y) / len(y)
    return sum((a - mx) * (b - my) for a, b in zip(x, y, strict=True)) / sum((a - mx) ** 2 for a in x)


def growth(record):
    """How cost grows with each size."""
    yield "\n## How the cost grows\n\nExponent: of the cost in the size, over all sizes by least squares and between the last two.\n"
    yield "| with | sizes | times | exponent | at the end |\n|---|---|---|---|---|"
    for one in record["growth"]:
        sizes, seconds = one["sizes"], one["seconds"]
        over, last = exponent(sizes, seconds), exponent(sizes[-2:], seconds[-2:])
        yield (
            f"| {one['what']} | {', '.join(f'{n:,}' for n in sizes)} | {', '.join(map(took, seconds))} "
            f"| {over:.2f} | {last:.2f} |"
        )


def page(record):
    """The whole page."""
    peers = ", ".join(f"{name} {version}" for name, version in record["peers"].items() if version)
    about = (
        f"\n{record['date']}; geomag {record['geomag']} with {record['instruction_set']}, {record['processor']}, {record['cores']} cores, "
        f"Python {record['python']}; {peers}."
    )
    return "\n".join([HEAD.rstrip(), about, *limits(record), *tables(record), *growth(record)]) + "\n"


def newest():
    """The record that the page is made of."""
    return max(RECORDS.glob("*.json"))


if __name__ == "__main__":
    file = Path(sys.argv[1]) if len(sys.argv) > 1 else newest()
    PAGE.write_text(page(json.loads(file.read_text(encoding="utf-8"))), encoding="utf-8")
