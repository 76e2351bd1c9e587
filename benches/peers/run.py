"""Run every side-by-side table of this folder: `python benches/peers/run.py [--smoke] [names ...]`."""

from __future__ import annotations

import argparse
import datetime
import importlib
import platform
import sys
from pathlib import Path

import geomag

HERE = Path(__file__).resolve().parent
#: The naive forms of the tests' oracles are what a script has.
ORACLES = HERE.parents[1] / "tests"


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--smoke", action="store_true", help="small cases, to see that everything runs")
    parser.add_argument("--record", action="store_true", help="keep the result in benches/records")
    parser.add_argument("names", nargs="*", help="tables to run, all by default")
    arguments = parser.parse_args()
    sys.path[:0] = [str(HERE), str(ORACLES)]
    names = arguments.names or sorted(p.stem for p in HERE.glob("*.py") if p.stem != "run")
    lines = [
        f"geomag {geomag.__version__}, {geomag.instruction_set}, {platform.machine()}, Python {platform.python_version()}",
        f"{datetime.date.today()}; best times, one run; ratio = times as long as geomag",
        "",
        f"{'case':<30} {'what':<28} {'time':>12} {'ns each':>9} {'ratio':>9}",
    ]
    print("\n".join(lines))
    for name in names:
        for case, what, seconds, each, ratio in importlib.import_module(name).table(arguments.smoke):
            took = f"{1e6 * seconds:.2f} us" if seconds < 1e-3 else f"{1e3 * seconds:.2f} ms"
            line = f"{case:<30} {what:<28} {took:>12} {each:>9.3f} {ratio:>9.1f}"
            lines.append(line)
            print(line, flush=True)
    if arguments.record:
        record = HERE.parent / "records" / f"{datetime.date.today()}-{platform.machine()}.txt"
        record.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
