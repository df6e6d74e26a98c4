# Nothing here needs a ROS installation: what the targets install goes into .venv, for `make demo`
# also ROS 2 itself. Where a ROS 2 installation is sourced, that one is visible and used there.

PYTHON ?= python3
VENV := .venv
IN_VENV := $(VENV)/bin/python
PIP_INSTALL := $(IN_VENV) -m pip install -qq --disable-pip-version-check
RUNTIME := $(VENV)/runtime-installed
TESTING := $(VENV)/test-installed
MESSAGES := $(VENV)/messages-built
RECORDING := demo/simulated_flight
REPORT := demo/report
HAS_ROS := $(IN_VENV) -c 'import rclpy, diagnostic_msgs' 2>/dev/null

ifneq ($(and $(ROS_DISTRO),$(AMENT_PREFIX_PATH)),)
VENV_OPTIONS := --system-site-packages
endif

.DEFAULT_GOAL := help
.PHONY: help demo demo-offline test test-fast lint format bench accuracy schemas docs screenshots tables figures demo-recording clean

help:  ## list these targets
	@sed -n 's/^\([a-z-]*\):.*## /\1\t/p' Makefile | expand -t 18

demo: $(RUNTIME)  ## play a bundled recording through ROS 2 and score it live
	@$(HAS_ROS) || { echo 'Installing ROS 2 from PyPI (rclpy, Fast DDS) into $(VENV)'; \
		$(PIP_INSTALL) --editable '.[ros]'; } || true
	@if $(HAS_ROS); then $(IN_VENV) demo/live.py $(RECORDING) $(REPORT); else \
		echo 'ROS 2 cannot be installed here, so this is the offline half of the demo.' >&2; \
		$(MAKE) --no-print-directory demo-offline; fi

demo-offline: $(RUNTIME)  ## score the same recording without ROS and write a report
	@echo 'Scoring $(RECORDING): a simulated flight and what a VIO made of it'
	@mkdir -p $(REPORT)
	@$(IN_VENV) -m vio_eval_ros replay $(RECORDING) \
		--report json:$(REPORT)/result.json --report markdown:$(REPORT)/result.md
	@echo 'The report is in $(REPORT)/result.md, all numbers in $(REPORT)/result.json'

test: lint $(MESSAGES)  ## check everything: linter, types and all tests
	@echo 'Running the tests'
	@$(IN_VENV) -m pytest -q -n 2

test-fast: lint  ## the same without the tests that are slow or need ROS, in a minute
	@echo 'Running the fast tests'
	@$(IN_VENV) -m pytest -q -n 2 -m 'not slow and not ros'

lint: $(TESTING)  ## check style, types and workflows only
	@echo 'Checking style (ruff), types (mypy) and workflows (zizmor, check-jsonschema)'
	@$(IN_VENV) -m ruff check --quiet
	@$(IN_VENV) -m ruff format --check --quiet
	@$(IN_VENV) -m mypy --no-error-summary
	@$(VENV)/bin/zizmor --offline --quiet --strict-collection .
	@$(VENV)/bin/check-jsonschema --quiet --builtin-schema vendor.github-workflows \
		.github/workflows/*.yml
	@$(VENV)/bin/check-jsonschema --quiet --builtin-schema vendor.github-actions action.yml
	@$(VENV)/bin/check-jsonschema --quiet --builtin-schema vendor.dependabot .github/dependabot.yml

format: $(TESTING)  ## lay out the code as the linter wants it
	@$(IN_VENV) -m ruff check --fix --quiet
	@$(IN_VENV) -m ruff format

bench: $(TESTING)  ## compare speed and memory with evo and with a bare node, side by side
	@$(IN_VENV) benchmarks

accuracy: $(TESTING)  ## compare the figures with evo's on real runs
	@$(IN_VENV) benchmarks/accuracy.py

schemas: $(RUNTIME)  ## write the JSON Schemas of YAML files again
	@$(IN_VENV) docs/schema/generate.py

docs: $(TESTING)  ## build the documentation into build/docs, searchable, without a network
	@$(VENV)/bin/sphinx-build --quiet --fail-on-warning --fresh-env docs build/docs
	@echo 'The documentation is in build/docs/index.html'

figures: $(TESTING)  ## draw the pictures of docs/figures.md again
	@$(IN_VENV) docs/images/make_figures.py

screenshots: $(TESTING)  ## take the pictures of pages in docs/images again; needs chromium
	@$(IN_VENV) docs/images/make_screenshots.py

tables: $(RUNTIME)  ## write the tables of findings, causes and limits in docs/ again
	@$(IN_VENV) docs/make_tables.py

demo-recording: $(RUNTIME)  ## simulate the bundled recording again
	@rm -rf $(RECORDING)
	@$(IN_VENV) -c "from pathlib import Path; from vio_eval_ros.simulation import *; \
		write_recording(simulate(), Path('$(RECORDING)'))"
	@echo 'Wrote $(RECORDING)'

clean:  ## remove all that the other targets made
	@rm -rf $(VENV) $(REPORT) build install log .mypy_cache .pytest_cache .ruff_cache .hypothesis
	@rm -rf *.egg-info

$(IN_VENV):
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 10))' || { echo \
		'Python 3.10 or newer is needed; choose one with: make PYTHON=python3.12 ...' >&2; exit 1; }
	@echo 'Creating a virtual environment in $(VENV)'
	@$(PYTHON) -m venv $(VENV_OPTIONS) $(VENV) || { rm -rf $(VENV); exit 1; }

# Installing the test dependencies installs those of the runtime as well.
$(RUNTIME): setup.py | $(IN_VENV)
	@echo 'Installing the package and what it needs into $(VENV)'
	@$(PIP_INSTALL) --editable .
	@touch $@

$(TESTING): setup.py | $(IN_VENV)
	@echo 'Installing the package and what its tests need into $(VENV)'
	@$(PIP_INSTALL) --editable '.[test]'
	@touch $@ $(RUNTIME)

# The message of TF is in no wheel; where it cannot be built, that is said, and its tests skipped.
$(MESSAGES): test/messages/build.py $(wildcard test/messages/tf2_msgs/*) | $(TESTING)
	@echo 'Building tf2_msgs for the tests of transforms'
	@$(IN_VENV) test/messages/build.py
	@touch $@
