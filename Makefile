# `make demo` and `make test` set up everything they need. PYTHON chooses the interpreter (3.10 or newer).
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
JOBS ?= 2

.PHONY: install demo test test-all lint docs dist clean

install: $(VENV)/.installed-test

demo: $(VENV)/.installed
	$(BIN)/siamloc demo overwrite=true

# `make test` leaves out the slow tests and tries fewer examples of a property; `make test-all` leaves out nothing.
test: $(VENV)/.installed-test lint
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest -n $(JOBS) --dist worksteal -m "not slow"

test-all: $(VENV)/.installed-test lint
	OMP_NUM_THREADS=1 HYPOTHESIS_PROFILE=thorough $(BIN)/python -m pytest -n $(JOBS) --dist worksteal

lint: $(VENV)/.installed-test
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

# The site, in site/: it opens from the disk and loads nothing from elsewhere.
docs: $(VENV)/.installed-test
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --quiet --strict

# The files of a release, in dist/, checked as an index would check them. They hold no tests and no pages.
dist: | $(VENV)/bin/python
	rm -rf dist
	$(BIN)/python -m pip install --quiet --constraint constraints.txt 'build>=1.2' 'twine>=6'
	$(BIN)/python -m build --quiet
	$(BIN)/python -m twine check --strict dist/*

# A stamp remembers that the packages are there; it is older than its reasons when they change.
$(VENV)/bin/python:
	$(PYTHON) -m venv $(VENV)

$(VENV)/.installed: pyproject.toml constraints.txt | $(VENV)/bin/python
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable '.[simulate]'
	touch $@

$(VENV)/.installed-test: pyproject.toml constraints.txt | $(VENV)/bin/python
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable '.[test]'
	touch $@ $(VENV)/.installed

clean:
	rm -rf $(VENV) .mypy_cache .ruff_cache .pytest_cache .hypothesis build dist site
