# From nothing to a walk: `make walk`. Everything is installed into .venv; nothing else on the machine is touched.
#
# With a ROS 2 sourced, that ROS is used. Without one, its wheels are installed from PyPI (Linux, x86_64); where there are
# none, as on the aarch64 of a Raspberry Pi, the first line that fails lists what else there is (pixi, Docker).

PYTHON ?= python3
VENV   ?= .venv
OUT    ?= results/walk
GAIT   ?= poppy_dynamic
CYCLES ?= 1
CONFIG ?= paper
JOBS   ?= 2
STEPS  ?= 20

SUDO   := $(if $(filter 0,$(shell id -u)),,sudo)
BIN    := $(VENV)/bin
# $(call installed,PROGRAM,PACKAGES): install packages of Ubuntu or Debian if they have not brought a program
installed = command -v $(1) >/dev/null || \
    { $(SUDO) apt-get update -qq && $(SUDO) apt-get install -y -qq --no-install-recommends $(2); }
NATIVE := $(shell $(PYTHON) -c 'from importlib.util import find_spec as f; print("yes" if f("rclpy") and not f("ros_wheels_bootstrapper") else "")')
ifeq ($(NATIVE),yes)
VENV_OPTIONS := --system-site-packages
ROS_EXTRA    :=
else
VENV_OPTIONS :=
ROS_EXTRA    := ros,
endif

# without cached bytecode each of the many processes that the tests start compiles the package anew
unexport PYTHONDONTWRITEBYTECODE

# one target after the other, also with -j: they install into the same folder
.NOTPARALLEL:

# the programs in a copied folder are those of the original, and run its code
ifneq ($(filter-out help clean,$(MAKECMDGOALS)),)
ifneq ($(shell grep -s '^command = ' $(VENV)/pyvenv.cfg | grep -vF ' $(abspath $(VENV))'),)
$(error $(VENV) was made in another folder: rm -rf $(VENV), then make again)
endif
endif

.DEFAULT_GOAL := help
.PHONY: help venv walk walk-physics simulate reach test test-long browser docs chaos fuzz mutation soak driver evidence robots benchmark see lint colcon clean

help:  ## show this
	@echo "usage: make TARGET [CYCLES=$(CYCLES)] [CONFIG=$(CONFIG)] [STEPS=$(STEPS)] [OUT=$(OUT)]"
	@sed -n 's/^\([a-z-]*\):.*##/  \1\t/p' $(MAKEFILE_LIST) | expand -t 16

venv: $(VENV)/.installed-commands  ## install all that the commands of dqwalk need into .venv (then: . .venv/bin/activate)

walk: $(VENV)/.installed  ## walk one cycle through ROS 2: bag, figures and report in results/walk
	$(BIN)/dqwalk walk --config $(CONFIG) --cycles $(CYCLES) --out $(OUT) --force

walk-physics: $(VENV)/.installed-sim  ## walk STEPS steps in MuJoCo through ROS 2: bag, figures, report in results/walk-physics
	OPENBLAS_NUM_THREADS=1 $(BIN)/dqwalk walk --config $(GAIT) --plant physics --set gait.steps=$(STEPS) \
	    --out results/walk-physics --force $(ARGS)

simulate: $(VENV)/.installed  ## the same walk in one process, without ROS
	$(BIN)/dqwalk simulate --config $(CONFIG) --cycles $(CYCLES) --out $(OUT) --force

reach: $(VENV)/.installed-wholebody  ## every requirement of the whole-body controller with its measured value, and figures 2 to 5
	PYTHONPATH=test/support OPENBLAS_NUM_THREADS=1 $(BIN)/python -m acceptance --jobs $(JOBS) --out results/reach $(ARGS)

test: $(VENV)/.installed-test  ## run all tests but those of test-long, browser and colcon (JOBS=2 at a time)
	$(BIN)/python -m pytest -n $(JOBS) --dist loadfile -m 'not colcon and not native and not long and not browser' $(ARGS)

test-long: $(VENV)/.installed-test  ## the tests that take minutes, and variants of the others
	$(BIN)/python -m pytest -n $(JOBS) --dist loadfile -m long $(ARGS)

browser: $(VENV)/.installed-test  ## run the tests that look at the pages in headless Chromium (installs it with apt)
	$(call installed,chromium,chromium fonts-dejavu-core)
	$(BIN)/python -m pytest -m browser $(ARGS)

docs: $(VENV)/.installed-docs  ## build the documentation as a website in site/
	$(BIN)/mkdocs build --strict

chaos: $(VENV)/.installed-test  ## put a live walk through every fault of docs/faults.md, and print what it did
	$(call installed,cc,gcc libc6-dev)
	PYTHONPATH=test/support $(BIN)/python -m pytest -q -p chaos -m long --timeout 900 test/faults/test_chaos.py test/faults/test_chaos_clocks.py \
	    test/faults/test_chaos_whole_body.py $(ARGS)

fuzz: $(VENV)/.installed-test  ## 10 000 hostile robots, parameter files and messages
	DQWALK_FUZZ=10000 $(BIN)/python -m pytest --timeout 3000 --durations 6 test/faults/test_fuzz.py $(ARGS)

mutation: $(VENV)/.installed-test  ## change each line that keeps a robot safe, and see whether a test notices (an hour)
	$(BIN)/python test/support/mutations.py $(ARGS)

soak: $(VENV)/.installed-test  ## an hour of walking in lockstep, recorded: memory, files, gaps (ARGS='--minutes 60')
	$(BIN)/python -m benchmark.lab.soak $(ARGS)

driver: $(VENV)/.installed-test  ## the Poppy driver on dummy motors: rate, angles, limits (ARGS=--full for the paper's cycle)
	$(BIN)/python -m benchmark.lab.driver $(ARGS)

evidence: $(VENV)/.installed-sim $(VENV)/.installed-drake  ## what docs/results/ claims, in MuJoCo and in Drake, with bounds (ARGS='--sample 2')
	OPENBLAS_NUM_THREADS=1 $(BIN)/dqwalk evidence --jobs $(JOBS) --out results/evidence $(ARGS)

robots: $(VENV)/.installed-sim  ## adopt every biped of two PyPI packages, walk it in MuJoCo, and print a table
	$(BIN)/python -m pip install --quiet --target results/robots/packages --no-deps example-robot-data jvrc-description
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m benchmark.lab.robots results/robots/packages --out results/robots $(ARGS)

benchmark: $(VENV)/.installed-test  ## measure computing times and write docs/benchmarks.md (ARGS='--only tick cycle')
	$(BIN)/python -m benchmark.page $(ARGS)

see: $(VENV)/.installed-test  ## how soon the page is there, how smooth, what it costs the walk, how long a report takes
	$(call installed,chromium,chromium fonts-dejavu-core)
	$(BIN)/python -m benchmark.lab.see $(ARGS)

lint: $(VENV)/.installed-dev  ## ruff and mypy
	$(BIN)/ruff check .
	$(BIN)/mypy

colcon: $(VENV)/.installed-test  ## build the package with colcon and run what it built
	$(BIN)/python -m pytest -m 'colcon$(if $(filter yes,$(NATIVE)), or native)' $(ARGS)

clean:  ## remove .venv and everything that was built or recorded
	rm -rf $(VENV) build install log results dqwalk_ros.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find . -name __pycache__ -prune -exec rm -rf {} +

$(BIN)/pip:
	@$(PYTHON) -c 'import sys; v = sys.version_info[:2]; sys.exit(None if v >= (3, 11) else \
	    "Python 3.11 or newer is needed, $(PYTHON) is %d.%d: make PYTHON=python3.12 ..." % v)'
	@[ '$(NATIVE)' = yes ] || $(PYTHON) -c 'import platform, sys; sys.exit(None if \
	    (platform.system(), platform.machine()) == ("Linux", "x86_64") and sys.version_info[:2] <= (3, 13) else \
	    "No ROS 2 is sourced, and its wheels are for Linux on x86_64 with Python 3.11 to 3.13; this is %s on %s with %d.%d.\n" \
	    "  . /opt/ros/jazzy/setup.bash && make walk    with ROS 2 Jazzy, which Ubuntu 24.04 has as packages\n" \
	    "  pixi run walk                               without: Linux on x86_64 or aarch64, macOS on arm64; see pixi.toml\n" \
	    "  docker build -t dqwalk_ros .                in a container; see Dockerfile" \
	    % (platform.system(), platform.machine(), *sys.version_info[:2]))'
	@$(PYTHON) -c 'import venv, ensurepip' 2>/dev/null || \
	    { echo "Python's venv module is missing: sudo apt install python3-venv" >&2; exit 1; }
	@echo "==> $(VENV): $(if $(ROS_EXTRA),ROS 2 Jazzy from PyPI (about 250 MB),the ROS 2 of this machine ($(ROS_DISTRO)))"
	$(PYTHON) -m venv $(VENV_OPTIONS) $(VENV)

# what a target needs: the package and ROS 2, or those and an extra of setup.py
$(VENV)/.installed: setup.py | $(BIN)/pip
	$(BIN)/python -m pip install --editable '.$(if $(ROS_EXTRA),[ros])'
	@touch $@

$(VENV)/.installed-%: setup.py | $(BIN)/pip
	$(BIN)/python -m pip install --editable '.[$(ROS_EXTRA)$*]'
	@touch $@ $(VENV)/.installed
