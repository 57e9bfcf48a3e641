# Everything starts here: a machine with Python 3.11 or newer and make is enough.
PYTHON ?= python3
BIN := .venv/bin
STAMP := .venv/.installed
COMPILED := .venv/.compiled

# Tests start some hundreds of processes, each of which would compile all sources again without the bytecode on disk.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: demo test test-slow test-all test-pythons lint types docs studies clean

demo: $(COMPILED)  ## render the report's picture small, recover by three methods, evaluate, say what was found
	$(BIN)/render --config demo.yaml --out run-demo --overwrite
	$(BIN)/evaluate run-demo

test: $(COMPILED)  ## the tests that take seconds
	$(BIN)/python -m pytest -n auto --dist worksteal -m "not slow"

test-slow: $(COMPILED)  ## the tests that take minutes
	$(BIN)/python -m pytest -n auto --dist worksteal -m slow

test-all: $(COMPILED)  ## all tests, slow ones too
	$(BIN)/python -m pytest -n auto --dist worksteal

test-pythons:  ## the tests that take seconds, by each of Python 3.11, 3.12, 3.13 that is on PATH
	.ci/pythons

lint: $(STAMP) types  ## format, lint, types
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .

types: $(STAMP)  ## the type checker, over links in the shape of the installed package
	mkdir -p build/types/huesphere
	ln -sfn $(CURDIR)/huesphere/*.py $(addprefix $(CURDIR)/,configs scenes render recover eval) build/types/huesphere/
	MYPYPATH=build/types $(BIN)/mypy

docs: $(STAMP)  ## the documentation's site, in build/site: gallery and notebook are run, nothing is fetched
	$(BIN)/python docs/site.py build/site

studies: $(STAMP)  ## run the studies and keep their results as pages of the documentation: half an hour
	$(BIN)/python docs/studies.py

$(STAMP): pyproject.toml constraints.txt
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --disable-pip-version-check --constraint constraints.txt --editable ".[dev]"
	touch $(STAMP)

$(COMPILED): $(STAMP)  # Numba keeps what it compiles, so that only this first run waits for it
	@echo "set-up: compiling the numerical code, once (about a minute of processor time)"
	$(BIN)/render --config demo.yaml --set camera.resolution=[32,32] --out build/compile --overwrite
	@$(BIN)/evaluate build/compile > build/compile.txt
	touch $(COMPILED)

clean:
	rm -rf .venv run run-demo build dist *.egg-info
