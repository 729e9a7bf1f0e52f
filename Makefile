# Everything starts from a Python 3.11 or newer and make; the virtual environment is made here.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/ready
BENCH_READY := $(VENV)/bench-ready
export JAX_PLATFORMS ?= cpu

.PHONY: help demo test test-all test-slow lint docs bench bank notebooks clean

help:
	@echo "make demo   simulate a bed and mold it into a goal, with pictures in runs/demo"
	@echo "make test   run the quick tests  make lint   ruff and pyright"
	@echo "make test-all   run them and the rest: browsers, wheel, documentation, kills, long compiles"
	@echo "make bench  measure speed beside what others use"
	@echo "make docs   build the documentation into build/site"
	@echo "make notebooks  run the lessons and keep their outputs"
	@echo "make bank   make the bundled banks again (20 minutes)"

$(VENV)/bin/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo "jshape needs Python 3.11 or newer; $(PYTHON) is older: make PYTHON=python3.12 ..."; exit 1; }
	$(PYTHON) -m venv $(VENV)

$(READY): $(VENV)/bin/python pyproject.toml constraints.txt
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[dev]'
	@touch $(READY)

$(BENCH_READY): $(READY)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[bench]'
	@touch $(BENCH_READY)

demo: $(READY)
	$(BIN)/jshape demo --out runs/demo --overwrite

test: $(READY)
	$(BIN)/python -m pytest -n auto --maxprocesses 4 -m 'not full and not slow'

test-all: test
	$(BIN)/python -m pytest -n auto --maxprocesses 4 --dist worksteal -m 'full and not slow'

test-slow: $(READY)
	$(BIN)/python -m pytest -m slow

lint: $(READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/pyright --pythonpath $(BIN)/python

docs: $(READY)
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --strict

bench: $(BENCH_READY)
	$(BIN)/python -m benchmarks.run --out bench

notebooks: $(READY)
	JSHAPE_CACHE=off $(BIN)/python -m notebooks.execute

bank: $(READY)
	$(BIN)/python -m benchmarks.experiments.banks weights

clean:
	rm -rf $(VENV) runs bench build
