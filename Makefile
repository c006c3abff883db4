# make demo: the main job, Example (a) over a family of meshes.   make test: all tests.
# make docs: this project's site in out/docs.   make benchmark: what a Newton step costs,
# make benchmark-pieces: its pieces.
PYTHON ?= python3
VENV ?= .venv
LEVELS ?= 3
OUT ?= out/demo
ROWS ?= 1e0,1e1,1e2,1e3,1e4,default,default*,primal

BIN := $(VENV)/bin
export MPLBACKEND := Agg
export NGS_NUM_THREADS ?= 1
export OPENBLAS_NUM_THREADS ?= 1

.PHONY: demo test lint docs benchmark benchmark-pieces clean

demo: $(VENV)/.run
	$(BIN)/ngepc study table1 --levels $(LEVELS) --rows $(ROWS) --figures --out $(OUT)

test: $(VENV)/.test
	$(BIN)/python -m pytest

benchmark: $(VENV)/.run
	$(BIN)/ngepc study cost --levels 5 --out results

benchmark-pieces: $(VENV)/.test $(VENV)/.dev
	$(BIN)/python -m pytest benchmarks

docs: $(VENV)/.docs
	NGEPC_DOCS_EXECUTE=force $(BIN)/sphinx-build -W --keep-going -d out/doctrees -b html docs out/docs

lint: $(VENV)/.dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

$(BIN)/python:
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --upgrade pip

$(VENV)/.run: $(BIN)/python setup.cfg pyproject.toml
	$(BIN)/python -m pip install --quiet --editable ".[html]"
	touch $@

$(VENV)/.test: $(BIN)/python setup.cfg pyproject.toml
	$(BIN)/python -m pip install --quiet --editable ".[html,notebook,test,docs]"
	touch $@ $(VENV)/.run $(VENV)/.docs

$(VENV)/.docs: $(BIN)/python setup.cfg pyproject.toml
	$(BIN)/python -m pip install --quiet --editable ".[notebook,docs]"
	touch $@

$(VENV)/.dev: $(BIN)/python setup.cfg pyproject.toml
	$(BIN)/python -m pip install --quiet --editable ".[dev]"
	touch $@

clean:
	rm -rf $(VENV) build dist out *.egg-info
