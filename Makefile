PYTHON ?= python3
PIPELINE ?= pipeline/paper.toml
VENV := .venv
BIN := $(VENV)/bin
# CONSTRAINTS=constraints.txt installs the exact versions that were tested
INSTALL := .ci/install $(BIN)/python $(if $(CONSTRAINTS),--constraint $(CONSTRAINTS))

# where the machine has no C compiler, that of a package from PyPI
ZIG := $(if $(shell command -v cc || command -v gcc || command -v clang),,ziglang)

.DEFAULT_GOAL := all
.PHONY: all install dev test test-fast campaign gpu smoke lint types docs cortex-m check constraints clean help force

all: install ## set up, then run the paper's whole experiment (what is done already is not done again)
	$(BIN)/npred run $(PIPELINE)

install: $(VENV)/.installed ## set up .venv with npred in it, torch, by which networks are trained, and what reads recordings

dev: $(VENV)/.installed-dev ## the same with what the tests need

test: dev ## all tests, the files side by side on all cores
	$(BIN)/python -m pytest -n auto --dist loadfile --no-loadscope-reorder

test-fast: dev ## the tests that take no more than a few seconds each
	$(BIN)/python -m pytest -n auto --dist loadfile --no-loadscope-reorder -m "not slow and not campaign"

campaign: dev ## the longest tests: 10^5 steps in C and an FMU, hostile names, published networks, real stages killed
	$(BIN)/python -m pytest -n auto -m campaign

gpu: dev ## what only a machine with a GPU can test: graphs that are captured, stages there; prints times
	NPRED_TEST_GPU=1 $(BIN)/python -m pytest -m gpu -s tests/training/test_on_gpu.py

smoke: install ## the whole chain on a tiny problem
	$(BIN)/npred run pipeline/smoke.toml

lint: dev ## style
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: dev ## types
	$(BIN)/pyright

docs: dev ## the documentation, in docs/_build/html; a warning is an error
	$(BIN)/python -m sphinx -W --keep-going -n -q docs docs/_build/html

cortex-m: dev ## the controller of MODEL on a Cortex-M in QEMU: flash, RAM, stack, instructions, the host's results
	$(BIN)/python benchmarks/cortex_m.py $(or $(MODEL),$(PIPELINE):deeponet)

check: lint types test docs ## lint, types, tests and documentation

constraints: dev ## the versions in .venv, as constraints.txt
	$(BIN)/python -m pip freeze --exclude-editable --disable-pip-version-check > constraints.txt

clean: ## remove caches and build output; .venv and artifacts/ stay
	rm -rf build dist *.egg-info .pytest_cache .ruff_cache .hypothesis docs/_build
	find npred siblings tests -type d -name __pycache__ -exec rm -rf {} +

help: ## this list
	@awk -F ':.*## ' '/^[a-z-]+:.*## / { printf "%-11s %s\n", $$1, $$2 }' $(MAKEFILE_LIST)

$(BIN)/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null || \
		{ echo "expected Python 3.11 or newer, got $$($(PYTHON) --version 2>&1); name one with make PYTHON=..." >&2; exit 1; }
	$(PYTHON) -m venv $(VENV)

$(VENV)/.installed: pyproject.toml $(if $(CONSTRAINTS),force) | $(BIN)/python
	$(INSTALL) -e ".[identify,train]" $(ZIG)
	touch $@

$(VENV)/.installed-dev: pyproject.toml $(if $(CONSTRAINTS),force) | $(BIN)/python
	$(INSTALL) -e ".[dev]" $(ZIG)
	touch $@ $(VENV)/.installed
