# Everything starts here: `make help` lists the targets. Each one sets up what it needs, once; a second run is quick.
#   PYTHON=python3.12   another interpreter        CXX=clang++   another compiler
#   ARGS="..."          more arguments for the command behind a target, for example: make demo ARGS="--seconds 5"

PYTHON ?= python3
ifeq ($(origin CXX),default)
CXX := c++
endif
VENV ?= .venv
BIN := $(VENV)/bin
STAMPS := $(VENV)/.stamps
PIP := $(BIN)/python -m pip install --quiet --disable-pip-version-check --no-input
# What is downloaded has a hash in requirements/ (tools/lock.py writes them), or is not installed.
LOCKED := $(PIP) --require-hashes -r requirements
# The package is used from this folder: the native module is built into it, so that an edit is seen at once.
EDITABLE := --no-deps --no-build-isolation -C wheel.cmake=false -C wheel.py-api=py3 -C editable.mode=inplace
# The build for processors alone. Some registries call it +cpu; PyTorch's own has it by the plain name. The plain name on PyPI
# brings gigabytes for graphics cards on Linux with x86-64, so it is not taken there.
TORCH := torch==2.13.0
NATIVE := build/native/.built
WEB := $(STAMPS)/web
CLIENTS := $(STAMPS)/clients
CLIENT_SOURCES := $(shell find clients/web clients/typescript server/lidarcodec_server/web tests/vectors \
  \( -name node_modules -o -name dist \) -prune -o -type f -print)
# By the lock file, with the hashes in it.
NPM_CI := npm ci --ignore-scripts --silent
NATIVE_SOURCES := CMakeLists.txt tools/build-native.sh $(shell find native/src native/bindings native/c native/include -type f)
CXX_FILES = $(shell find native clients/cpp clients/ros2 -name '*.[ch]pp' -o -name '*.[ch]')
# Tests wait for half of their time: with four processes two cores were idle for a sixth of it, with six they seldom are.
# Each process gets its share of them as they stand, so that what a module sets up is seldom set up twice, and takes from others
# when it has done its own.
JOBS ?= 6
export PYTHON CXX
# Tests start some five hundred processes. Where the environment forbids bytecode, as in many containers, each would compile
# all that it imports.
unexport PYTHONDONTWRITEBYTECODE

.DEFAULT_GOAL := help
.DELETE_ON_ERROR:
.PHONY: foxglove help demo test lint check bench bench-compare golden identity fuzz soak load faults sweeps images-check format native tables evidence web wasm site clean

# A module that was deleted is built again, whatever the stamp says.
ifeq ($(wildcard lidarcodec/_native*.so),)
$(shell rm -f $(NATIVE))
endif

help: ## list the targets
	@sed -n 's/^\([a-z-]*\):[^#]*## \(.*\)/\1@\2/p' $(MAKEFILE_LIST) | awk -F@ '{ printf "  make %-14s %s\n", $$1, $$2 }'

demo: ## drive through a simulated town, live on a page in the browser (ARGS="--no-browser --seconds 20")
	@$(MAKE) -s -j2 $(STAMPS)/server $(NATIVE)
	@$(BIN)/lidarcodec demo $(ARGS)

test: lint $(CLIENTS) ## everything that must hold: lint, types, imports and all tests
	@$(BIN)/python -m pytest -n $(JOBS) --dist worksteal $(ARGS) || { code=$$?; test $$code -eq 1 || exit $$code; \
		echo "What failed beside other tests runs once more, alone:"; \
		$(BIN)/python -m pytest --last-failed --last-failed-no-failures none $(ARGS); }

lint: $(STAMPS)/dev $(NATIVE) ## ruff, formats of Python and C++, mypy --strict and the import contracts
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/clang-format --dry-run --Werror $(CXX_FILES)
	$(BIN)/mypy --strict
	$(BIN)/lint-imports --no-logo

check: lint ## lint, and whether docs and code agree: under a minute
	$(BIN)/python -m pytest -q tests/test_docs.py

bench: $(STAMPS)/dev $(NATIVE) ## measure speed, size and memory, and add a line to benchmarks/history
	$(BIN)/python -m benchmarks.run $(ARGS)

bench-compare: $(STAMPS)/dev $(NATIVE) ## measure, and compare with this machine's last entry: more than 3 % is flagged
	$(BIN)/python -m benchmarks.compare $(ARGS)

golden: $(STAMPS)/dev $(NATIVE) ## write golden files that are missing; never touches one that exists
	LIDARCODEC_GOLDEN=write $(BIN)/python -m pytest -q tests/golden

identity: $(STAMPS)/dev ## the same bytes from gcc and clang, all optimisations, this processor and a 64-bit ARM (ARGS="--only g++")
	$(BIN)/python -m tests.compilers $(ARGS)

fuzz: $(STAMPS)/dev $(NATIVE) ## hostile bytes: the core under AddressSanitizer, all round trips, then the whole decoder (CASES, SEED, SECONDS_EACH)
	@PYTHON=$(BIN)/python tools/fuzz.sh

soak: $(STAMPS)/base $(NATIVE) ## publish and subscribe for minutes: nothing lost in silence, memory flat
	$(BIN)/python -m benchmarks.soak $(ARGS)

load: $(STAMPS)/dev $(NATIVE) ## 100 vehicles, 50 viewers and 10,000 requests a minute through one router and one server (an hour)
	$(BIN)/python -m benchmarks.load $(ARGS)

faults: $(STAMPS)/dev $(NATIVE) ## break everything that can break under a running stream, and measure: docs/operations.md (an hour)
	$(BIN)/python -m tests.faults $(ARGS)
	$(BIN)/python -m tests.failing

sweeps: $(STAMPS)/dev $(NATIVE) ## tests that take long and show little more than others like them, and all random examples (several minutes)
	LIDARCODEC_EXAMPLES=all $(BIN)/python -m pytest -n $(JOBS) -m "sweep or hypothesis or drawn" $(ARGS)

images-check: $(STAMPS)/dev ## build both images step by step in a chroot and run them together: docs/images.md (root, 30 min)
	$(BIN)/python -m tests.images --write docs/images.md $(ARGS)

format: $(STAMPS)/dev ## put every file into the house's form
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .
	$(BIN)/clang-format -i $(CXX_FILES)

native: $(NATIVE) ## build the native core into lidarcodec/

tables: $(STAMPS)/dev $(NATIVE) ## write what repeats tables of the code: in the documents, docs/openapi.json, and sensors in the native core
	@PYTHONPATH=. $(BIN)/python tools/tables.py
	@PYTHONPATH=. $(BIN)/python tools/sensor_tables.py
	@$(BIN)/python -m lidarcodec_server.openapi docs/openapi.json

evidence: $(STAMPS)/dev $(NATIVE) ## write docs/evaluation.md and the table of README.md from benchmarks/results
	@$(BIN)/python -m benchmarks.evidence

web: ## build the page from clients/web into the server's package, where it is committed (needs node 20.19 and npm)
	cd clients/web && $(NPM_CI) && npm run --silent build

wasm: ## build the decoder that the page runs, from native/, where it is committed; then run `make web` (needs clang, lld and wasi-libc)
	@sh tools/build-wasm.sh

foxglove: ## build the extension for Foxglove into clients/foxglove/dist, an archive that is dragged into its window (needs node and npm)
	cd clients/foxglove && $(NPM_CI) && npm run --silent build

site: $(STAMPS)/site ## build the site of the documents into build/site; build/site/index.html opens in a browser
	@NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --quiet --strict $(ARGS)

clean: ## remove the environment and every build
	rm -rf $(VENV) build lidarcodec/_native*.so clients/*/node_modules clients/typescript/dist clients/foxglove/dist

# --- set-up ---------------------------------------------------------------------------------------------------------

$(STAMPS)/build: requirements/build.txt
	@sh tools/check-system.sh
	@echo "Setting up $(VENV) (once) ..."
	@test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	@$(LOCKED)/build.txt
	@rm -rf build/native
	@mkdir -p $(STAMPS) && touch $@

$(STAMPS)/base: $(STAMPS)/build pyproject.toml requirements/base.txt
	@echo "Installing what lidarcodec needs ..."
	@$(LOCKED)/base.txt
	@$(PIP) $(EDITABLE) -e .
	@touch $@

$(STAMPS)/server: $(STAMPS)/base requirements/server.txt
	@echo "Installing what its server needs ..."
	@$(LOCKED)/server.txt
	@touch $@

$(STAMPS)/dev: $(STAMPS)/base requirements/dev.txt requirements/oracle.txt
	@echo "Installing what its tests need ..."
	@$(LOCKED)/dev.txt
	@$(PIP) --require-hashes --no-deps -r requirements/oracle.txt 2>/dev/null \
	  || echo "No wheel of ouster-sdk here: tests that compare with it are skipped"
	@$(PIP) -c constraints.txt '$(TORCH)+cpu' 2>/dev/null \
	  || $(PIP) -c constraints.txt --index-url https://download.pytorch.org/whl/cpu '$(TORCH)' 2>/dev/null \
	  || { [ "$$(uname -sm)" != "Linux x86_64" ] && $(PIP) -c constraints.txt '$(TORCH)' 2>/dev/null; } \
	  || echo "No CPU build of torch here (docs/development.md says where it is): tests of training are skipped"
	@touch $@

$(STAMPS)/site: $(STAMPS)/build requirements/site.txt
	@echo "Installing what the site needs ..."
	@$(LOCKED)/site.txt
	@touch $@

# What the page's own tests need. Without node and npm, or a registry, they are skipped by name: the built page is committed.
$(WEB): $(STAMPS)/build clients/web/package-lock.json clients/typescript/package-lock.json clients/foxglove/package-lock.json
	@if command -v npm >/dev/null; then echo "Installing what the tests of the page, the decoder in TypeScript and the extension need ..."; \
	  (cd clients/web && $(NPM_CI)) || echo "npm could not: tests of the sources of clients/web are skipped"; \
	  (cd clients/typescript && $(NPM_CI)) || echo "npm could not: tests of clients/typescript are skipped"; \
	  (cd clients/foxglove && $(NPM_CI)) || echo "npm could not: tests of clients/foxglove are skipped"; fi
	@touch $@

# Checks of the page and of the decoder in TypeScript: they read files of their own only, so they run when one of these has changed.
$(CLIENTS): $(WEB) $(CLIENT_SOURCES)
	@if [ -d clients/web/node_modules ]; then cd clients/web && npm run --silent lint && npm run --silent types \
	  && npm run --silent test -- --pool=threads --no-isolate && npm run --silent stale; fi
	@if [ -d clients/typescript/node_modules ]; then cd clients/typescript && npm run --silent test; fi
	@touch $@

$(NATIVE): $(STAMPS)/build $(NATIVE_SOURCES)
	@echo "Building the native core ..."
	@MAKEFLAGS= PYTHON=$(BIN)/python tools/build-native.sh
	@touch $@
