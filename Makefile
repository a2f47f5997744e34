# `make plan` and `make test` are the two commands of the README; `make test-slow` runs the tests that `make test` leaves
# out. All three install what they need into .venv first.

VENV ?= .venv
OUT ?= out
BIN := $(VENV)/bin
SOURCES := pyproject.toml Cargo.toml Cargo.lock $(shell find rust -name Cargo.toml -o -name '*.rs')
# An installation that is not editable has copies of these.
PACKAGE := $(shell find python -type f -not -name '*.pyc' -not -name '*.so')

# Rust is in the virtual environment where scripts/install had to fetch it.
ifneq ($(wildcard $(VENV)/rust),)
export RUSTUP_HOME := $(abspath $(VENV))/rust/rustup
export CARGO_HOME := $(abspath $(VENV))/rust/cargo
endif
export PATH := $(abspath $(VENV))/bin:$(abspath $(VENV))/rust/cargo/bin:$(PATH)
export PYO3_PYTHON := $(abspath $(VENV))/bin/python

.PHONY: plan test test-slow studies docs processors compiled rust bounds msrv static collected python guard track install install-test clean

plan: install
	mkdir -p $(OUT)
	$(BIN)/needleplan plan four_obstacles -o $(OUT)/four_obstacles.h5 --figure $(OUT)/four_obstacles.png --force

# Cargo, pip and mypy leave one of two processors idle for most of their time, so they run side by side.
test:
	$(MAKE) --jobs=2 --output-sync=line install-test compiled
	$(MAKE) --jobs=2 --output-sync=line rust static collected
	$(MAKE) python

# Tests start thousands of interpreters. Without the files that Python compiles, each would compile the package again.
export PYTHONDONTWRITEBYTECODE :=

# Two processes of pytest use two processors. A third would collect all tests and make fixtures of modules once more: a third more
# processor time; only the slow tests, a quarter of whose time is waiting for robots and pages, gain by it. OpenBLAS with threads of its own would make small matrices several times slower.
python test-slow studies: export OPENBLAS_NUM_THREADS := 1

# Each process collects the tests by itself, so it gets no more files than it needs.
marked = $(shell grep --recursive --files-with-matches --include='test_*.py' 'mark\.$(1)\b' tests)

# The tests marked slow.
test-slow: install-test
	$(BIN)/python -m pytest -m "slow and not study" -n 3 --dist worksteal $(call marked,slow)
	$(BIN)/python -m pytest -m realtime $(call marked,realtime)

# Statistics of many runs: how often intervals hold, promises against executions, blind data sets, measured
# insertions, the thesis, and the site with its scenes and notebooks; bounds on hundreds of random problems; the numerical
# tests as on another kind of processor, the oldest Rust, and instruction counts, which compile the solver twice where no
# counts of this processor are known.
studies: install-test
	$(BIN)/python -m pytest -m study -n 2 --dist worksteal $(call marked,study)
	$(MAKE) --jobs=2 --output-sync=line bounds processors msrv guard

# The documentation site, in out/site/html.
docs: install-test
	$(BIN)/python docs/site/build.py $(OUT)/site

# With these variables cargo would share the two jobs of make, and compile one file at a time.
CARGO := env -u MAKEFLAGS -u MFLAGS cargo

# The tests of the crates without Python, compiled while pip installs. Where Rust is missing or too old, install fetches
# it, and what fails here fails again in `rust`, with its message.
compiled:
	@$(CARGO) test --package ppvi --package needle --package needleplan-guard --locked --no-run >/dev/null 2>&1 || true

rust:
	cargo fmt --all --check
	$(CARGO) clippy --all-targets --all-features --locked -- -D warnings
	$(CARGO) test --locked

bounds:
	$(CARGO) test --locked --test bounds -- --ignored
	$(CARGO) clippy --package needleplan-benches --all-targets --locked -- -D warnings

static:
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports --no-cache
	$(BIN)/stubtest needleplan._ppvi --mypy-config-file pyproject.toml

# Pytest compiles the tests with its own assertions when it first collects them; each process of it would. What fails here
# fails again in `python`, with its message.
collected:
	@$(BIN)/python -m pytest --collect-only --quiet >/dev/null 2>&1 || true

python:
	$(BIN)/python -m pytest -m "not slow and not study and not realtime" -n 2 --dist worksteal

# A line of times and instruction counts for benches/history.jsonl: some minutes on an idle machine, more than the slow set has
# to spare. Noise is no failure, so nothing depends on it.
track:
	$(BIN)/python benches/python/track.py

# The crates with the oldest Rust that Cargo.toml promises, and `ppvi` packed and checked alone, as a registry would
# build it.
MSRV = $(shell sed -n 's/^rust-version = "\(.*\)"/\1/p' Cargo.toml)
msrv:
	@if ! command -v rustup >/dev/null; then echo "msrv: skipped, rustup is missing"; \
	elif ! rustup toolchain install $(MSRV) --profile minimal --no-self-update; then \
	echo "msrv: skipped, Rust $(MSRV) cannot be fetched"; else \
	rustup run $(MSRV) $(CARGO) check --locked --target-dir target/msrv && \
	rm -rf target/msrv/package && \
	rustup run $(MSRV) $(CARGO) package --package ppvi --locked --allow-dirty --no-verify --target-dir target/msrv && \
	folder=$$(mktemp -d) && tar -xzf target/msrv/package/ppvi-*.crate -C $$folder && \
	rustup run $(MSRV) $(CARGO) check --manifest-path $$folder/ppvi-*/Cargo.toml --locked --target-dir target/msrv && \
	rm -r $$folder; fi

# OpenBLAS has kernels of its own for each kind of processor, and they round differently.
processors:
	PATH="$(abspath $(BIN)):$(PATH)" scripts/processors

# Instruction counts of the hot paths of the solver, by valgrind.
guard:
	@if [ ! -x benches/guard ]; then echo "guard: benches/guard is not there"; \
	elif command -v valgrind >/dev/null; then benches/guard; \
	else echo "guard: skipped, valgrind is missing"; fi

# An editable installation serves as well.
install: $(if $(wildcard $(VENV)/installed-test),install-test,$(VENV)/installed)
install-test: $(VENV)/installed-test

$(VENV)/installed: $(SOURCES) $(PACKAGE) scripts/install
	scripts/install $(VENV)
	touch $@

$(VENV)/installed-test: $(SOURCES) scripts/install
	scripts/install --test $(VENV)
	touch $(VENV)/installed $@

# Everything that the other targets write. Tables, recordings and figures of the user are left.
clean:
	rm -rf .venv out target dist build docs/_build .hypothesis .mypy_cache .pytest_cache .ruff_cache .import_linter_cache
	rm -f python/needleplan/_ppvi*.so python/needleplan/_ppvi*.so.new
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
