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

protos: $(READY)  ## regenerate the protobuf code
	$(PY) -m grpc_tools.protoc -I. --python_out=. --pyi_out=. deepmf_sumo/readers/protos/scenario.proto

nets: $(READY)  ## rebuild the networks of sumo_nets/ from their sources
	$(PY) sumo_nets/build.py

bench: $(READY)  ## speed and memory, as ratios and milliseconds side by side
	$(PY) -m tests.bench

WOMD ?= ../shared/womd
train: $(READY) open-weights  ## train the weights of the package, from our own SUMO traffic alone

OPEN_NETS := arterial four_way highway roundabout rural
OPEN_SEEDS := 1 2
open-scenes: $(READY)  ## record the SUMO traffic that `open` is trained on
	for seed in $(OPEN_SEEDS); do for net in $(OPEN_NETS); do \
	    $(RUN) record sumo_nets/$$net/$$net.sumocfg --out .cache/open-scenes/$$net-$$seed --scenes 40 --seed $$seed \
	    || exit 1; done; done

open-weights: open-scenes  ## record SUMO traffic and train the set `open` on it
	$(RUN) train all --data .cache/open-scenes --name open --cache .cache/features --seed 1 \
	    --licence "own SUMO traffic; Apache-2.0"

womd-weights: $(READY)  ## train the set `womd` (stays in .weights/; its data's licence forbids publishing)
	$(RUN) train all --data $(WOMD)/train --name womd --out .weights/womd --cache .cache/features --seed 1 \
	    --licence "Waymo Open Motion Dataset: non-commercial, not to be published"

SCENES ?= $(WOMD)/val
RESULTS ?= out/val
STUDY = $(RUN) run docs/studies/recorded.yaml --set source.recording=$(abspath $(SCENES)) --jobs 2 --no-pictures
no-attack-results: $(READY)  ## the IDM on recorded scenes without attack: contacts and distance to the log
	for seen in lane corridor; do for parameters in treiber metadrive; do \
	    $(STUDY) --set adversary=none --set "name=$$seen $$parameters" \
	    --set "planner={name: idm, perception: $$seen, parameters: $$parameters}" \
	    --out $(RESULTS)/none-$$seen-$$parameters > /dev/null || exit 1; done; done
	$(RUN) table $(RESULTS)/none-*

WEIGHTS ?= womd
VERSIONS ?= S1 G
OPPONENTS ?= argmax partner
RULES ?= expected likeliest
attack-results: $(READY)  ## DeepMF on recorded scenes, for docs/results.md
	for planner in replay idm-lane idm-corridor; do for version in $(VERSIONS); do \
	for opponent in $(OPPONENTS); do for rule in $(RULES); do \
	    case $$planner in replay) drives="{name: replay}";; *) drives="{name: idm, perception: $${planner#idm-}}";; esac; \
	    $(STUDY) --set weights=$(WEIGHTS) --set "planner=$$drives" --set "name=$$opponent $$rule" \
	    --set "adversary={name: deepmf, version: $$version, opponent: $$opponent, rule: $$rule}" \
	    --out $(RESULTS)/$(WEIGHTS)-$$planner-$$version-$$opponent-$$rule > /dev/null || exit 1; \
	done; done; done; done
	$(RUN) table $(RESULTS)/$(WEIGHTS)-*

docs: $(READY)  ## build the documentation into build/site
	$(PY) -m pip install --quiet --group docs
	$(VENV)/bin/mkdocs build --quiet

.PHONY: help setup run test test-slow lint types protos nets bench train open-scenes open-weights womd-weights docs no-attack-results attack-results
