# Every target makes the environment first where it is missing.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
PLAN ?= flightplans/room1.toml
SPEED ?= 10
MINUTES ?= 10
HOURS ?= 1

.PHONY: env fly test lint bench fuzz endurance clean

env: $(STAMP)

$(STAMP): pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
		{ echo "make: $(PYTHON) is older than 3.11; say PYTHON=/path/to/python3.11" >&2; exit 1; }
	@$(PYTHON) -c 'import ensurepip, venv' 2>/dev/null || \
		{ echo "make: $(PYTHON) has no venv module; on Debian: apt-get install python3-venv" >&2; exit 1; }
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable '.[sitl,tools,dev]'
	@touch $(STAMP)

fly: env
	$(BIN)/companion fly $(PLAN) --vehicle sitl --camera sitl --speed $(SPEED)

test: lint
	$(BIN)/python -m pytest

lint: env
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/codespell

bench: env
	$(BIN)/python -m tools.bench

# Mutated input for every parser, so many minutes for each.
fuzz: env
	$(BIN)/python -m pytest tests/fuzz --timeout 0 --fuzz-minutes $(MINUTES)

# Hours of hovering, a million hostile bytes on each kind of link, 50 clients killed in offboard.
endurance: env
	$(BIN)/python -m pytest tests/endurance --timeout 0 --soak-hours $(HOURS) --hostile-bytes 1000000 --kills 50

clean:
	rm -rf $(VENV) build *.egg-info
