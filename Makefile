# Needs Python >= 3.11 and make; everything else is installed into $(VENV) on first use.
#   make test PYTHON=/usr/bin/python3.12 VENV=/tmp/env ARGS="-k energy"

PYTHON ?= python3
VENV ?= .venv
BIN = $(VENV)/bin
STAMP = $(VENV)/.installed

.DEFAULT_GOAL := help
.DELETE_ON_ERROR:
.PHONY: help venv benchmark policies leaderboard test test-all test-oldest check format bench constraints clean

help: ## list the targets
	@awk -F ':.*## ' '/^[a-z-]+:.*## / { printf "  make %-12s %s\n", $$1, $$2 }' Makefile

venv: $(STAMP) ## create $(VENV) with the known-good versions

# In two steps: given hashes, pip would demand one for the editable project as well.
# `pip check` then compares what was installed with the ranges in pyproject.toml.
$(STAMP): pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "ves_gym needs Python >= 3.11, got " + sys.version.split()[0] + "; try: make PYTHON=/path/to/python3.12")'
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes -r constraints.txt
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation -e .
	$(BIN)/python -m pip check --disable-pip-version-check
	@touch $@

benchmark: ARGS ?= --quick
benchmark: $(STAMP) ## run the planning benchmark; the whole of it: make benchmark ARGS=
	$(BIN)/ves-gym benchmark $(ARGS)

policies: $(STAMP) ## train every released policy again, going on where it stopped (90 min)
	for config in ves_gym/baselines/configs/*.toml; do $(BIN)/ves-gym train $$config --resume $(ARGS) || exit 1; done
	$(BIN)/python docs/_training.py out/train

leaderboard: $(STAMP) ## answer, verify and enter what the board lacks; write its page
	$(BIN)/python docs/_leaderboard.py $(ARGS)

# One thread per worker: two workers share the cores, and results do not depend on a BLAS pool.
test test-all test-oldest: export OMP_NUM_THREADS = 1
test test-all test-oldest: export OPENBLAS_NUM_THREADS = 1
test test-all test-oldest: export MKL_NUM_THREADS = 1

test: $(STAMP) ## run the tests
	$(BIN)/python -m pytest -n 2 $(ARGS)

test-all: $(STAMP) ## run the tests, the slow ones included
	$(BIN)/python -m pytest -n 2 -m "" $(ARGS)

check: $(STAMP) ## format, lint and types, as CI runs them
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy

format: $(STAMP) ## rewrite the sources: format, sorted imports, safe fixes
	$(BIN)/ruff check --fix-only .
	$(BIN)/ruff format .

bench: $(STAMP) ## side-by-side timings
	$(BIN)/python -m benchmarks.run $(ARGS)

# uv resolves; it is no dependency, so it lives in a directory that goes again.
UV = tools=$$(mktemp -d) && trap 'rm -rf "$$tools"' EXIT && $(PYTHON) -m venv "$$tools" && \
	"$$tools/bin/python" -m pip install --quiet --disable-pip-version-check uv && "$$tools/bin/uv"

constraints: ## rewrite constraints.txt, keeping what still fits; newest: ARGS=--upgrade
	@$(UV) pip compile --quiet pyproject.toml --extra report --extra dev --universal \
		--python-version 3.11 --fork-strategy fewest --generate-hashes --no-annotate \
		--no-header --output-file constraints.txt $(ARGS)

test-oldest: ## run the tests on the oldest versions that pyproject.toml admits
	rm -rf $(VENV)-oldest && $(PYTHON) -m venv $(VENV)-oldest
	@$(UV) pip install --quiet --python $(VENV)-oldest/bin/python --resolution lowest-direct -e ".[dev]"
	$(VENV)-oldest/bin/python -m pytest -n 2 $(ARGS)

clean: ## remove the environment, caches and results
	rm -rf $(VENV) $(VENV)-oldest .mypy_cache .pytest_cache .ruff_cache .hypothesis build dist out
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
