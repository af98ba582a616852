# `make demo` and `make test` set everything up by themselves; all else builds on them.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin

.PHONY: demo test lint docs bench build clean

demo: $(VENV)/installed
	$(BIN)/rtin demo demo

test: $(VENV)/installed-dev
	$(BIN)/python -m pytest -n auto

lint: $(VENV)/installed-dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

docs: $(VENV)/installed-dev
	$(BIN)/python -m sphinx -W --keep-going -q -j auto docs docs/_build/html
	@echo "Open docs/_build/html/index.html"

# make bench RASTERS='dem.tif other.tif' measures on your own
bench: $(VENV)/installed-dev
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[bench]'
	$(BIN)/python benchmarks/coarsening.py $(RASTERS)
	$(BIN)/python benchmarks/refinement.py
	$(BIN)/python benchmarks/distance.py $(RASTERS)
	$(BIN)/python benchmarks/tiles.py $(RASTERS)
	$(BIN)/python benchmarks/level_of_detail.py $(RASTERS)
	$(BIN)/python benchmarks/workers.py
	$(BIN)/python benchmarks/memory.py $(RASTERS)
	$(BIN)/python benchmarks/command_line.py
	$(BIN)/python benchmarks/opening.py $(RASTERS)
	$(BIN)/python benchmarks/promise.py $(RASTERS)

build: $(VENV)/installed-dev
	$(BIN)/python -m build

clean:
	rm -rf $(VENV) build dist demo docs/_build docs/_figures docs/auto_gallery .pytest_cache .mypy_cache .ruff_cache .hypothesis

$(VENV)/bin/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "rtin needs Python 3.11 or newer, got " + sys.version.split()[0] + "; set PYTHON=")'
	$(PYTHON) -m venv $(VENV)

$(VENV)/installed: $(VENV)/bin/python pyproject.toml
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable .
	@touch $@

$(VENV)/installed-dev: $(VENV)/bin/python pyproject.toml
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[dev]'
	@touch $@ $(VENV)/installed
