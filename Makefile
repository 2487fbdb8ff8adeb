# Two commands do everything on a fresh machine with python3.11, gcc, make and git: `make bench` and `make test`.
PYTHON ?= python3.11
BIN := .venv/bin
STAMP := .venv/.locked

.PHONY: setup bench test nightly mutants check test-socketcan proto lock mdf clean

setup: $(STAMP)

# The stamp is younger than the lock file only when every pinned package was installed from it.
$(STAMP): requirements.lock pyproject.toml
	test -x $(BIN)/python || $(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes -r requirements.lock
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation -e .
	touch $(STAMP)

# For example: make bench BENCH_OPTIONS="--lockstep --seed 3"
BENCH_OPTIONS ?=
bench: setup
	$(BIN)/hil bench $(BENCH_OPTIONS)

# Filters compile for minutes: on all processors. What starts real processes comes after them, out of a filled cache.
test: setup check
	$(BIN)/pytest -n 2 --dist loadfile -m "not nightly and not processes"
	$(BIN)/pytest -n 2 --dist loadfile -m "processes and not nightly"

# Grids and long Monte Carlo that take minutes.
nightly: setup
	$(BIN)/pytest -m nightly --timeout 3000

# Every small mistake in the safety gate and the end-to-end protection must be found by their tests; ten minutes.
mutants: setup
	$(BIN)/python tests/mutation/run.py

check: setup
	$(BIN)/ruff check .
	$(BIN)/mypy

# Exit code 77: qemu is not to be had on this machine.
test-socketcan: setup
	$(BIN)/python tests/socketcan_vm/run.py

# Regenerate the Protobuf schema and its classes from the Snapshot's fields.
proto: setup
	$(BIN)/python -m servohil.hil.telemetry.make_proto

# `hil log export --to mf4` runs asammdf from here: it must never be importable beside the controller.
mdf:
	test -x .venv-mdf/bin/python || $(PYTHON) -m venv .venv-mdf
	.venv-mdf/bin/python -m pip install --quiet --disable-pip-version-check asammdf==8.8.28

lock:
	uv pip compile pyproject.toml --extra dev --generate-hashes --python-version 3.11 --no-header --no-annotate --upgrade -o requirements.lock

clean:
	rm -rf .venv .venv-mdf build *.egg-info .pytest_cache .mypy_cache .ruff_cache
