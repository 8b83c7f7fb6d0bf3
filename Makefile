# All targets work in .venv. A fresh machine needs python3 (3.11 or 3.12), python3-venv and make.
PYTHON ?= python3
ARGS ?=
PIP = .venv/bin/python -m pip --disable-pip-version-check install -q -c config/constraints.txt
ROS_WHEELS = 'ros-jazzy-rclpy[fastrtps]' ros-jazzy-common-interfaces

# Version of Python, and source of ROS 2: a sourced Jazzy that can be imported, else wheels from PyPI.
VERSION := $(shell $(PYTHON) -c 'import sys; print("python%d.%d" % sys.version_info[:2])')
ROS := wheels
ifeq ($(ROS_DISTRO),jazzy)
ROS := $(shell $(PYTHON) -c 'import rclpy' 2>/dev/null && echo sourced || echo wheels)
endif
ifeq ($(ROS),wheels)
# Variables of another ROS environment would hide the wheels.
unexport PYTHONPATH LD_LIBRARY_PATH AMENT_PREFIX_PATH _ROS_WHEELS_BOOTSTRAP_COMPLETE
endif
# Without files of bytecode, each of the hundreds of processes of a test run compiles all modules again.
unexport PYTHONDONTWRITEBYTECODE
# If either of the two changes, .venv is rebuilt.
MADE = .venv/$(VERSION)-$(ROS)

help: ## list the targets; ARGS="..." is passed to demo, test, verify, plain, quick and bench
	@sed -n 's/^\([a-z]*\):.*## /make \1 \t/p' Makefile

demo: .venv/installed ## simulate, record, analyse
	@.venv/bin/liegroup_sim demo $(ARGS)

# PYTHONSAFEPATH: pytest and the processes of the tests import the installed package, not this folder.
# Three workers on two cores, as many tests wait for nodes.
PYTEST = PYTHONSAFEPATH=1 .venv/bin/python -m pytest -n 3 --dist loadfile --no-loadscope-reorder

test: .venv/installed ## run the tests against the installed package (15 min on two cores)
	@.venv/bin/python -P test/compile_kernels.py
	@$(PYTEST) $(ARGS)

verify: .venv/installed ## run everything: all cases and turns (about an hour)
	@VERIFY=1 $(PYTEST) $(ARGS)

plain: .venv/installed ## run the tests of the plain compilation of every method family (10 min)
	@VERIFY=1 $(PYTEST) --dist load test/core/test_plain_numba.py $(ARGS)

quick: .venv/installed ## run the quick tests of the core (below 60 s once the kernels are compiled)
	@$(PYTEST) -m "not slow" test/contract test/core $(ARGS)

lint: .venv/lint ## check format, style, docstrings and types
	@.venv/bin/ruff format --check .
	@.venv/bin/ruff check .
	@.venv/bin/mypy

texts: .venv/installed ## write the files that are generated from tables of the code
	@.venv/bin/python -P -m liegroup_core.scene.schema > docs/scene.schema.json
	@.venv/bin/python -P -m liegroup_sim_ros.node.parameter_texts .

docs: .venv/docs ## build the documentation as a site: site/index.html
	@NO_MKDOCS_2_WARNING=1 .venv/bin/mkdocs build -q --strict -f docs/site/mkdocs.yml
	@echo "Open site/index.html, or for its search http://localhost:8000 after" \
	      "$(PYTHON) -m http.server -d site"

bench: .venv/peers ## measure, side by side with other software; ARGS=--quick is shorter
	@set -e; for script in peers growth; do \
	    echo "== $$script"; .venv/bin/python benchmarks/$$script.py $(ARGS); done
	@set -e; for script in step_cost top_accuracy rotation node recording; do \
	    echo "== $$script"; .venv/bin/python benchmarks/$$script.py; done

clean: ## remove all generated files
	rm -rf .venv build install log demo_out site *.egg-info .pytest_cache .hypothesis
	find . -name __pycache__ -prune -exec rm -rf {} +

check:
	@case "$(VERSION)" in python3.11|python3.12) ;; *) \
	    echo "liegroup_sim_ros needs Python 3.11 or 3.12 and $(PYTHON) is not (found:" \
	         "'$(VERSION)'): name another one, as in make test PYTHON=python3.12"; exit 1;; esac
	@case "$(ROS_DISTRO)" in ""|jazzy) ;; *) \
	    echo "liegroup_sim_ros needs ROS 2 Jazzy and this shell is set up for '$(ROS_DISTRO)':" \
	         "source Jazzy, or use its wheels from PyPI with env -u ROS_DISTRO make ..."; \
	    exit 1;; esac
	@case "$(ROS)-$$(uname -m)" in sourced-*|wheels-x86_64) ;; *) \
	    echo "The wheels of ROS 2 Jazzy on PyPI are for x86_64, this machine is $$(uname -m):" \
	         "install and source ROS 2 Jazzy first"; exit 1;; esac

$(MADE): config/constraints.txt | check
	@echo "Creating .venv, $(VERSION), ROS 2 Jazzy: $(ROS) (once; about a minute, 1.7 GB)"
	@$(PYTHON) -m venv --clear $(if $(filter sourced,$(ROS)),--system-site-packages) .venv
	@$(PIP) setuptools
	@touch $@

# Folders included: their time changes when a file is removed.
SOURCES = setup.py setup.cfg package.xml \
    $(shell find $(wildcard liegroup_core liegroup_sim_ros config launch resource) \
            -name __pycache__ -prune -o -print)

# Not -e: that omits the ament marker, the share files and the launcher. --no-build-isolation: build
# with the pinned setuptools. An old `build` folder would restore deleted modules. The kernels keep the
# times of their sources; otherwise every installation would invalidate their compiled code.
.venv/installed: $(MADE) $(SOURCES) | check
	@echo "Installing liegroup_sim_ros into .venv"
	@touch $@.started && rm -rf build *.egg-info
	@$(PIP) --no-build-isolation --use-pep517 $(if $(filter wheels,$(ROS)),$(ROS_WHEELS)) '.[test]'
	@find liegroup_core -name '*.py' -exec touch -r {} .venv/lib/$(VERSION)/site-packages/{} \;
	@rm -rf build *.egg-info && mv $@.started $@

.venv/lint: .venv/installed
	@$(PIP) ruff mypy && touch $@

.venv/docs: .venv/installed
	@$(PIP) mkdocs-material mkdocstrings-python && touch $@

# Without the peers the benchmarks still run and report which peers are missing.
.venv/peers: .venv/installed
	@echo "Installing the peers of the benchmarks into .venv (once; 0.5 GB)"
	@$(PIP) $$(.venv/bin/python -c 'from importlib.metadata import requires; \
	    print(*(each.split(";")[0] for each in requires("liegroup_sim_ros") if "bench" in each))') \
	    && touch $@ || echo "It cannot be installed here"

constraints: | check
	@$(PYTHON) -m venv --clear build/resolve
	@build/resolve/bin/python -m pip install -q --dry-run --ignore-installed --only-binary :all: \
	    --no-binary empy --report build/report.json \
	    setuptools colcon-common-extensions $(ROS_WHEELS) '.[test,lint,docs,bench]'
	@grep '^#' config/constraints.txt > build/header
	@$(PYTHON) -c 'import json; found = json.load(open("build/report.json"))["install"]; \
	    print(*sorted("{name}=={version}".format(**each["metadata"]).lower().replace("_", "-") \
	                  for each in found), sep="\n")' \
	    | grep -v ^liegroup | cat build/header - > config/constraints.txt
	@rm -rf build *.egg-info

.PHONY: help demo test verify plain quick lint texts docs bench clean check constraints
