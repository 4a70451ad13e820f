# SPDX-License-Identifier: Apache-2.0
# make demo | test | lint | bench : each installs what it needs into .venv and may be repeated.

VENV := $(CURDIR)/.venv
BIN := $(VENV)/bin
DATA := package.xml $(shell find bags config examples launch resource -type f -not -path '*/__pycache__/*')

# Ignore the environment of a ROS installation or of another virtual environment.
unexport PYTHONPATH LD_LIBRARY_PATH _ROS_WHEELS_BOOTSTRAP_COMPLETE
# Without bytecode on disk each of the many processes of the tests compiles all modules again.
unexport PYTHONDONTWRITEBYTECODE
export AMENT_PREFIX_PATH := $(VENV)

.PHONY: demo test lint bench clean
.DELETE_ON_ERROR:

demo: $(VENV)/.installed-ros,messages,report $(VENV)/.shared
	$(BIN)/python tools/build_messages.py --optional
	$(BIN)/gsdf warm-up
	$(BIN)/gsdf demo

# The workers of pytest use all cores; threads of BLAS would only wait for each other.
# The kernels compile on one core, so the messages are built meanwhile.
test: export OPENBLAS_NUM_THREADS := 1
test: $(VENV)/.installed-ros,messages,test $(VENV)/.shared
	$(BIN)/gsdf warm-up & $(BIN)/python tools/build_messages.py && wait $$!
	$(BIN)/pytest -n auto --dist loadfile --no-loadscope-reorder $(PYTEST_ARGS)

lint: $(VENV)/.installed-ros,messages,test
	$(BIN)/ruff check
	$(BIN)/mypy

bench: $(VENV)/.installed-bench $(VENV)/.shared
	$(BIN)/python -m benchmarks field
	$(BIN)/python -m benchmarks solve

clean:
	rm -rf $(VENV) build *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis

# The first Python of 3.10 to 3.13 that runs and has venv.
$(BIN)/python:
	@for python in python3 python3.13 python3.12 python3.11 python3.10; do \
	  if $$python -c 'import ensurepip, sys; sys.exit(not (3, 10) <= sys.version_info < (3, 14))' 2>/dev/null; \
	  then set -x; $$python -m venv $(VENV) && exec $@ -m pip install --quiet 'setuptools>=77,<80'; fi; done; \
	echo 'no Python 3.10 to 3.13 with venv found: install one, or python3-venv beside it' >&2; exit 1

# Editable installation: changes of the sources need no new installation.
# Python compiles the modules that it imports; pip would compile all of them.
$(VENV)/.installed-%: setup.py pyproject.toml | $(BIN)/python
	$(BIN)/python -m pip install --quiet --no-compile --no-build-isolation --editable '.[$*]'
	touch $@

# An editable installation does not include share/ with models, launch files and settings.
$(VENV)/.shared: setup.py $(DATA) | $(BIN)/python
	$(BIN)/python -W ignore setup.py --quiet install_data --install-dir $(VENV)
	touch $@
