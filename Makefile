# `make demo` and `make test` set up all they need in .venv, and run.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
export AMENT_PREFIX_PATH := $(CURDIR)/$(VENV)

SOURCES := setup.py setup.cfg package.xml \
	$(shell find secure_uav_planner config resource -type f -not -name '*.pyc')

.PHONY: demo test bench soak study clean

demo: $(VENV)/.view
	$(BIN)/python -m secure_uav_planner.demo

# Tests of nodes mostly wait for each other: two at a time.
test: $(VENV)/.test
	$(BIN)/python -m pytest -n 2 --dist loadfile

soak: $(VENV)/.test
	$(BIN)/python -m pytest -n 2 --dist worksteal -m soak -rP

bench: $(VENV)/.bench
	OMP_NUM_THREADS=1 $(BIN)/python -m secure_uav_planner.bench

study: $(VENV)/.study
	$(BIN)/python -m secure_uav_planner.study

clean:
	rm -rf $(VENV) build install log out

# One stamp for each set of optional dependencies; an edited source is installed anew.
$(VENV)/.%: $(SOURCES) | $(BIN)/pip
	$(BIN)/python -m pip install --quiet '.[ros,$*]'
	touch $@

$(BIN)/pip:
	@$(PYTHON) -c 'import sys; sys.exit(not (3, 10) <= sys.version_info[:2] <= (3, 13))' \
		|| { echo 'Python 3.10 to 3.13 is needed; name it as in: make PYTHON=python3.12'; exit 1; }
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --upgrade pip 'setuptools<80' wheel
