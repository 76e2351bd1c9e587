#!/usr/bin/env bash
# The crate's tests under AddressSanitizer. The crate holds no unsafe code, what it builds on does. The runtime ships with stable
# compilers, the flag is let through by RUSTC_BOOTSTRAP. Miri needs a nightly compiler with its component.
set -euo pipefail
cd "$(dirname "$0")/.."
host=$(rustc -vV | sed -n 's/^host: //p')
export RUSTC_BOOTSTRAP=1 RUSTFLAGS="-Zsanitizer=${1:-address}" ASAN_OPTIONS=detect_leaks=1 CARGO_TARGET_DIR="${CARGO_TARGET_DIR:-target}/sanitized"
cargo test -p geomag-core -p geomag-fuzz-targets --locked --quiet --target "$host" --tests
if cargo +nightly miri --version >/dev/null 2>&1; then
    # The parts without vectors of one machine, which Miri does not know.
    env -u RUSTFLAGS cargo +nightly miri test -p geomag-core --locked --lib -- state:: bounds:: track:: kalman:: navigation::navigator::integrity
else
    echo "Miri: needed a nightly compiler with the component miri, got none; not run" >&2
fi
