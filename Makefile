PYTHON ?= python3.11
VENV   := .venv
BIN    := $(VENV)/bin
# Many tests wait for processes, sockets and disks: one more than there are cores keeps all of these busy.
PROCESSES = $(shell $(BIN)/python -c 'import os; print(min(4, 1 + (os.cpu_count() or 1)))')
PIP    := $(BIN)/python -m pip --disable-pip-version-check

.DEFAULT_GOAL := help
.PHONY: help run test check install dev chromium screenshots clean

help:  ## list the commands
	@grep -E '^[a-z-]+:.*## ' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 12

$(BIN)/python:
	$(PYTHON) -m venv $(VENV)

$(VENV)/.base: pyproject.toml constraints.txt | $(BIN)/python
	$(PIP) install --quiet -c constraints.txt -e .
	touch $@

$(VENV)/.dev: pyproject.toml constraints.txt | $(BIN)/python
	$(PIP) install --quiet -c constraints.txt -e '.[dev,analysis,postgres,vision,torch,ray]'
	touch $@ $(VENV)/.base

install: $(VENV)/.base  ## set up .venv with what `brink run` needs

dev: $(VENV)/.dev  ## set up .venv with the test tools too

run: $(VENV)/.base  ## find a hazard boundary: the quickstart campaign, coordinator and two workers
	$(BIN)/brink run examples/quickstart.yaml --workers 2 --resume

check: $(VENV)/.dev  ## linter, strict types, import layers
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

test: chromium check  ## check, then every test, on SQLite and on a real Postgres, in a process more than there are cores (up to four)
	$(BIN)/python -m pytest --numprocesses $(PROCESSES) --dist loadfile

screenshots: $(VENV)/.dev  ## take the documentation's pictures of the dashboard anew, in Chromium
	PYTHONPATH=tests:tests/plugins $(BIN)/python -m browser.screenshots

chromium:  ## install the browser that the dashboard is tested in, unless there is one
	@sh tests/browser/install_chromium.sh

clean:  ## remove .venv and caches
	rm -rf $(VENV) .mypy_cache .ruff_cache .pytest_cache .import_linter_cache
