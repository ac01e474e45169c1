PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed

.PHONY: dry-run test check long bench mutation test-socketcan setup-socketcan install clean

dry-run: $(STAMP)  ## one docking cycle with mock hardware
	$(BIN)/portdock dry-run

SHORT := not long and not benchmark_ratio

test: $(STAMP)  ## what only computes, on all cores; what keeps time, two at once; whole cells, one after another
	$(BIN)/pytest tests -m "$(SHORT) and not real_time" --numprocesses logical --dist worksteal
	$(BIN)/pytest tests -m "$(SHORT) and real_time and not whole_cell" --numprocesses 2 --dist loadfile
	$(BIN)/pytest tests -m "$(SHORT) and whole_cell"

check: $(STAMP)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

long: $(STAMP)  ## what takes too long for every change
	$(BIN)/pytest tests -m long --timeout 7200

bench: $(STAMP)  ## ratios measured in one run, on a quiet machine
	$(BIN)/pytest tests/benchmarks -m benchmark_ratio --timeout 3600

mutation: $(STAMP)  ## do the tests notice changes of states, gate and codecs? an hour or more; tests/README.md says how to read it
	$(BIN)/mutmut run --max-children 1
	$(BIN)/mutmut results
	$(BIN)/python tests/mutation/at_import.py

test-socketcan: $(STAMP)  ## the charger's link and a whole dry run on a real kernel's CAN, in user-mode Linux; says so when that is missing
	$(BIN)/python tests/socketcan/run_in_uml.py

SOCKETCAN_PACKAGES := user-mode-linux can-utils iproute2
APT := $(if $(filter 0,$(shell id -u)),,sudo) apt-get -o Acquire::Retries=0 -o Acquire::http::Timeout=20

setup-socketcan:  ## what test-socketcan needs, from Debian
	$(APT) install --yes --no-install-recommends $(SOCKETCAN_PACKAGES) || \
	{ $(APT) update && $(APT) install --yes --no-install-recommends $(SOCKETCAN_PACKAGES); }

PREFIX ?= /opt/portdock

install:  ## everything under PREFIX, nothing elsewhere; says what is left to do
	$(PYTHON) -m venv $(PREFIX)
	$(PREFIX)/bin/pip install --quiet $(PIP_OPTIONS) ".[fast]"
	install -d $(PREFIX)/lib/systemd/system $(PREFIX)/lib/udev/rules.d $(PREFIX)/lib/systemd/network $(PREFIX)/share/doc
	sed 's#/opt/portdock#$(PREFIX)#g' docs/deploy/portdock.service > $(PREFIX)/lib/systemd/system/portdock.service
	install -m 644 docs/deploy/60-portdock.rules $(PREFIX)/lib/udev/rules.d/
	install -m 644 docs/deploy/80-portdock-can.network $(PREFIX)/lib/systemd/network/
	install -m 644 docs/*.md $(PREFIX)/share/doc/
	@echo "installed; next: $(PREFIX)/share/doc/commissioning.md"

$(STAMP): pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(BIN)/pip install --quiet --upgrade pip
	$(BIN)/pip install --quiet --editable ".[dev,fast]"
	touch $@

clean:
	rm -rf $(VENV) dist build
