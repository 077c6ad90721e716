# Targets that a user or a contributor needs; `make help` lists them.
VENV := .venv
PY := $(VENV)/bin/python
RUN := $(VENV)/bin/deepmf-sumo
export DEEPMF_SUMO_HOME ?= $(CURDIR)/.cache/home
READY := $(VENV)/.ready

.DEFAULT_GOAL := help

help:  ## list the targets
	@grep -hE '^[a-z-]+:.*## ' $(MAKEFILE_LIST) | sed 's/:.*## /\t/' | expand -t 16

$(READY): pyproject.toml constraints.txt
	test -x $(PY) || python3 -m venv $(VENV)
	$(PY) -m pip install --quiet --upgrade "pip>=25.1"
	$(PY) -m pip install --quiet -c constraints.txt --group dev -e .
	touch $@

setup: $(READY)  ## create .venv and install

run: $(READY)  ## attack every scenario of scenarios/ and print what happened
	$(RUN) run scenarios/*.yaml --out out/run

test: $(READY) lint types  ## lint, types, import contracts and the tests
	$(PY) -m pytest -q -n 2 -m "not slow"

test-slow: $(READY)  ## the tests that take minutes
	$(PY) -m pytest -q -m slow

lint: $(READY)  ## ruff, formatting, import contracts, unused dependencies
	$(VENV)/bin/ruff check .
	$(VENV)/bin/ruff format --check .
	$(VENV)/bin/lint-imports --no-cache
	$(VENV)/bin/deptry .

types: $(READY)  ## mypy --strict on the package
	$(VENV)/bin/mypy

.PHONY: help setup run test test-slow lint types
