# The only entry points. Needs Rust and Python 3.11 or newer; everything else goes into .venv.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
RUST := Cargo.toml Cargo.lock $(shell find rust -name '*.rs' -o -name Cargo.toml)

.PHONY: fuzz-readers demo test test-rust test-python bench bench-smoke lint stubs docs build clean help fuzz soak leaks overflow sanitize valgrind

help:
	@echo "make demo   build everything and do the main job, with a picture in out/"
	@echo "make test   all tests, Rust and Python"
	@echo "make fuzz-readers   mutated inputs for all readers: 10^6 each for text, 10^5 for grids (about an hour)"
	@echo "make bench  criterion benches and the side-by-side tables, kept and written up in docs/reports/benchmarks.md"
	@echo "make lint   formatting, clippy, ruff, mypy, stubs against the module"
	@echo "make docs   the site, with the API of both languages"
	@echo "make fuzz   a million hostile cases a target, and hostile files (an hour; FUZZ_RUNS=, TARGET=)"
	@echo "make soak   a week of navigation at 1 Hz"
	@echo "make leaks, overflow, sanitize, valgrind   memory and arithmetic under watch (docs/hardening.md)"

$(BIN)/python:
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --upgrade pip
	$(BIN)/python -m pip install --quiet "maturin>=1.9,<2"

$(VENV)/built: $(BIN)/python pyproject.toml $(RUST)
	VIRTUAL_ENV=$(CURDIR)/$(VENV) $(BIN)/maturin develop --release --quiet
	@touch $@

$(VENV)/extras: $(BIN)/python pyproject.toml
	$(BIN)/python -c "import tomllib; p = tomllib.load(open('pyproject.toml', 'rb'))['project']; print('\n'.join(p['dependencies'] + [d for n, e in p['optional-dependencies'].items() if n != 'all' for d in e]))" > $(VENV)/requirements.txt
	$(BIN)/python -m pip install --quiet -r $(VENV)/requirements.txt
	@touch $@

$(VENV)/dev: $(VENV)/extras
	$(BIN)/python -m pip install --quiet --group test --group lint
	@touch $@

build: $(VENV)/built

demo: $(VENV)/built $(VENV)/extras
	@mkdir -p out
	$(BIN)/geomag demo --out out/demo.png

test: test-rust test-python

test-rust:
	cargo test --workspace --locked --quiet

test-python: $(VENV)/built $(VENV)/dev
	$(BIN)/python -m pytest

# Goes on where it was stopped; `make fuzz-readers SHARE=0.01` is a short form.
SHARE ?= 1
fuzz-readers: $(VENV)/built $(VENV)/dev
	@mkdir -p out
	$(BIN)/python tests/fuzzing.py all --share $(SHARE) --record out/fuzz-readers.json

bench: $(VENV)/built $(VENV)/dev
	cargo bench --locked
	$(BIN)/python benches/peers/run.py --record
	$(BIN)/python benches/report.py

bench-smoke: $(VENV)/built $(VENV)/dev
	cargo bench --locked -- --test
	$(BIN)/python benches/peers/run.py --smoke

FUZZ_RUNS ?= 1000000
TARGET ?=
# Cases by structure under libFuzzer's coverage, on the stable compiler, then files and lines for the readers.
fuzz: $(VENV)/built $(VENV)/dev
	fuzz/run.sh $(FUZZ_RUNS) $(TARGET)
	$(if $(TARGET),,$(MAKE) fuzz-readers)

soak: $(VENV)/built
	$(BIN)/python benches/soak.py

leaks: $(VENV)/built $(VENV)/dev
	$(BIN)/python tests/leaks.py 1000000

# The optimised build, as it ships, with the arithmetic of the test build.
overflow:
	RUSTFLAGS="-C overflow-checks=on -C debug-assertions=on" CARGO_TARGET_DIR=target/overflow \
		cargo test --release -p geomag-core -p geomag-fuzz-targets --locked --quiet

sanitize:
	tests/sanitize.sh

valgrind: $(VENV)/built $(VENV)/dev
	tests/valgrind.sh $(BIN)/python

lint: $(VENV)/built $(VENV)/dev stubs
	cargo fmt --all --check
	cargo clippy --workspace --all-targets --locked -- -D warnings
	$(BIN)/ruff format --check python tests examples benches
	$(BIN)/ruff check python tests examples benches
	$(BIN)/mypy
	$(BIN)/zizmor --offline --quiet .github

stubs: $(VENV)/built $(VENV)/dev
	$(BIN)/python rust/geomag-py/stub.py --check
	$(BIN)/python -m mypy.stubtest geomag._geomag --allowlist tests/stubtest-allowlist.txt

docs: $(VENV)/built $(VENV)/dev $(VENV)/site-tools
	RUSTDOCFLAGS="-D warnings" cargo doc -p geomag-core --no-deps --locked
	rm -rf docs/_rust && mkdir -p docs/_rust && cp -r target/doc/. docs/_rust/
	$(BIN)/sphinx-build -W --keep-going -q -b html docs site
	@echo "open site/index.html"

$(VENV)/site-tools: $(BIN)/python pyproject.toml
	$(BIN)/python -m pip install --quiet --group docs
	@touch $@

clean:
	cargo clean
	rm -rf $(VENV) out site dist docs/_rust
