# Recurring chores. `make demo` and `make test` need nothing but Python 3.11+, pip and make.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
PLAYING := $(VENV)/.playing
STAMP := $(VENV)/.installed
STAGED := $(VENV)/.staged
ENVIRONMENTS := $(VENV)/environments
MADE := libero libero-plus lerobot
OLDER := $(ENVIRONMENTS)/.lerobot-of-this-python
PIP_AUDIT := 2.10.1
export OMP_NUM_THREADS ?= 1
# Tests start hundreds of commands, each of which would compile what it imports again.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: help setup drivers tools environments demo test pytest test-fast lint docs dist audit bench studies measurements fuzz nightly chaos report zoo clean

help:
	@echo "make demo       set up, play experts and merged policies in three simulators, print the tables and the report's place"
	@echo "make test       set up, check style and types, test each promise once"
	@echo "make test-fast  only the tests that need neither simulators nor Ray (some minutes)"
	@echo "make environments  the environments of LIBERO, LIBERO-Plus and LeRobot, in which make nightly plays them"
	@echo "make lint       ruff and mypy"
	@echo "make docs       build the documentation into runs/site, links checked; it needs no network to be read"
	@echo "make dist       build the wheels of robogauntlet, robogauntlet-mergevla and robogauntlet-zoo, and the source distribution, into dist/"
	@echo "make audit      look up known vulnerabilities of all pinned packages; needs a network"
	@echo "make bench      measure speed; prints tables and writes runs/bench/*.json"
	@echo "make studies    check that the tables of studies/ are those of their kept rows"
	@echo "make measurements  measure a hundredth of every table of studies/, which shows whether it goes through (an hour)"
	@echo "make fuzz       many more damaged suites, runs, checkpoints and messages, and examples of properties, than make test takes"
	@echo "make nightly    installations, environments and pages again, at more length than make test (an hour)"
	@echo "make chaos      fifty runs under random faults, twenty on a cluster of namespaces, Slurm, dying nodes (two hours)"
	@echo "make mutants    change 200 places of the core, one at a time, and say which test notices (hours)"
	@echo "make report     write the newest run's report again"
	@echo "make zoo        make the shipped checkpoints from nothing into runs/zoo (hours); stopped, it continues"
	@echo "                PERCENT=1 make zoo: every step of it with a hundredth of the data and training (minutes)"
	@echo "make setup      virtual environment, pinned packages, rendering drivers"

setup: $(STAMP) drivers

drivers:
	@bash scripts/render_drivers.sh

tools: drivers
	@bash scripts/test_tools.sh

environments: $(MADE:%=$(ENVIRONMENTS)/.%)

# As a reader of README does: by `env create`, from what `make demo` installs.
$(ENVIRONMENTS)/.%: $(PLAYING) policies/lerobot/policy.py adapters/libero/__init__.py adapters/libero_plus/__init__.py | drivers
	PIP_COMPILE=0 ROBOGAUNTLET_ENVIRONMENTS=$(abspath $(ENVIRONMENTS)) $(BIN)/robogauntlet --quiet env create $*
	@touch $@

# LeRobot as on a machine that has no newer Python, which takes a third of the time and a twentieth of the place.
$(OLDER): $(PLAYING) policies/lerobot/policy.py | drivers
	PATH=/nowhere PYENV_ROOT=/nowhere PIP_COMPILE=0 ROBOGAUNTLET_ENVIRONMENTS=$(abspath $(ENVIRONMENTS)) \
		$(abspath $(BIN))/robogauntlet --quiet env create lerobot
	@touch $@

# The extras of developers, in a folder of their own: environments that are created meanwhile inherit from this one and
# see none of them, half installed or whole.
$(STAGED).done: $(PLAYING)
	rm -rf $(STAGED)
	$(BIN)/python -m pip install --quiet --no-compile --prefix $(abspath $(STAGED)) -c constraints.txt \
		"robogauntlet[postgresql,figures,wandb,mlflow,docs,dev]"
	@touch $@

$(STAMP): $(STAGED).done studies/pyproject.toml
	@$(BIN)/python -c "import os, shutil; os.path.isdir('$(STAGED)') and (shutil.copytree('$(STAGED)', '$(VENV)', \
		copy_function=os.replace, dirs_exist_ok=True), shutil.rmtree('$(STAGED)'))"
	$(BIN)/python -m pip install --quiet --no-compile --no-deps -e ./studies
	@touch $@

$(PLAYING): pyproject.toml mergevla/pyproject.toml constraints.txt
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --upgrade "pip>=25" "setuptools>=77" wheel
	$(BIN)/python -m pip install --quiet --no-compile -c constraints.txt -e ".[simulators]" -e ./mergevla
	@# pip would compile every module; these imports compile those that are used. The last two need libraries for
	@# rendering, which may not be there yet.
	@$(BIN)/python -c "import ray, torch, transformers, panda_gym, robosuite, mani_skill.envs" >/dev/null 2>&1 || true
	@touch $@

# Needs a fifth less than the tests. Packages of Python and of the system are installed side by side, as for the tests.
demo:
	@$(MAKE) --no-print-directory --jobs 2 $(PLAYING) drivers
	$(BIN)/robogauntlet run mergevla --seeds 10

test:
	@$(MAKE) --no-print-directory --jobs 3 $(STAGED).done $(OLDER) $(ENVIRONMENTS)/.libero tools
	@$(MAKE) --no-print-directory setup
	@$(MAKE) --no-print-directory --jobs 2 lint pytest || { echo "make test: see above for what failed: style, types or tests"; exit 1; }

# Half as many processes again as cores, at most four: tests often wait for processes of their own to start.
pytest: setup
	$(BIN)/python -m pytest -q --whole --dist loadfile --no-loadscope-reorder \
		-n $$($(BIN)/python -c "import os; print(min(4, len(os.sched_getaffinity(0)) * 3 // 2))")

test-fast: setup
	$(BIN)/python -m pytest -q -m "not simulator and not ray and not slow"

lint: setup
	$(BIN)/ruff format --check --quiet .
	$(BIN)/ruff check --quiet .
	$(BIN)/mypy --no-error-summary

docs: setup
	@# With --quiet, the strict mode would not hear of warnings.
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build
	@echo "documentation: runs/site/index.html"

dist: setup
	rm -rf dist build src/*.egg-info mergevla/build mergevla/*.egg-info zoo/build zoo/*.egg-info studies/*.egg-info
	$(BIN)/python -m pip wheel --quiet --no-deps --no-build-isolation --wheel-dir dist . ./mergevla ./zoo
	$(BIN)/python -c "from setuptools.build_meta import build_sdist; print('dist/' + build_sdist('dist'))"

# pip-audit wants other versions than we do of some packages; it gets an environment of its own.
$(VENV)/audit-$(PIP_AUDIT)/bin/pip-audit: | $(STAMP)
	$(PYTHON) -m venv $(VENV)/audit-$(PIP_AUDIT)
	$(VENV)/audit-$(PIP_AUDIT)/bin/python -m pip install --quiet pip-audit==$(PIP_AUDIT)

audit: $(VENV)/audit-$(PIP_AUDIT)/bin/pip-audit
	$(BIN)/python scripts/audit.py $<

bench: setup
	$(BIN)/python -m studies performance --measure

studies: setup
	$(BIN)/python -m pytest -q studies

measurements: environments
	@bash scripts/test_tools.sh
	@$(MAKE) --no-print-directory setup
	ROBOGAUNTLET_ENVIRONMENTS=$(abspath $(ENVIRONMENTS)) $(BIN)/python -m studies.hundredth

fuzz: setup
	ROBOGAUNTLET_FUZZ_EXAMPLES=6000 $(BIN)/python -m pytest -q tests/fuzz
	ROBOGAUNTLET_EXAMPLES=1000 $(BIN)/python -m pytest -q -m "hypothesis and not simulator and not ray" --ignore tests/fuzz

chaos: setup
	@bash scripts/test_tools.sh chaos
	$(BIN)/python -m tests.chaos
	$(BIN)/python -m tests.chaos --real --runs 2
	$(BIN)/python -m tests.chaos --cluster --runs 20
	$(BIN)/python -m pytest -q --whole --job chaos

nightly: environments $(OLDER)
	@bash scripts/test_tools.sh nightly
	@$(MAKE) --no-print-directory setup
	$(BIN)/python -m pytest -q --whole --job nightly

mutants: setup
	$(BIN)/python -m tests.mutants

zoo: setup
	bash scripts/zoo.sh

report: setup
	$(BIN)/robogauntlet report

clean:
	rm -rf build dist src/*.egg-info mergevla/build mergevla/*.egg-info zoo/build zoo/*.egg-info studies/*.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis
