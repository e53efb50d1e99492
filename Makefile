PYTHON ?= python3.11
VENV   := .venv
BIN    := $(VENV)/bin
PYTEST  = $(BIN)/python -m pytest --numprocesses $(PROCESSES) --dist loadfile
# Without PyTorch, the modules that train a network with it cannot be type-checked.
WITHOUT_TORCH := --follow-imports=silent --exclude 'training/(network|trainer)[.]py$$|_torch[.]py$$'
# Many tests wait for processes, sockets and disks, so one process more than there are cores keeps them all busy.
PROCESSES = $(shell $(BIN)/python -c 'import os; print(min(4, 1 + (os.cpu_count() or 1)))')
PIP    := $(BIN)/python -m pip --disable-pip-version-check

# Tests start hundreds of processes, which would otherwise compile every module again.
export PYTHONDONTWRITEBYTECODE :=

.DEFAULT_GOAL := help
.PHONY: help run test test-all check install dev chromium dist screenshots reference clean

help:  ## list the targets
	@grep -E '^[a-z-]+:.*## ' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 12

$(BIN)/python:
	$(PYTHON) -m venv $(VENV)

$(VENV)/.base: pyproject.toml constraints.txt | $(BIN)/python
	$(PIP) install --quiet -c constraints.txt -e '.[analysis,vision]'
	touch $@

# Each module is compiled when it is first imported; compiling all that is installed takes longer than many tests do.
$(VENV)/.dev: pyproject.toml constraints.txt | $(BIN)/python
	$(PIP) install --quiet --no-compile -c constraints.txt -e '.[dev,analysis,postgres,vision,osi]'
	touch $@ $(VENV)/.base

$(VENV)/.all: pyproject.toml constraints.txt | $(BIN)/python
	$(PIP) install --quiet --no-compile -c constraints.txt -e '.[dev,analysis,postgres,vision,osi,torch,ray,sumo]'
	touch $@ $(VENV)/.dev $(VENV)/.base

install: $(VENV)/.base  ## create .venv with what the README's commands need

dev: $(VENV)/.dev  ## create .venv with the test tools as well

run: $(VENV)/.base  ## run the quickstart campaign with a coordinator and two workers
	$(BIN)/brink run examples/quickstart.yaml --workers 2 --resume

check: $(VENV)/.dev  ## run the linter, the type checker and the layer check
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy $(if $(wildcard $(VENV)/lib/*/site-packages/torch),,$(WITHOUT_TORCH))
	$(BIN)/lint-imports

test: chromium $(VENV)/.dev  ## run `check` and, beside it, the tests

test-all: chromium $(VENV)/.all  ## as `test`, with the tests that take longer, or need PyTorch, Ray or SUMO
test-all: PYTEST += -m ''

test test-all:
	@$(MAKE) --no-print-directory check >$(VENV)/check.log 2>&1 & checks=$$!; \
	$(PYTEST); tests=$$?; \
	wait $$checks; checked=$$?; cat $(VENV)/check.log; \
	test $$tests -eq 0 && test $$checked -eq 0

screenshots: $(VENV)/.dev  ## retake the documentation's pictures of the dashboard in Chromium
	PYTHONPATH=tests:tests/plugins $(BIN)/python -m browser.screenshots

reference: $(VENV)/.dev  ## write the reference of the Python interface from its docstrings
	PYTHONPATH=tests $(BIN)/python -m support.python_reference

dist: $(VENV)/.base  ## build the wheel into dist/ and, where there is docker, the image
	$(PIP) wheel --quiet --no-deps --wheel-dir dist .
	if command -v docker >/dev/null; then \
		docker build --tag brink:$$($(BIN)/python -c 'import brink; print(brink.__version__)') .; \
	else echo 'no docker here: the image is not built'; fi

chromium:  ## install Chromium for the tests of the dashboard, unless it is installed
	@sh tests/browser/install_chromium.sh

clean:  ## remove .venv and caches
	rm -rf $(VENV) .mypy_cache .ruff_cache .pytest_cache .import_linter_cache
