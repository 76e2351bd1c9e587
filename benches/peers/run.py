"""Run every side-by-side table of this folder: `python benches/peers/run.py [--smoke] [--record] [names ...]`.

`--record` keeps the run in benches/records, of which `python benches/report.py` makes docs/reports/benchmarks.md.
"""

from __future__ import annotations

import argparse
import datetime
import importlib
import importlib.metadata
import json
import math
import os
import platform
import subprocess
import sys
from pathlib import Path

import geomag

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
#: What is no table of its own.
OTHERS = {"run", "growth"}
PEERS = ["numpy", "scipy", "numba", "opencv-python-headless", "filterpy", "contourpy", "verde", "harmonica"]


def processor():
    """The processor's name as the system gives it."""
    information = Path("/proc/cpuinfo")
    if information.is_file():
        for line in information.read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()


def version(package):
    """Installed version, or None."""
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return None


def probed(smoke):
    """The machine's own limits and the kernels beside them, from the crate itself, for every instruction set that it has."""
    command = ["cargo", "run", "--release", "--locked", "--quiet", "-p", "geomag-benches", "--bin", "probe"]
    command += ["--", "--smoke"] if smoke else []
    found = {}
    for name in geomag.instruction_sets:
        held = {**os.environ, "GEOMAG_INSTRUCTION_SET": name}
        done = subprocess.run(command, cwd=ROOT, env=held, check=True, stdout=subprocess.PIPE, text=True)
        found[name] = json.loads(done.stdout)
    return found


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--smoke", action="store_true", help="small cases, to see that everything runs")
    parser.add_argument("--record", action="store_true", help="keep the result in benches/records")
    parser.add_argument("names", nargs="*", help="tables to run, all by default")
    arguments = parser.parse_args()
    sys.path[:0] = [str(HERE), str(ROOT / "tests")]
    record = {
        "date": str(datetime.date.today()),
        "geomag": geomag.__version__,
        "instruction_set": geomag.instruction_set,
        "machine": platform.machine(),
        "processor": processor(),
        "cores": os.cpu_count(),
        "python": platform.python_version(),
        "peers": {p: version(p) for p in PEERS},
        "rows": [],
        "growth": [],
    }
    print(f"geomag {geomag.__version__}, {geomag.instruction_set}, {record['processor']}, {record['cores']} cores")
    print(f"{record['date']}; best times, one run; ratio = times as long as geomag\n")
    print(f"{'case':<44} {'what':<30} {'time':>12} {'ns each':>9} {'ratio':>9}")
    for name in arguments.names or sorted(p.stem for p in HERE.glob("*.py") if p.stem not in OTHERS):
        for case, what, seconds, each, ratio in importlib.import_module(name).table(arguments.smoke):
            took = f"{1e6 * seconds:.2f} us" if seconds < 1e-3 else f"{1e3 * seconds:.2f} ms"
            print(f"{case:<44} {what:<30} {took:>12} {each:>9.3f} {ratio:>9.2f}", flush=True)
            row = {"case": case, "what": what, "seconds": seconds, "ratio": ratio}
            record["rows"].append(row | ({} if math.isnan(each) else {"nanoseconds_each": each}))
    if not arguments.names:
        for what, sizes, seconds in importlib.import_module("growth").growths(arguments.smoke):
            print(f"{what}: " + ", ".join(f"{n}: {1e3 * s:.3g} ms" for n, s in zip(sizes, seconds, strict=True)))
            record["growth"].append({"what": what, "sizes": sizes, "seconds": seconds})
        record["probe"] = probed(arguments.smoke)
        print(json.dumps(record["probe"], indent=1))
    if arguments.record:
        file = HERE.parent / "records" / f"{record['date']}-{record['machine']}.json"
        file.write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
