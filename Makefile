# Two commands: `make run` (the main job) and `make test`. Both create .venv and install what they need.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin

.PHONY: run test test-slow lint docs clean

$(VENV)/.installed: pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --editable .
	touch $@

$(VENV)/.installed-test: pyproject.toml $(VENV)/.installed
	$(BIN)/python -m pip install --quiet --editable '.[test]'
	touch $@

$(VENV)/.installed-docs: pyproject.toml $(VENV)/.installed
	$(BIN)/python -m pip install --quiet --editable '.[docs]'
	touch $@

run: $(VENV)/.installed
	$(BIN)/bench demo

# side by side; a file's tests share their recordings, so they stay on one worker
test: $(VENV)/.installed-test
	$(BIN)/python -m pytest -m 'not slow' -n 2 --dist loadfile

# those that run in real time come last, alone on the machine
REAL_TIME := tests/bench/live tests/rig/virtual
test-slow: $(VENV)/.installed-test
	$(BIN)/python -m pytest -m slow -n 2 --dist loadfile --durations=25 $(addprefix --ignore=,$(REAL_TIME))
	$(BIN)/python -m pytest -m slow --durations=10 $(REAL_TIME)

lint: $(VENV)/.installed-test
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

# the documentation as a site in site/; a broken link fails
docs: $(VENV)/.installed-docs
	$(BIN)/mkdocs build --strict --quiet

clean:
	rm -rf $(VENV) runs site
