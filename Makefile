# Every target works from a fresh clone: the virtual environment is made on the way.
PYTHON ?= python3
VENV ?= .venv
BIN = $(VENV)/bin
STAMP = $(VENV)/.installed
# Exact versions. Those for Python 3.12 and newer hold the newest jax, which needs such a Python.
CONSTRAINTS := $(shell $(PYTHON) -c "import sys; print('constraints.txt' if sys.version_info < (3, 12) else 'constraints-3.12.txt')")

EXTRAS = minari,hf,hdf5,wandb,search,cluster
# jax2onnx asks for an older orbax-checkpoint than ours, so it has an environment of its own.
ONNX_VENV = $(VENV)-onnx
ONNX_STAMP = $(ONNX_VENV)/.installed
# The library `imitation` asks for an older gymnasium than ours.
IMITATION_VENV = $(VENV)-imitation
IMITATION_STAMP = $(IMITATION_VENV)/.installed

# Options of tests/mutants/run.py, tests/physics/random_steps.py and tests/kills/run.py, e.g. MUTANTS="--shard 1/4"
# PHYSICS="--task ant" KILLS="--commands imitate --kills 3".
MUTANTS ?=
PHYSICS ?=
KILLS ?=

.PHONY: help install demo test test-extras test-onnx onnx test-newest test-slow test-mutants test-physics test-repeats test-kill lint docs release bench bench-imitation data clean

help:
	@echo "make demo       learn a reward in the left maze, use it in the right one (the main job)"
	@echo "make test       the fast tests"
	@echo "make test-extras  the tests of Minari, HuggingFace, HDF5, W&B, Optuna and submitit, which it installs"
	@echo "make onnx       an environment for eairl export --format onnx: $(ONNX_VENV)/bin/eairl"
	@echo "make test-onnx  the tests of ONNX, in that environment"
	@echo "make test-newest  the fast tests on another Python, python3.13, with the newest jax"
	@echo "make test-slow  the tests that train to convergence"
	@echo "make test-mutants  plants bugs, each of which a test must catch"
	@echo "make test-physics  takes 10 million random steps in each task"
	@echo "make test-repeats  compares runs that should be equal: repeated, in other chunks, on other devices"
	@echo "make test-kill  kills runs at random moments and at file events; they must end with the same bits"
	@echo "make bench      what an iteration costs beside its simulation"
	@echo "make bench-imitation  our GAIL, AIRL and EAIRL beside those of the library imitation (half an hour)"
	@echo "make data       train the experts and collect the shipped demonstrations anew"
	@echo "make lint       ruff and pyright"
	@echo "make docs       the documentation site, in build/site"
	@echo "make release    a wheel and an sdist in dist/, checked"

$(STAMP): pyproject.toml $(CONSTRAINTS)
	@echo "== making a virtual environment in $(VENV)"
	@$(PYTHON) -m venv $(VENV)
	@echo "== installing eairl_jax and the exact versions of $(CONSTRAINTS) (about 0.7 GB; a minute or two)"
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint $(CONSTRAINTS) --editable ".[test]"
	@touch $(STAMP)
	@echo "== installed"

install: $(STAMP)

demo: $(STAMP)
	@echo "== EAIRL: its reward r(s,a), learned in the left maze, used in the right one; 4 seeds"
	@$(BIN)/eairl transfer point_maze_left point_maze_right --method eairl --rule last --seeds 4

test: $(STAMP)
	@echo "== the fast tests, on two processes"
	@$(BIN)/python -m pytest -m "not slow" -n 2 --dist loadfile

test-extras: $(STAMP)
	@echo "== installing the extras $(EXTRAS)"
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint $(CONSTRAINTS) --editable ".[test,$(EXTRAS)]"
	@echo "== the tests that need them"
	@$(BIN)/python -m pytest -m extras -n 2 --dist loadfile

$(ONNX_STAMP): pyproject.toml $(CONSTRAINTS)
	@echo "== making a virtual environment in $(ONNX_VENV)"
	@$(PYTHON) -m venv $(ONNX_VENV)
	@$(ONNX_VENV)/bin/python -m pip install --quiet --disable-pip-version-check --constraint $(CONSTRAINTS) --editable ".[test,onnx]"
	@$(ONNX_VENV)/bin/python -m pip install --quiet --disable-pip-version-check --no-deps jax2onnx==0.17.0
	@touch $(ONNX_STAMP)
	@echo "== installed"

onnx: $(ONNX_STAMP)

test-onnx: $(ONNX_STAMP)
	@echo "== the tests of ONNX"
	@$(ONNX_VENV)/bin/python -m pytest -m onnx

# For whoever has such a Python, e.g. make test-newest NEWEST=python3.14
NEWEST ?= python3.13
test-newest:
	@$(MAKE) test PYTHON=$(NEWEST) VENV=$(VENV)-newest

test-slow: $(STAMP)
	@echo "== the tests that train to convergence"
	@$(BIN)/python -m pytest -m slow

test-mutants: $(STAMP)
	@echo "== bugs, planted one after another in a copy (an hour on two cores; MUTANTS=\"--shard 1/4\" for a quarter)"
	@$(BIN)/python tests/mutants/run.py $(MUTANTS)

test-physics: $(STAMP)
	@$(BIN)/python tests/physics/random_steps.py $(PHYSICS)

test-repeats: $(STAMP)
	@$(BIN)/python tests/repeats/run.py

test-kill: $(STAMP)
	@$(BIN)/python tests/kills/run.py $(KILLS)

bench: $(STAMP)
	@$(BIN)/eairl bench point_maze_left

$(IMITATION_STAMP):
	@echo "== making a virtual environment in $(IMITATION_VENV)"
	@$(PYTHON) -m venv $(IMITATION_VENV)
	@$(IMITATION_VENV)/bin/python -m pip install --quiet --disable-pip-version-check imitation==1.0.1 "gymnasium[mujoco]==0.29.1"
	@touch $(IMITATION_STAMP)
	@echo "== installed"

bench-imitation: $(STAMP) $(IMITATION_STAMP)
	@$(BIN)/python tests/speed/imitation/run.py --python $(IMITATION_VENV)/bin/python

data: $(STAMP)
	@for task in pendulum:4 point_maze_left:4 point_maze_right:4 point_maze_middle:4 point_maze_double:4 swimmer:2 half_cheetah:2 ant:1 crippled_ant:1; do \
		name=$${task%:*}; \
		$(BIN)/eairl expert $$name --seeds $${task#*:} && \
		$(BIN)/eairl demos $$name --out experiments/data/$$name.npz || exit 1; \
	done
	@$(BIN)/eairl expert half_cheetah --seeds 1 --set iterations=85 snapshot_every=85 --out runs/expert-half_cheetah-half
	@$(BIN)/eairl demos half_cheetah --expert runs/expert-half_cheetah-half --out experiments/data/half_cheetah.half.npz
	@for style in 0.02-b8dd61 0.5-cc5bf6; do \
		task="half_cheetah?control_cost=$$(echo $$style | cut -d- -f1)"; \
		$(BIN)/eairl expert "$$task" --seeds 1 && \
		$(BIN)/eairl demos "$$task" --out experiments/data/half_cheetah-control_cost-$$style.npz || exit 1; \
	done
	@for iterations in 1 40 60 120 180; do \
		name=half_cheetah-$$iterations; \
		$(BIN)/eairl expert half_cheetah --seeds 1 --set iterations=$$iterations snapshot_every=$$iterations --out runs/expert-$$name && \
		$(BIN)/eairl demos half_cheetah --expert runs/expert-$$name --episodes 4 --out experiments/data/unseen/$$name.npz || exit 1; \
	done

lint: $(STAMP)
	@echo "== installing ruff and pyright"
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint $(CONSTRAINTS) --editable ".[dev]"
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/pyright --pythonpath $(BIN)/python

docs: $(STAMP)
	@echo "== installing the site's builder"
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint $(CONSTRAINTS) --editable ".[docs]"
	$(BIN)/python docs/generate.py
	$(BIN)/zensical build --strict
	@echo "== open build/site/index.html"

release: $(STAMP)
	@echo "== installing the tools of a release"
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint $(CONSTRAINTS) --editable ".[release]"
	$(BIN)/python tools/release.py

clean:
	rm -rf $(VENV) $(ONNX_VENV) $(IMITATION_VENV) build dist *.egg-info
