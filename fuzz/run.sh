#!/usr/bin/env bash
# Runs one target, or all, for so many cases each: fuzz/run.sh [CASES [TARGET ...]]. What is found lands in fuzz/artifacts: mend it, and
# keep the file under fuzz/seeds/TARGET, where `cargo test` runs it from then on.
set -euo pipefail
cd "$(dirname "$0")"
cases=${1:-1000000}
shift || true
host=$(rustc -vV | sed -n 's/^host: //p')
cargo build --release --locked --target "$host"
program=${CARGO_TARGET_DIR:-target}/$host/release/geomag-fuzz
targets=("$@")
[ ${#targets[@]} -gt 0 ] || mapfile -t targets < <(sed -n 's/^    Target { name: "\([a-z_]*\)".*/\1/p' targets/src/lib.rs)
for target in "${targets[@]}"; do
    mkdir -p "corpus/$target" "artifacts/$target" "seeds/$target"
    echo "== $target"
    # One thread computes, so that coverage belongs to its case. Cheap cases are varied more often: else the dearest searches, which reach the
    # most, take nearly all of the time.
    GEOMAG_FUZZ=$target RAYON_NUM_THREADS=1 "$program" -runs="$cases" -max_len=512 -len_control=0 -entropic_scale_per_exec_time=1 -timeout=${FUZZ_TIMEOUT:-30} \
        -rss_limit_mb=2048 -artifact_prefix="artifacts/$target/" -print_final_stats=1 "corpus/$target" "seeds/$target" 2>&1 |
        grep -aE "panicked|^ +[0-9]+: .*geomag|SUMMARY|DONE|stat::" || true
    if compgen -G "artifacts/$target/[cto]*-*" >/dev/null; then
        echo "found: fuzz/artifacts/$target" >&2
        exit 1
    fi
done
