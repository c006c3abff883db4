# make demo: the main job, Example (a) over a family of meshes.
# make check: the quick tests, while one works.   make test: all tests.   make coverage: what they
# run of the package, in out/coverage.   make lint: style.
# make campaigns: random problems and extreme data by all methods, bounds of random problems,
# derivatives beside differences: minutes, results/fuzz.*, robustness.*, crossings.*, derivatives.*.
# make results: every committed result again, those of today's code left out; make results
# NAMES="table1 counts": some of them.  Hours; an interrupted run goes on with the same line.
# make mutants: faults put into the package, and the tests that notice them: an hour or two.
# make test-petsc: the tests of large bodies once more, with Debian's PETSc.
# make docs: this project's site in out/docs, and as one file, out/ngepc-docs.zip.   make benchmark: what a Newton step costs,
# make benchmark-pieces: its pieces.
PYTHON ?= python3
VENV ?= .venv
LEVELS ?= 3
FINEST = $(word $(LEVELS),833 1601 3201 6273 12545 24833)
OUT ?= out/demo
ROWS ?= 1e0,1e1,1e2,1e3,1e4,default,default*,primal

# Debian builds petsc4py for its own Python and numpy 1, so it has a second environment.
PETSC_VENV ?= .venv-petsc
PETSC_PYTHON ?= /usr/bin/python3
PETSC_DIR ?= $(lastword $(wildcard /usr/lib/petscdir/petsc*/*-real))

# As many as there are cores: one more and all take a tenth longer, pushed out of the caches.
WORKERS ?= $(shell getconf _NPROCESSORS_ONLN)
# The long files come first, tests/conftest.py has them.
PARALLEL = -n $(WORKERS) --dist loadfile --no-loadscope-reorder

BIN := $(VENV)/bin
# Setuptools warns of every editable installation of a package whose folder stands beside it.
INSTALL = PYTHONWARNINGS=ignore $(BIN)/python -m pip install --quiet
export MPLBACKEND := Agg
export NGS_NUM_THREADS ?= 1
export OPENBLAS_NUM_THREADS ?= 1
# Workers and the processes that tests start read what another one has compiled.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: demo check test campaigns mutants results test-petsc coverage lint docs benchmark benchmark-pieces clean

demo: $(VENV)/.run
	$(BIN)/ngepc study table1 --levels $(LEVELS) --rows $(ROWS) --out $(OUT)
	$(BIN)/ngepc solve lshape --nodes $(FINEST) --figures $(OUT) --save $(OUT)/lshape.npz
	$(BIN)/ngepc solve lshape --nodes $(FINEST) --gamma 1e4 --start coarse --figures $(OUT)/regularised
	$(BIN)/ngepc report $(OUT)/lshape.npz

check: $(VENV)/.test
	$(BIN)/python -m pytest $(PARALLEL) -m "not slow and not notebooks"

test: $(VENV)/.test
	$(BIN)/python -m pytest $(PARALLEL)

coverage: $(VENV)/.test
	$(BIN)/python -m pytest $(PARALLEL) -m "not notebooks" --cov \
	  --cov-report=term:skip-covered --cov-report=html:out/coverage

campaigns: $(VENV)/.test
	PYTHONPATH=tests $(BIN)/python -m campaigns --out results fuzz --count 100 --seed 1
	PYTHONPATH=tests $(BIN)/python -m campaigns --out results robustness
	PYTHONPATH=tests $(BIN)/python -m campaigns --out results crossings
	PYTHONPATH=tests $(BIN)/python -m campaigns --out results squares
	PYTHONPATH=tests $(BIN)/python -m campaigns --out results rings
	PYTHONPATH=tests $(BIN)/python -m campaigns --out results cubes
	PYTHONPATH=tests $(BIN)/python -m campaigns --out results derivatives
	PYTHONPATH=tests $(BIN)/python -m campaigns --out results equilibria
	PYTHONPATH=tests $(BIN)/python -m campaigns --out results cones
	PYTHONPATH=tests $(BIN)/python -m campaigns --out results receipts --count 10
	PYTHONPATH=tests $(BIN)/python -m campaigns --out results limits
	PYTHONPATH=tests $(BIN)/python -m campaigns --out results shakedown

results: $(VENV)/.test
	PYTHONPATH=tests $(BIN)/python -m campaigns.remake $(NAMES)

mutants: $(VENV)/.test
	PYTHONPATH=tests $(BIN)/python -m campaigns --out results mutants --count 320 --seed 2

test-petsc: $(PETSC_VENV)/.test
	PETSC_DIR=$(PETSC_DIR) NGEPC_NEEDS_PETSC=1 $(PETSC_VENV)/bin/python -m pytest tests/local

benchmark: $(VENV)/.run
	$(BIN)/ngepc study cost --levels 5 --out results

benchmark-pieces: $(VENV)/.test $(VENV)/.dev
	$(BIN)/python -m pytest benchmarks

docs: $(VENV)/.docs
	NGEPC_DOCS_EXECUTE=force $(BIN)/sphinx-build -j 4 -W --keep-going -d out/doctrees -b html docs out/docs
	cd out && rm -f ngepc-docs.zip && $(abspath $(BIN))/python -m zipfile -c ngepc-docs.zip docs

lint: $(VENV)/.dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

$(BIN)/python:
	$(PYTHON) -m venv $(VENV)
	$(INSTALL) --upgrade pip

$(VENV)/.run: $(BIN)/python setup.cfg pyproject.toml
	$(INSTALL) --editable ".[html]"
	touch $@

$(VENV)/.test: $(BIN)/python setup.cfg pyproject.toml
	$(INSTALL) --editable ".[html,notebook,test,docs]"
	touch $@ $(VENV)/.run $(VENV)/.docs

$(PETSC_VENV)/.test: setup.cfg pyproject.toml
	$(PETSC_PYTHON) -m venv --system-site-packages $(PETSC_VENV)
	$(PETSC_VENV)/bin/python -m pip install --quiet "numpy<2" --editable ".[test]"
	touch $@

$(VENV)/.docs: $(BIN)/python setup.cfg pyproject.toml
	$(INSTALL) --editable ".[notebook,docs]"
	touch $@

$(VENV)/.dev: $(BIN)/python setup.cfg pyproject.toml
	$(INSTALL) --editable ".[dev]"
	touch $@

clean:
	rm -rf $(VENV) $(PETSC_VENV) build dist out *.egg-info
