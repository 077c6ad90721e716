# Targets that a user or a contributor needs; `make help` lists them.
VENV := .venv
PY := $(VENV)/bin/python
RUN := $(VENV)/bin/deepmf-sumo
export DEEPMF_SUMO_HOME ?= $(CURDIR)/.cache/home
READY := $(VENV)/.ready
# Tests start hundreds of processes: without this each compiles the package again where the environment forbids __pycache__.
PYTEST := PYTHONDONTWRITEBYTECODE= PYTHONPYCACHEPREFIX=$(CURDIR)/.cache/pycache $(PY) -m pytest

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
	$(RUN) run scenarios/*.yaml --out out/run --overwrite

quick: $(READY)  ## the tests that start no program, not even SUMO, and take at most a second
	$(PYTEST) -q -n 2 -m "not sumo and not slow and not slow_unit" --durations 5 --durations-min 1

test: $(READY)  ## lint, types, import contracts and the tests, beside each other
	$(MAKE) --no-print-directory -j 2 lint-and-types tests

lint-and-types: lint types

tests: $(READY)
	$(PYTEST) -q -n 3 --dist worksteal -m "not slow"

test-slow: $(READY) types-elsewhere  ## the tests that take minutes, those on a Ray cluster of this machine included
	$(PY) -m pip install --quiet -c constraints.txt -e ".[cluster]"
	$(PYTEST) -q -n 2 --dist worksteal -m slow

golden: $(READY)  ## small runs of everything, compared byte for byte with a version before (BASE=HEAD~1)
	$(PY) -m tests.golden --base $(or $(BASE),HEAD~1)

COUNT ?= 2000
fuzz: $(READY)  ## inputs changed at random (KIND= of one kind, COUNT= of each, SEED=): none may do harm
	$(PY) -m tests.fuzz --count $(COUNT) --seed $(or $(SEED),1) $(KIND)

signals: $(READY)  ## long commands ended by SIGKILL, SIGTERM and SIGINT at random moments (COMMANDS=, COUNT= of each, SEED=)
	$(PY) -m tests.fuzz.signals --count $(if $(filter command line,$(origin COUNT)),$(COUNT),10) --seed $(or $(SEED),1) $(COMMANDS)

release: $(READY)  ## build wheels, source archive and lists of packages in dist/, and try them on each Python that is found
	$(PY) -m pip install --quiet --group release
	$(PY) -m tests.release

LOCK := .github/requirements-ci.txt
lock: $(READY)  ## choose anew what continuous integration installs
	$(PY) -m pip install --quiet --group release
	$(VENV)/bin/uv pip compile --quiet --universal --python-version 3.11 --generate-hashes --no-emit-index-url --no-emit-find-links \
	    --custom-compile-command "make lock" --group dev -c constraints.txt -o $(LOCK) pyproject.toml

lint: $(READY)  ## ruff, formatting, import contracts, unused dependencies, left conflict markers
	! git grep -nE '^(<{7}|>{7}) '
	$(VENV)/bin/ruff check .
	$(VENV)/bin/ruff format --check .
	$(VENV)/bin/lint-imports --no-cache
	$(VENV)/bin/deptry .

types: $(READY)  ## mypy --strict on the package
	$(VENV)/bin/mypy

types-elsewhere: $(READY)  ## the same as Windows and macOS see it: a minute each, then seconds
	$(VENV)/bin/mypy --platform win32 --cache-dir .mypy_cache/win32
	$(VENV)/bin/mypy --platform darwin --cache-dir .mypy_cache/darwin

protos: $(READY)  ## regenerate the protobuf code
	$(PY) -m grpc_tools.protoc -I. --python_out=. --pyi_out=. deepmf_sumo/scene/readers/protos/scenario.proto

nets: $(READY)  ## rebuild the networks of sumo_nets/ from their sources
	$(PY) sumo_nets/build.py

bench: $(READY)  ## speed and memory, as ratios and milliseconds side by side
	$(PY) -m tests.bench

WOMD ?= ../shared/womd
OPEN := .cache/open-scenes
TRAIN := $(RUN) train
OPEN_LICENCE := --set "licence=own SUMO traffic; Apache-2.0"
FEATURES := --cache .cache/features --jobs 2 --set seed=1
train: $(READY) open-weights  ## train the weights of the package, from our own SUMO traffic alone

open-scenes: $(READY)  ## record the SUMO traffic that `open` is trained on: 68 networks, 3000 scenes
	$(RUN) data record $(foreach net,arterial four_way highway roundabout rural,sumo_nets/$(net)/$(net).sumocfg) --generate mix --networks 63 --scenes 45 --set avs=3 --seed 1 \
	    --jobs 2 --out $(OPEN)

open-test-scenes: $(READY)  ## record traffic of other networks, to evaluate on
	$(RUN) data record --generate mix --networks 21 --scenes 8 --seed 1001 --jobs 2 --out .cache/open-test-scenes

SCENES ?= $(WOMD)/val
WEIGHTS ?= womd
# An AV under attack in recorded scenes, each run as a scene: what planners do when a vehicle approaches them.
# Attacks as they are made, and, cheaply, candidates of all kinds (`drawn`): what happens if they are tried.
REACT = $(RUN) run studies/reactions.yaml --set source.recording=$(abspath $(SCENES)) --set weights=$(WEIGHTS) \
    --scenes --jobs 2 --no-pictures --resume
seen = --set "planner={name: idm, perception: $(1)}"
plain = tried_opponents: 1, reactions: 6, goal_candidates: 32, shortlist: null
drawn = --seed $(1) --set "adversary={name: deepmf, version: G, opponent: $(2), rule: drawn, $(plain)}"
# Of PARTS parts of the scenes each pass takes another; all of them without PARTS.
part = $(if $(PARTS),--shard $(1)/$(PARTS))
# Single runs may fail; the others are there.
some = > /dev/null || test $$? = 3
reactions: $(READY)  ## attack recordings (SCENES=, OUT=, WEIGHTS=, PARTS=) to learn reactions from
	@test -n "$(OUT)" || { echo "Say where to: make reactions SCENES=FOLDER/train OUT=FOLDER WEIGHTS=open"; exit 2; }
	$(REACT) $(call seen,corridor) $(call part,1) --out $(OUT)/corridor $(some)
	$(REACT) $(call seen,lane) $(call part,2) --out $(OUT)/lane \
	    --set "adversary={name: deepmf, version: S1, opponent: sample, rule: expected, likelihood_weight: 0.1, $(plain)}" $(some)
	$(REACT) $(call seen,corridor) $(call drawn,1,argmax) $(call part,3) --out $(OUT)/drawn-1 $(some)
	$(REACT) $(call seen,lane) $(call drawn,2,sample) $(call part,4) --out $(OUT)/drawn-2 $(some)
	$(REACT) $(call seen,corridor) $(call drawn,3,sample) $(call part,1) --out $(OUT)/drawn-3 $(some)
	$(REACT) $(call seen,lane) $(call drawn,4,argmax) $(call part,2) --out $(OUT)/drawn-4 $(some)

open-weights: open-scenes  ## record SUMO traffic, attack it, and train the set `open`
	$(TRAIN) opponent --data $(OPEN) --name open $(FEATURES) $(OPEN_LICENCE)
	$(TRAIN) marginal --set steps=1500 --data $(OPEN) --name open $(FEATURES) $(OPEN_LICENCE)
	$(MAKE) reactions SCENES=$(OPEN) OUT=.cache/open-reactions WEIGHTS=open PARTS=8
	$(TRAIN) conditional --set steps=1500 --data $(OPEN)=0.5 --data .cache/open-reactions=0.5 --name open $(FEATURES) \
	    $(OPEN_LICENCE)
	$(TRAIN) strive --set steps=800 --data $(OPEN) --name open $(FEATURES) $(OPEN_LICENCE)
	$(TRAIN) diffscene --data $(OPEN) --name open $(FEATURES) $(OPEN_LICENCE)

WOMD_SET = $(FEATURES) --set "licence='Waymo Open Motion Dataset: non-commercial, not to be published'"
WOMD_DATA = --data $(WOMD)/train=0.55 --data .cache/womd-reactions=0.45
womd-weights: $(READY)  ## train the set `womd` (stays in .weights/; its data's licence forbids publishing)
	$(TRAIN) opponent --data $(WOMD)/train --out .weights/womd $(WOMD_SET)
	$(TRAIN) marginal --set members=2 --data $(WOMD)/train --out .weights/womd $(WOMD_SET)
	$(MAKE) reactions SCENES=$(WOMD)/train OUT=.cache/womd-reactions WEIGHTS=open
	$(TRAIN) conditional --set precision=auto $(WOMD_DATA) --out .weights/womd $(WOMD_SET)
	$(TRAIN) people --data $(WOMD)/train --out .weights/womd $(WOMD_SET)
	test ! -d $(WOMD)/val || $(RUN) evaluate $(WOMD)/val --weights .weights/womd --card

LIGHT = .weights/womd-light
womd-light-weights: womd-weights  ## besides, the set `womd-light`: all networks with small images
	mkdir -p $(LIGHT) && cp .weights/womd/opponent.* $(LIGHT)
	$(TRAIN) marginal --set preset=light --set steps=1500 --data $(WOMD)/train --out $(LIGHT) $(WOMD_SET)
	$(TRAIN) conditional --set preset=light --set steps=2500 --set precision=auto $(WOMD_DATA) --out $(LIGHT) $(WOMD_SET)

DENSE = .weights/womd-dense
womd-dense-weights: womd-weights  ## besides, the set `womd-dense`: DenseTNT's goals, as in the paper
	mkdir -p $(DENSE) && cp .weights/womd/opponent.* $(DENSE)
	$(TRAIN) marginal --set preset=dense --data $(WOMD)/train --out $(DENSE) $(WOMD_SET)
	$(TRAIN) conditional --set preset=dense $(WOMD_DATA) --out $(DENSE) $(WOMD_SET)

womd-baselines: $(READY)  ## the motion priors of the baselines STRIVE and DiffScene for the set `womd`
	$(TRAIN) strive --set steps=800 --data $(WOMD)/train --out .weights/womd $(WOMD_SET)
	$(TRAIN) diffscene --data $(WOMD)/train --out .weights/womd $(WOMD_SET)

docs: $(READY)  ## build the documentation into build/site; broken links and anchors are errors
	$(PY) -m pip install --quiet --group docs
	$(VENV)/bin/mkdocs build

test-docs: docs  ## run the commands and Python of README and site; count words, numbers and pictures
	$(PYTEST) -q -n 2 --dist worksteal tests/docs tests/cli/test_commands_of_the_docs.py
	$(PY) -m tests.docs.counts

numbers: $(READY)  ## make the measured numbers of README and site again, in hours (NAMES=, SCENES_DIR=, OUT=)
	$(PY) -m studies.numbers $(NAMES) --out $(or $(OUT),.cache/numbers) $(if $(SCENES_DIR),--scenes $(SCENES_DIR))

gallery: $(READY)  ## make the pictures of README and docs/gallery.md again
	$(PY) -m tests.docs.gallery
	$(PY) -m tests.docs.front_page

.PHONY: help setup run quick test tests lint-and-types test-slow golden fuzz signals release lock lint types types-elsewhere protos nets bench train open-scenes open-test-scenes reactions open-weights womd-weights womd-light-weights womd-dense-weights womd-baselines docs test-docs numbers gallery
