#!/usr/bin/env bash
# A small part of the extension's tests under valgrind: invalid reads and writes, and jumps on what was never written, in the extension.
# tests/valgrind.sh PYTHON. Needs valgrind; some minutes.
set -euo pipefail
cd "$(dirname "$0")/.."
python=${1:-python3}
command -v valgrind >/dev/null || { echo "needed: valgrind" >&2; exit 1; }
log=$(mktemp)
# The interpreter's own allocator takes memory apart behind valgrind's back.
PYTHONMALLOC=malloc OPENBLAS_NUM_THREADS=1 RAYON_NUM_THREADS=2 valgrind --tool=memcheck --leak-check=no --num-callers=30 --log-file="$log" \
    --error-limit=no "$python" tests/valgrind_calls.py
# A report is the extension's where the innermost frame is; those of the interpreter and of NumPy are not ours to mend.
if grep -qE "  at 0x.*_geomag\.abi3" "$log"; then
    grep -E -B2 -A8 "  at 0x.*_geomag\.abi3" "$log" | head -80
    echo "valgrind: reports in the extension ($log)" >&2
    exit 1
fi
grep "ERROR SUMMARY" "$log"
echo "valgrind: no report in the extension"
rm -f "$log"
