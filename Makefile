# Needs Python >= 3.11 and make; everything else is installed into $(VENV) on first use.
#   make test PYTHON=/usr/bin/python3.12 VENV=/tmp/env ARGS="-k energy"

PYTHON ?= python3
VENV ?= .venv
BIN = $(VENV)/bin
RUN = $(VENV)/.installed-run
DEV = $(VENV)/.installed-dev
SITE = $(VENV)/.installed-site
PIP = $(BIN)/python -m pip --quiet --disable-pip-version-check

.DEFAULT_GOAL := help
.DELETE_ON_ERROR:
.PHONY: help venv benchmark policies leaderboard figures notebooks site test test-all test-share test-ecosystem test-foreign test-oldest check format bench constraints platforms clean

help: ## list the targets
	@awk -F ':.*## ' '/^[a-z-]+:.*## / { printf "  make %-15s %s\n", $$1, $$2 }' Makefile

venv: $(DEV) ## create $(VENV) with everything, in the known-good versions

# What the benchmark needs comes first, a seventh of the whole; tests, types and training add
# the rest to the same environment. The project itself apart: given hashes, pip would demand
# one for it as well. `pip check` compares what was installed with the ranges in pyproject.toml.
$(RUN): pyproject.toml constraints-run.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "ves_gym needs Python >= 3.11, got " + sys.version.split()[0] + "; try: make PYTHON=/path/to/python3.12")'
	$(PYTHON) -m venv $(VENV)
	$(PIP) install --require-hashes -r constraints-run.txt
	$(PIP) install --no-deps --no-build-isolation -e .
	$(PIP) check
	@touch $@

$(DEV): $(RUN) constraints.txt
	$(PIP) install --require-hashes -r constraints.txt
	$(PIP) check
	@touch $@

$(SITE): $(DEV) constraints-site.txt
	$(PIP) install --require-hashes -r constraints-site.txt
	$(PIP) check
	@touch $@

benchmark: ARGS ?= --quick
benchmark: $(RUN) ## run the planning benchmark; the whole of it: make benchmark ARGS=
	$(BIN)/ves-gym benchmark $(ARGS)

policies: $(DEV) ## train every released policy again, going on where it stopped (90 min)
	$(BIN)/python scripts/training.py --train out/train
	$(BIN)/python scripts/training.py out/train
	$(BIN)/python scripts/results.py

leaderboard: $(DEV) ## answer what the board lacks; write its page
	$(BIN)/python scripts/leaderboard.py $(ARGS)
	$(BIN)/python scripts/results.py

figures: $(DEV) ## make the documentation's pictures again; one: make figures ARGS=wiring.svg
	$(BIN)/python scripts/figures.py $(ARGS)

notebooks: $(DEV) ## run the notebooks in empty folders and store what they show
	$(BIN)/python scripts/notebooks.py $(ARGS)

site: $(SITE) ## build the documentation site in out/site, warnings are errors
	$(BIN)/python scripts/site.py $(ARGS)

# One thread per worker: two workers share the cores, and results do not depend on a BLAS pool.
test test-all test-share test-foreign test-oldest: export OMP_NUM_THREADS = 1
test test-all test-share test-foreign test-oldest: export OPENBLAS_NUM_THREADS = 1
test test-all test-share test-foreign test-oldest: export MKL_NUM_THREADS = 1
# Modules are compiled once: with this set, every process that a test starts would do it again.
test test-all test-share test-foreign test-oldest: export PYTHONDONTWRITEBYTECODE =

test: $(DEV) ## run the tests
	$(BIN)/python -m pytest -n 2 $(ARGS)

test-all: $(DEV) ## run the tests, the slow ones included
	$(BIN)/python -m pytest -n 2 -m "" $(ARGS)

test-share: $(DEV) ## three minutes of the slow tests; others: make test-share DRAW=any-text
	$(BIN)/python -m pytest -n 2 -m slow --share 180 --draw "$(DRAW)" $(ARGS)

test-ecosystem: ## run other packages on the environments, each in an environment of its own
	$(PYTHON) scripts/ecosystem.py $(ARGS)

# Each judge has an environment of its own, with the versions that its file of tests/foreign pins.
.venv-foreign/%/.installed: tests/foreign/%.txt
	$(PYTHON) -m venv $(@D)
	$(@D)/bin/python -m pip --quiet --disable-pip-version-check install -r $<
	@touch $@

test-foreign: export VES_GYM_FOREIGN = 1
test-foreign: $(DEV) $(patsubst tests/foreign/%.txt,.venv-foreign/%/.installed,$(wildcard tests/foreign/*.txt)) ## compare with Drake, Basilisk and Exudyn, each in an environment of its own
	$(BIN)/python -m pytest -m "" -s tests/foreign $(ARGS)

check: $(DEV) ## format, lint and types, as CI runs them
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	@mkdir -p out && awk '/^```/ {code = /python/; next} code' README.md > out/readme.py
	$(BIN)/mypy out/readme.py
	$(BIN)/pyright --pythonpath $(BIN)/python

format: $(DEV) ## rewrite the sources: format, sorted imports, safe fixes
	$(BIN)/ruff check --fix-only .
	$(BIN)/ruff format .

bench: $(DEV) ## side-by-side timings
	$(BIN)/python -m benchmarks.run $(ARGS)

# uv resolves; it is no dependency, so it lives in a directory that goes again.
UV = tools=$$(mktemp -d) && trap 'rm -rf "$$tools"' EXIT && $(PYTHON) -m venv "$$tools" && \
	"$$tools/bin/python" -m pip install --quiet --disable-pip-version-check uv==0.13.9 && "$$tools/bin/uv"

COMPILE = pip compile --quiet --universal --python-version 3.11 --fork-strategy fewest \
	--generate-hashes --no-annotate --no-header pyproject.toml

constraints: ## rewrite the known-good versions, keeping what still fits; newest: ARGS=--upgrade
	@$(UV) $(COMPILE) --extra dev --output-file constraints.txt $(ARGS) && \
		"$$tools/bin/uv" $(COMPILE) --extra build --extra report \
		--constraint constraints.txt --output-file constraints-run.txt && \
		"$$tools/bin/uv" $(COMPILE) --extra build --extra report --extra docs \
		--constraint constraints.txt --output-file constraints-site.txt

platforms: $(DEV) ## write the table of docs/install.md: what has wheels where
	@$(UV) --version && $(BIN)/python scripts/platforms.py "$$tools/bin/uv"

test-oldest: ## run the tests on the oldest versions that pyproject.toml admits
	rm -rf $(VENV)-oldest && $(PYTHON) -m venv $(VENV)-oldest
	@$(UV) pip install --quiet --python $(VENV)-oldest/bin/python --resolution lowest-direct -e ".[dev]"
	$(VENV)-oldest/bin/python -m pytest -n 2 $(ARGS)

clean: ## remove the environment, caches and results
	rm -rf $(VENV) $(VENV)-oldest .venv-ecosystem .venv-foreign .mypy_cache .pytest_cache .ruff_cache .hypothesis build dist out
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
