# Everything starts here: a machine with Python 3.11 or newer and make is enough.
PYTHON ?= python3
BIN := .venv/bin
STAMP := .venv/.installed

.PHONY: demo test test-all test-pythons lint types docs studies clean

demo: $(STAMP)  ## render the report's picture on the built-in bust, recover, evaluate, print the table
	$(BIN)/render --config mozart_5lights.yaml --out run
	$(BIN)/evaluate run

test: $(STAMP)  ## the tests that take seconds
	$(BIN)/python -m pytest -n auto --dist worksteal -m "not slow"

test-all: $(STAMP)  ## all tests, slow ones too
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
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable ".[dev]"
	touch $(STAMP)

clean:
	rm -rf .venv run build dist *.egg-info
