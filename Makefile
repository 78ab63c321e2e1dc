# Everything a newcomer needs. Each target sets up what it needs by itself.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
# Without compiled files every import of Prefect takes seconds.
unexport PYTHONDONTWRITEBYTECODE
export PREFECT_SERVER_ANALYTICS_ENABLED = false
export DO_NOT_TRACK = 1
export PREFECT_SERVER_EPHEMERAL_STARTUP_TIMEOUT_SECONDS = 120

.PHONY: demo test lint bench soak screenshots clean system .venv-peers

demo: $(VENV)/run  ## build .venv and make the map of a simulated town, through Prefect
	$(BIN)/flexmap demo

test: $(VENV)/dev  ## all tests
	$(BIN)/python -m pytest -n 2 --dist loadfile

lint: $(VENV)/dev  ## style, types and the layers of the house
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/lint-imports

bench: $(VENV)/dev  ## speed beside peers measured in the same run, and growth over sizes
	@$(MAKE) .venv-peers || echo "note: other workflow tools cannot be installed here; they are left out"
	$(BIN)/python -m tests.bench

soak: $(VENV)/dev  ## what takes long: hundreds of kills, a fleet of 20 maps over 3 nights, planning of many maps
	$(BIN)/python -m tests.soak
	$(BIN)/python tests/fleet/fleet_nights.py
	$(BIN)/python tests/fleet/fleet_planner.py

screenshots: $(VENV)/dev  ## pictures of report and editor for the README (needs chromium)
	$(BIN)/flexmap demo --no-prefect
	$(BIN)/python -m tests.screenshots artifacts docs/images

system:  # what wheels expect from the system
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { echo "FlexMap needs Python 3.11 or newer; run make with PYTHON=python3.11"; exit 1; }
	@$(PYTHON) -c 'import venv, ensurepip' 2>/dev/null || { echo "Python's venv is missing: apt-get install python3-venv"; exit 1; }
	@$(PYTHON) -c 'import ctypes.util as c, sys; sys.exit(c.find_library("usb-1.0") is None)' || echo "note: open3d needs libusb-1.0 (apt-get install libusb-1.0-0); all else works without it"

$(VENV)/run: pyproject.toml constraints.txt | system
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e .
	touch $@

$(VENV)/dev: $(VENV)/run
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[test,lint]'
	touch $@

.venv-peers: .venv-peers/done  ## other workflow tools, to measure beside FlexMap; in an environment of their own

.venv-peers/done: tests/bench/peers.txt | system
	test -x .venv-peers/bin/python || $(PYTHON) -m venv .venv-peers
	.venv-peers/bin/python -m pip install --quiet --disable-pip-version-check -r $<
	touch $@

clean:  ## remove the environment; the artifact store stays
	rm -rf $(VENV) .venv-peers build *.egg-info .mypy_cache .ruff_cache .pytest_cache .import_linter_cache
