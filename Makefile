# `make demo` and `make test` set up all they need in .venv, and run; so does
# `make demo MISSION=city`.
# `make compat` tests with the oldest, Ubuntu's and the newest versions of what it builds on, and
# with ROS 2 Kilted.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
PACKAGE := .
export AMENT_PREFIX_PATH := $(abspath $(VENV))

# The machine, unless PyPI has wheels of ROS for it: see docs/install.md.
WITHOUT_ROS := $(shell $(PYTHON) -c 'import platform, sys; \
	machine = sys.platform, platform.machine(); \
	print("" if machine == ("linux", "x86_64") else "-".join(machine))')

SOURCES := setup.py setup.cfg build_backend.py pyproject.toml package.xml \
	$(wildcard */requirements.txt */*/requirements.txt) \
	$(shell find secure_uav_planner config launch resource scripts -type f -not -name '*.pyc')

# The oldest versions have no wheels for Python 3.13, and Ubuntu 24.04 has 3.12.
COMPAT_PYTHON ?= $(shell python3.12 -c 'print("python3.12")' 2>/dev/null || echo $(PYTHON))
COMPAT_TESTS := $(addprefix test/test_, $(addsuffix .py, acceleration airspace alternating bound \
	channel city_missions clearance derivatives fly_hover_fly fuzz_solve joint kernel load \
	mission_file plan playback planner relay replay restrictions scenario \
	worst_case worst_case_objective wrong_values))

.PHONY: demo test test-slow without-ros sanitize fuzz bench bench-users fly numbers soak study docs wheel compat clean

MISSION ?= paper

demo: $(if $(WITHOUT_ROS),without-ros,$(VENV)/.examples)
	$(if $(WITHOUT_ROS),@exit 1,$(BIN)/python -m examples.demo --mission $(MISSION))

# Tests of nodes mostly wait for each other: four at a time, also on two cores.
test: $(if $(WITHOUT_ROS),without-ros) $(VENV)/.test
	$(BIN)/python -m pytest -n 4 --dist loadfile

test-slow: $(if $(WITHOUT_ROS),without-ros) $(VENV)/.test
	$(BIN)/python -m pytest -n 3 --dist loadfile -m "slow and not soak"

without-ros:
	@echo 'PyPI has no ROS for $(WITHOUT_ROS): the nodes and the demo need an installed ROS, see'
	@echo 'docs/install.md. The command and the library work, after: pip install ".[view]"'
	@echo '`make test` runs all tests but those of the nodes.'

# The kernel with checks of its addresses and of undefined behaviour.
sanitize: $(VENV)/.test
	CFLAGS='-fsanitize=address,undefined -fno-sanitize-recover=undefined -D_GLIBCXX_ASSERTIONS' \
		LDFLAGS='-fsanitize=address,undefined' $(BIN)/python setup.py --quiet build_ext \
		--build-lib out/sanitize --build-temp out/sanitize/build
	LD_PRELOAD="$$(c++ -print-file-name=libasan.so) $$(c++ -print-file-name=libstdc++.so)" \
		ASAN_OPTIONS=detect_leaks=0 PYTHONPATH=out/sanitize $(BIN)/python -m pytest -n 2 \
		$(addprefix test/test_, $(addsuffix .py, kernel derivatives limits fuzz_solve bound \
		bound_lemmas certificate))

# Each parser from its seeds; what was found stays in out/fuzz.
FUZZED := $(notdir $(wildcard test/corpus/*))
fuzz: $(addprefix fuzz-, $(FUZZED))

fuzz-%: $(VENV)/.test
	$(BIN)/python -m pip install --quiet atheris
	mkdir -p out/fuzz/$*
	$(BIN)/python test/fuzz_parsers.py $* out/fuzz/$* test/corpus/$* -max_total_time=60 \
		-artifact_prefix=out/fuzz/$*-

soak: $(VENV)/.test
	$(BIN)/python -m pytest -n 2 --dist worksteal -m soak -rP

compat: compat-oldest compat-noble compat-newest compat-kilted

compat-%: .venv-%/.check
	AMENT_PREFIX_PATH=$(CURDIR)/.venv-$* .venv-$*/bin/python -m pytest -n 2 --dist loadfile \
		$(COMPAT_TESTS)

bench: bench-users
	OMP_NUM_THREADS=1 $(BIN)/python -m benchmarks
	OMP_NUM_THREADS=1 $(BIN)/python -m benchmarks.throughput

# Other programs in which a user can type the mission, in an environment of their own.
bench-users: $(VENV)/.benchmarks .venv-users/.check
	OMP_NUM_THREADS=1 $(BIN)/python -m benchmarks.users

# Quadrotors in physics follow the replay node's setpoints.
fly: $(VENV)/.flown
	OMP_NUM_THREADS=1 $(BIN)/python -m studies.flown

study: $(VENV)/.paper
	$(BIN)/python -m studies.paper

# Writes the measured tables into the pages, and draws their pictures.
numbers: study fly bench $(VENV)/.test
	$(BIN)/python -m docs.tools.measured
	$(BIN)/python -m docs.tools.gallery
	$(BIN)/python -m docs.tools.screens

docs: $(VENV)/.docs
	$(BIN)/python -m sphinx -q -W -b html docs out/docs

# What `pip install` takes without building anything.
wheel: | $(BIN)/pip
	$(BIN)/python -m pip wheel --quiet --no-deps --wheel-dir out/wheel .

clean:
	rm -rf $(VENV) .venv-* build install log out

# Not an intermediate file, which make would delete.
.PRECIOUS: .venv-%/.check

# One stamp for each folder with requirements; an edited source is installed anew.
$(VENV)/.%: $(SOURCES) | $(BIN)/pip
	$(BIN)/python -m pip install --quiet $(PACKAGE) \
		-r $(wildcard $*/requirements.txt studies/$*/requirements.txt)
	touch $@

.venv-%/.check: test/compat/%.txt $(wildcard test/compat/*requirements.txt) setup.py \
		$(wildcard secure_uav_planner/*/kernel/*)
	$(COMPAT_PYTHON) -m venv --clear .venv-$*
	.venv-$*/bin/python -m pip install --quiet --upgrade pip
	.venv-$*/bin/python -m pip install --quiet --prefer-binary --constraint $< $(PACKAGE) \
		-r $(firstword $(wildcard test/compat/$*-requirements.txt) test/compat/requirements.txt)
	touch $@

.venv-users/.check: benchmarks/typed/requirements.txt
	$(PYTHON) -m venv --clear .venv-users
	.venv-users/bin/python -m pip install --quiet -r $<
	touch $@

$(BIN)/pip:
	@$(PYTHON) -c 'import sys; sys.exit(not (3, 10) <= sys.version_info[:2] <= (3, 14))' \
		|| { echo 'Python 3.10 to 3.14 is needed; name it as in: make PYTHON=python3.12'; exit 1; }
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --upgrade pip 'setuptools<80' wheel
