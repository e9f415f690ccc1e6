# Two commands for a fresh machine with Python >= 3.11:
#   make demo    install into .venv, test our own node with the whole suite, and write a report
#   make test    install into .venv and run everything that CI runs: about ten minutes on two processors
# For longer:
#   make test-fresh FOR=3600      new random seeds, round after round, for an hour or until a test fails
#   make test-repeat N=10 LOAD=2  `make test` in ten fresh clones, with two busy processes beside
PYTHON ?= python3
VENV   := .venv
BIN    := $(VENV)/bin
STAMP  := $(VENV)/.installed
KAITAI := node_modules/kaitai-struct-compiler/package.json

# Tests see the same environment whoever runs them. tests/conftest.py removes more; these act before it is read.
unexport PYTEST_ADDOPTS PYTEST_PLUGINS PYTHONPATH PYTHONHOME PYTHONOPTIMIZE PYTHONWARNINGS PYTHONSTARTUP
unexport HYPOTHESIS_PROFILE DCP_EXAMPLES
export PYTHONHASHSEED := 0

.PHONY: docs man demo test test-versions test-lowest test-fresh test-repeat lint unit bench bench-columns bench-fuzz matrix selftest-doc clean

demo: $(STAMP)
	@$(BIN)/dcp-conformance run --report-dir demo-report

test: lint unit

lint: $(STAMP)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

unit: $(STAMP) $(KAITAI)
	@echo "About 7 minutes of tests on two processors, longer on a busy machine."
	$(BIN)/pytest -n auto -m "not real_time"
	@echo "Tests in real time, by themselves: about three minutes."
	$(BIN)/pytest -n 3 --dist loadfile -m real_time

FOR  ?= 3600
N    ?= 10
LOAD ?= 0

test-fresh: $(STAMP) $(KAITAI)
	$(BIN)/python tests/meta/fresh.py --seconds $(FOR)

test-repeat:
	$(PYTHON) tests/meta/repeat.py -n $(N) --load $(LOAD)

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

# Man pages of all commands and their subcommands, for a folder of MANPATH: build/man/man1.
man: $(STAMP)
	$(BIN)/python -m tools.docs.man_pages build/man/man1

# Regenerate docs/traceability.md and add new cases to the ledger of identifiers.
matrix: $(STAMP)
	$(BIN)/python -m dcp_conformance.traceability

# Regenerate docs/selftest.md: all cases that name a requirement against its mutants, all permitted variants,
# and three draws of random changes of the node.
selftest-doc: $(STAMP)
	$(BIN)/dcp-conformance selftest --document docs/selftest.md
	$(BIN)/dcp-conformance selftest --variants --document docs/selftest.md
	$(BIN)/dcp-conformance selftest --generated 200 --seed 501 --seed 502 --seed 503 --document docs/selftest.md

$(STAMP): pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(BIN)/pip install --quiet --disable-pip-version-check -e '.[test]'
	@touch $@

clean:
	rm -rf $(VENV) demo-report .pytest_cache .mypy_cache .ruff_cache .hypothesis
