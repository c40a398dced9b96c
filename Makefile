# Everything a person runs. Each target sets up its own environment in .venv from the locked requirements, once.
PYTHON    ?= python3
CATALOGUE ?= examples
RESULTS   ?= results
CORES     ?=

VENV := .venv
BIN  := $(VENV)/bin
PIP  := $(BIN)/python -m pip --disable-pip-version-check -qq
# One thread a process, and compiled modules kept: the tests start many processes. Three workers keep two cores busy, as some tests wait.
PYTEST := OPENBLAS_NUM_THREADS=1 PYTHONDONTWRITEBYTECODE= $(BIN)/python -m pytest -n 3 --dist worksteal

# An environment holds the path of its checkout: a copied or moved one would run the code of the old place, so it is made anew.
ifneq ($(shell cat $(VENV)/.place 2>/dev/null),$(CURDIR))
$(VENV)/bin/python $(VENV)/.runtime $(VENV)/.dev $(VENV)/.instruments $(VENV)/.peers $(VENV)/.cluster $(VENV)/.docs: moved
endif

.PHONY: moved help catalogue check instruments peers cluster slurm browser test test-full lint docs figures format lock keys examples benchmark accuracy tradeoff extremes rig-accuracy clean
.DEFAULT_GOAL := help

help:  ## list the targets
	@grep -hE '^[a-z-]+:.*## ' $(MAKEFILE_LIST) | sed -E 's/:[^#]*## /\t/' | expand -t 14

catalogue: $(VENV)/.runtime  ## build CATALOGUE (default: examples) into RESULTS (default: results), on CORES cores
	@$(BIN)/brdfpipe build "$(CATALOGUE)" --results "$(RESULTS)" $(if $(CORES),--cores "$(CORES)")

check: $(VENV)/.runtime  ## check descriptions, keys, files and formats of CATALOGUE; compute nothing
	@$(BIN)/brdfpipe check "$(CATALOGUE)"

instruments: $(VENV)/.instruments  ## add the readers of instruments' own file formats, and spreadsheets (140 MB)

peers: $(VENV)/.peers  ## add the independent implementations that test-full compares with (300 MB, compiles for minutes)

cluster: $(VENV)/.cluster  ## add what submits jobs to the scheduler of a cluster (docs/cluster.md)

slurm:  ## install SLURM, on which test-full tests clusters (Debian, as root; no service is started)
	apt-get install --yes --no-install-recommends slurm-wlm munge

browser:  ## install Chromium, in which test-full tries the pages (Debian, as root)
	apt-get install --yes --no-install-recommends chromium chromium-driver

test: $(VENV)/.dev $(VENV)/.instruments  ## run the tests, each at least on a representative case (minutes on two cores)
	@$(PYTEST)

test-full: $(VENV)/.dev $(VENV)/.instruments $(VENV)/.peers $(VENV)/.cluster  ## run the same, every random search in full, the slow proofs and the comparisons with other programs (an hour)
	@$(PYTEST) --slow

lint: $(VENV)/.dev  ## format check, lint, types, workflow lint
	@$(BIN)/ruff format --check .
	@$(BIN)/ruff check .
	@$(BIN)/snakefmt --check Snakefile workflow
	@$(BIN)/mypy
	@$(BIN)/snakemake --lint --config catalogue="$(CURDIR)/examples"

docs: $(VENV)/.docs  ## build the documentation site into site/ from docs/ and the docstrings; warnings are errors
	@$(BIN)/python -m sphinx -q -W --keep-going -b html docs site

figures: $(VENV)/.docs  ## draw the figures of the documentation anew, from the examples
	@$(BIN)/python docs/make_figures.py

format: $(VENV)/.dev  ## format the sources
	@$(BIN)/ruff format .
	@$(BIN)/ruff check --fix .
	@$(BIN)/snakefmt Snakefile workflow

keys: $(VENV)/.runtime  ## write templates, editor schemas and key tables anew, from the declared keys
	@$(BIN)/python -m brdfpipe.catalogue.generated_files

examples: $(VENV)/.runtime  ## write the synthetic example materials anew, from their seeds
	@$(BIN)/python examples/generate.py

benchmark: $(VENV)/.runtime  ## measure a catalogue of 100 varied copies of the examples
	@$(BIN)/python benchmarks/catalogue.py

accuracy: $(VENV)/.runtime  ## compare every model of a surface with reference solutions; write docs/accuracy.md (ten minutes)
	@$(BIN)/python benchmarks/accuracy.py

extremes: $(VENV)/.dev  ## run every stage at the extremes of its inputs; write docs/extremes.md (two minutes)
	@$(BIN)/python benchmarks/extremes.py

tradeoff: $(VENV)/.dev  ## measure error and cost of every candidate model for every scene, and of every other choice (two hours)
	@$(BIN)/python benchmarks/tradeoff.py
	@$(BIN)/python benchmarks/tradeoff.py --new
	@$(BIN)/python benchmarks/pareto_fronts.py
	@$(BIN)/python benchmarks/choices.py

rig-accuracy: $(VENV)/.runtime  ## measure samples of known BSDF with emulated rigs; write docs/rig-accuracy.md (some minutes)
	@$(BIN)/python benchmarks/rig_accuracy.py

lock: $(VENV)/.dev  ## resolve the dependencies anew (needs uv on the PATH)
	uv pip compile --universal --fork-strategy fewest --python-version 3.11 --generate-hashes --no-header --no-emit-index-url --quiet --upgrade \
	  pyproject.toml --group build --group dev --output-file requirements-dev.lock
	uv pip compile --universal --fork-strategy fewest --python-version 3.11 --generate-hashes --no-header --no-emit-index-url --quiet --upgrade \
	  pyproject.toml --group build --constraint requirements-dev.lock --output-file requirements.lock
	uv pip compile --universal --fork-strategy fewest --python-version 3.11 --generate-hashes --no-header --no-emit-index-url --quiet --upgrade \
	  pyproject.toml --extra instruments --extra excel --extra plot --constraint requirements-dev.lock --output-file requirements-instruments.lock
	uv pip compile --universal --fork-strategy fewest --python-version 3.11 --generate-hashes --no-header --no-emit-index-url --quiet --upgrade \
	  pyproject.toml --group peers --constraint requirements-dev.lock --output-file requirements-peers.lock
	uv pip compile --universal --fork-strategy fewest --python-version 3.11 --generate-hashes --no-header --no-emit-index-url --quiet --upgrade \
	  pyproject.toml --extra cluster --constraint requirements-dev.lock --output-file requirements-cluster.lock
	uv pip compile --universal --fork-strategy fewest --python-version 3.11 --generate-hashes --no-header --no-emit-index-url --quiet --upgrade \
	  pyproject.toml --group docs --constraint requirements-dev.lock --output-file requirements-docs.lock

clean:  ## remove the environment and the built results
	rm -rf $(VENV) results

$(VENV)/bin/python:
	@$(PYTHON) -c 'import sys; sys.exit("brdfpipe needs Python 3.11 or newer, found " + sys.version.split()[0] + "; set PYTHON=/path/to/python3") if sys.version_info < (3, 11) else None'
	@$(PYTHON) -m venv --clear $(VENV)
	@echo "$(CURDIR)" > $(VENV)/.place

$(VENV)/.runtime: requirements.lock pyproject.toml | $(VENV)/bin/python
	@echo "Setting up $(VENV) from requirements.lock (once; a minute or two)"
	@$(PIP) install --require-hashes --no-deps -r requirements.lock
	@$(PIP) install --no-deps --no-build-isolation --editable .
	@touch $@

$(VENV)/.dev: requirements-dev.lock $(VENV)/.runtime
	@echo "Setting up the test tools from requirements-dev.lock (once)"
	@$(PIP) install --require-hashes --no-deps -r requirements-dev.lock
	@touch $@

$(VENV)/.instruments: requirements-instruments.lock $(VENV)/.runtime
	@echo "Adding what instruments need from requirements-instruments.lock (once)"
	@$(PIP) install --require-hashes --no-deps -r requirements-instruments.lock
	@touch $@

$(VENV)/.docs: requirements-docs.lock $(VENV)/.runtime
	@echo "Adding what the documentation site needs from requirements-docs.lock (once)"
	@$(PIP) install --require-hashes --no-deps -r requirements-docs.lock
	@touch $@

$(VENV)/.peers: requirements-peers.lock $(VENV)/.dev
	@command -v $(CXX) >/dev/null || { echo "pySCATMECH is compiled on this machine, and there is no $(CXX): install a C++ compiler" >&2; exit 1; }
	@echo "Adding the independent implementations from requirements-peers.lock (once; minutes of compiling)"
	@$(PIP) install --require-hashes --no-deps --no-build-isolation -r requirements-peers.lock
	@touch $@

$(VENV)/.cluster: requirements-cluster.lock $(VENV)/.runtime
	@echo "Adding what clusters need from requirements-cluster.lock (once)"
	@$(PIP) install --require-hashes --no-deps -r requirements-cluster.lock
	@touch $@
