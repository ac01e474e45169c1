PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed

.PHONY: dry-run test check long bench install clean

dry-run: $(STAMP)  ## one docking cycle with mock hardware
	$(BIN)/portdock dry-run

test: $(STAMP)
	$(BIN)/pytest tests -m "not long and not benchmark_ratio"

check: $(STAMP)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

long: $(STAMP)  ## what takes too long for every change
	$(BIN)/pytest tests -m long --timeout 7200

bench: $(STAMP)  ## ratios measured in one run, on a quiet machine
	$(BIN)/pytest tests/benchmarks -m benchmark_ratio --timeout 3600

$(STAMP): pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(BIN)/pip install --quiet --upgrade pip
	$(BIN)/pip install --quiet --editable ".[dev,fast]"
	touch $@

clean:
	rm -rf $(VENV) dist build
