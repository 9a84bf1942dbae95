# Needs only Python 3.11 or newer with its venv module, and make: everything else goes into .venv.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
# Two test processes: a worker count that also fits a 2-core machine.
WORKERS ?= 2
# Minutes after which `make test-slow` begins no further test.
SLOW_MIN ?= 25

.DEFAULT_GOAL := help
.PHONY: help warmup demo test test-slow test-all fuzz lint format docs clean

help:  ## list the targets
	@grep -E '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/^([a-z-]+):[^#]*## /make \1\t/'

$(BIN)/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' \
	  || { echo "craternav_fg needs Python 3.11 or newer, $(PYTHON) is $$($(PYTHON) -V); set PYTHON=python3.x" >&2; exit 1; }
	$(PYTHON) -m venv $(VENV)

$(VENV)/.core: pyproject.toml | $(BIN)/python
	$(BIN)/python -m pip install --quiet --editable .
	@touch $@

$(VENV)/.dev: pyproject.toml | $(BIN)/python
	$(BIN)/python -m pip install --quiet --editable '.[dev]'
	@touch $@ $(VENV)/.core

$(VENV)/.docs: pyproject.toml | $(BIN)/python
	$(BIN)/python -m pip install --quiet --editable '.[docs]'
	@touch $@ $(VENV)/.core

warmup: $(VENV)/.core  ## compile all kernels now, so that no first run waits for them
	$(BIN)/craternav warmup

demo: $(VENV)/.core  ## simulate a lunar descent, reconstruct it, compare the estimators (runs/demo)
	$(BIN)/craternav demo --force

test: $(VENV)/.dev  ## run the tests and the notebooks, but for the slow ones
	$(BIN)/python -m pytest -n $(WORKERS) --dist loadfile --no-loadscope-reorder

# Files in rotated order, not the largest first; the tests of a file share what they simulate.
test-slow: $(VENV)/.dev  ## run slow tests for 25 minutes (SLOW_MIN), beginning elsewhere every hour
	$(BIN)/python -m pytest -n $(WORKERS) --dist loadfile --no-loadscope-reorder -m slow --slow-budget-min $(SLOW_MIN)

test-all: $(VENV)/.dev  ## run every test, the slow ones too: hours
	$(BIN)/python -m pytest -n $(WORKERS) --dist loadfile -m "slow or not slow"

fuzz: $(VENV)/.dev  ## spoil 10,000 inputs: each must end in an answer or one line
	$(BIN)/python -m pytest tests/fuzz -m "slow or not slow"

lint: $(VENV)/.dev  ## style, types, import contract, docstrings
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/python -m pytest -q tests/test_docstrings.py

format: $(VENV)/.dev  ## rewrite the code in the house style
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

docs: $(VENV)/.docs  ## build the documentation, strictly (runs/site/index.html)
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --quiet

clean:  ## remove the environment and everything that was made
	rm -rf $(VENV) runs .pytest_cache .mypy_cache .ruff_cache .import_linter_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
