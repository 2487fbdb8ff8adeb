# Two commands do everything on a fresh machine with python3.11, gcc, make and git: `make bench` and `make test`.
PYTHON ?= python3.11
BIN := .venv/bin
STAMP := .venv/.locked

.PHONY: setup bench test check test-socketcan docs proto lock clean

setup: $(STAMP)

# The stamp is younger than the lock file only when every pinned package was installed from it.
$(STAMP): requirements.lock pyproject.toml
	test -x $(BIN)/python || $(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes -r requirements.lock
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation -e .
	touch $(STAMP)

bench: setup
	$(BIN)/hil bench

test: setup check
	$(BIN)/pytest

check: setup
	$(BIN)/ruff check .
	$(BIN)/mypy

test-socketcan: setup
	$(BIN)/python -m servohil.tests_socketcan

lock:
	uv pip compile pyproject.toml --extra dev --generate-hashes --python-version 3.11 --no-header --no-annotate --upgrade -o requirements.lock

clean:
	rm -rf .venv build *.egg-info .pytest_cache .mypy_cache .ruff_cache
