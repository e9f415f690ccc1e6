# For a fresh machine with Python >= 3.11:
#   make demo      install what the suite needs into .venv, test our own node with it, and write a report
#   make test      install everything into .venv; lint, and the core of the tests: about four minutes on two processors
#   make test-all  the other parts of the tests: about nine minutes; CONTRIBUTING.md says what each part is for
# For longer:
#   make test-fresh FOR=3600        new random seeds, round after round, for an hour or until a test fails
#   make test-repeat N=10 LOAD=4    `make test` in ten fresh clones, beside four busy processes
PYTHON ?= python3
VENV   := .venv
BIN    := $(VENV)/bin
STAMP  := $(VENV)/.installed
DEMO   := $(VENV)/.installed-demo
comma  := ,
# Distributions beside the kit, with what their tests need.
PARTS  := -e './lab[plot]' -e './tables[dask,duckdb,report]' -e ./selftest
KAITAI := node_modules/kaitai-struct-compiler/package.json
PYTEST := $(BIN)/pytest -q -n auto
# uv installs in a tenth of the time of pip. It does not read pip's configuration: where it cannot install, pip does.
INSTALL = $(BIN)/uv pip install --python $(BIN)/python $(1) || $(BIN)/pip install --disable-pip-version-check $(1)

# Tests see the same environment whoever runs them. tests/conftest.py removes more; these act before it is read.
unexport PYTEST_ADDOPTS PYTEST_PLUGINS PYTHONPATH PYTHONHOME PYTHONOPTIMIZE PYTHONWARNINGS PYTHONSTARTUP
unexport PYTHONDONTWRITEBYTECODE
unexport HYPOTHESIS_PROFILE DCP_EXAMPLES
export PYTHONHASHSEED := 0

.PHONY: docs man demo test test-all test-computing test-waiting test-suite test-tools test-tables test-links test-c-node \
        test-versions test-lowest test-fresh test-repeat lint release picture bench bench-columns bench-fuzz matrix \
        selftest-doc clean

# Status 3: something is inconclusive, as on a machine that is too busy; the command names it.
demo: $(DEMO)
	@echo "The suite now tests our own node over virtual Ethernet (UDP without root): about a minute."
	@$(BIN)/dcp-conformance run --report-dir demo-report || [ $$? -eq 3 ]

test: lint
	$(PYTEST) --part=core

lint: $(STAMP)
	$(BIN)/ruff check --quiet .
	$(BIN)/ruff format --check --quiet .
	$(BIN)/mypy
	$(BIN)/lint-imports --no-logo

# Tests in real time wait most of the time, so that they run beside the parts that compute, which give way to them.
test-all: $(STAMP) $(KAITAI)
	$(MAKE) -j2 --output-sync=target test-computing test-waiting

# Three parts in one run: importing the tests for each part takes long. Neighbouring tests share fixtures of a worker.
test-computing: $(STAMP) $(KAITAI)
	nice $(PYTEST) --dist worksteal --part=suite --part=tools --part=tables

test-waiting: $(STAMP)
	$(MAKE) test-links
	$(MAKE) test-c-node

test-tools: $(KAITAI)

test-suite test-tools test-tables: $(STAMP)
	$(PYTEST) --part=$(@:test-%=%)

# Tests in real time wait more than they compute, hence more of them at a time.
test-links: $(STAMP)
	$(PYTEST) -n 10 --dist loadfile --part=links

FOR  ?= 3600
N    ?= 10
LOAD ?= 0
JOBS ?= 1
WHAT ?= test

test-fresh: $(STAMP) $(KAITAI)
	$(BIN)/python tests/meta/fresh.py --seconds $(FOR)

test-repeat:
	$(PYTHON) tests/meta/repeat.py -n $(N) --load $(LOAD) --jobs $(JOBS) $(WHAT)

# Codec, node and specification with every Python from 3.11 to 3.14 that is on this machine, and with the lowest
# versions of the dependencies: minutes each.
test-versions: $(STAMP)
	$(BIN)/python -m tools.versions

test-lowest: $(STAMP)
	$(BIN)/python -m tools.versions --lowest

# The Kaitai compiler that a test runs; without npm that test says so and is skipped.
$(KAITAI): package.json
	@if command -v npm >/dev/null; then npm install --silent --no-package-lock --no-audit --no-fund --ignore-scripts; fi

bench: $(STAMP)
	$(BIN)/python benchmarks/codec.py
	$(BIN)/python benchmarks/stack.py
	$(BIN)/python benchmarks/simulate.py
	$(BIN)/python benchmarks/links.py
	$(BIN)/python benchmarks/impairment.py
	$(BIN)/python benchmarks/startup.py --rounds 5
	$(BIN)/python benchmarks/ccodec.py

# Columnar decoding beside construct, scapy, struct, tshark and a plain copy, side by side in one run.
bench-columns: $(STAMP)
	$(BIN)/python benchmarks/columns.py

# Mutated beacons and sequences a second, in process, by two workers, and against a live node on both links.
bench-fuzz: $(STAMP)
	$(BIN)/python benchmarks/fuzz.py
	$(BIN)/python benchmarks/fuzz.py --jobs 2
	$(BIN)/python benchmarks/fuzz.py --live

# The documentation site: site/index.html. A broken link is an error.
docs: $(STAMP)
	$(BIN)/python -m tools.docs

# Everything that a release consists of: build/release.
release: $(STAMP)
	$(BIN)/python -m tools.release

# The picture of the README, for a new version (chromium): a minute.
picture: $(STAMP)
	$(BIN)/python -m tools.picture

# The whole suite against the example node in C, built with sanitizers, over virtual Ethernet (root): three minutes.
test-c-node: $(STAMP)
	$(BIN)/python -m tests.ccodec.suite

# Man pages of all commands and their subcommands, for a folder of MANPATH: build/man/man1.
man: $(STAMP)
	$(BIN)/python -m tools.docs.man_pages build/man/man1

# Regenerate docs/traceability.md and add new cases to the ledger of identifiers.
matrix: $(STAMP)
	$(BIN)/dcp-selftest matrix

# Regenerate docs/selftest.md: all cases that name a requirement against its mutants, all permitted variants, three
# draws of random changes of the node, and the test vectors.
selftest-doc: $(STAMP)
	$(BIN)/dcp-selftest mutants --document docs/selftest.md
	$(BIN)/dcp-selftest model --described --shrink --sequences 1500 --document docs/selftest.md
	$(BIN)/dcp-selftest variants --document docs/selftest.md
	$(BIN)/dcp-selftest generated 200 --seed 701 --seed 702 --seed 703 --document docs/selftest.md
	$(BIN)/dcp-selftest vectors --document docs/selftest.md

$(STAMP) $(DEMO): pyproject.toml lab/pyproject.toml tables/pyproject.toml selftest/pyproject.toml
	@echo "Installing into $(VENV) ..."
	@test -x $(BIN)/pip || $(PYTHON) -m venv $(VENV)
	@$(BIN)/pip install --quiet --disable-pip-version-check uv || true
	@$(call INSTALL,$(if $(findstring demo,$@),-e '.[conformance$(comma)scapy]' -e ./lab,-e '.[test]' $(PARTS)))
	@touch $@

clean:
	rm -rf $(VENV) demo-report .pytest_cache .mypy_cache .ruff_cache .hypothesis
