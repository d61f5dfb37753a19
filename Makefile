# Two commands: `make run` (the main job) and `make test`. Both create .venv and install what they need.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
# two processes of tests: threads of linear algebra would wait for each other, spinning
export OMP_NUM_THREADS := 1
export OPENBLAS_NUM_THREADS := 1
export MKL_NUM_THREADS := 1

.PHONY: run test test-changed test-slow test-lowest lowest-tests lowest-demo lint types docs clean

# uv installs in a tenth of pip's time; where it cannot be had, pip does the same
define install
$(BIN)/python -m pip install --quiet uv \
	  && $(BIN)/uv pip install --quiet --python $(BIN)/python --editable '$(1)' \
	  || $(BIN)/python -m pip install --quiet --editable '$(1)'
	touch $@
endef

$(VENV)/.installed: pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(call install,.)

$(VENV)/.installed-test: pyproject.toml $(VENV)/.installed
	$(call install,.[test])

$(VENV)/.installed-docs: pyproject.toml $(VENV)/.installed
	$(call install,.[docs])

run: $(VENV)/.installed
	$(BIN)/bench demo

# side by side; a file's tests share their recordings, so they stay on one worker
test: $(VENV)/.installed-test
	$(BIN)/python -m pytest -m 'not slow' -n 2 --dist loadfile

# what the changes since the last commit can reach, nearest first, for a minute
test-changed: $(VENV)/.installed-test
	$(BIN)/python -m tests.changed

# those that run in real time and mostly wait come last, with nothing that computes next to them
REAL_TIME := tests/bench/live tests/rig/virtual
test-slow: $(VENV)/.installed-test
	$(BIN)/python -m pytest -m slow -n 2 --dist loadfile --durations=25 $(addprefix --ignore=,$(REAL_TIME))
	$(BIN)/python -m pytest -m slow -n 2 --dist loadfile --durations=10 $(REAL_TIME)

# a demo and the tests that meet every dependency, with the oldest versions that pyproject.toml allows
LOWEST := .venv-lowest
$(LOWEST)/.installed: pyproject.toml
	$(PYTHON) -m venv $(LOWEST)
	$(LOWEST)/bin/python -m pip install --quiet uv
	$(LOWEST)/bin/uv pip install --quiet --python $(LOWEST)/bin/python --resolution lowest-direct \
	  --only-binary :all: --no-binary shakerbench --editable '.[test]'
	touch $@
test-lowest: lowest-demo lowest-tests
lowest-demo: $(LOWEST)/.installed
	rm -rf $(LOWEST)/demo
	NUMBA_CACHE_DIR=.test-cache $(LOWEST)/bin/bench demo --out $(LOWEST)/demo
lowest-tests: $(LOWEST)/.installed
	$(LOWEST)/bin/python -m pytest -m 'not slow' -k 'not memory' -W ignore::DeprecationWarning tests/kernels/test_compiler.py \
	  tests/daq/export tests/rig/test_profile.py tests/bench/terminal/test_console.py tests/bench/drops/test_desk.py

lint: types $(VENV)/.installed-test
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/lint-imports
types: $(VENV)/.installed-test
	$(BIN)/mypy

# the documentation as a site in site/; a broken link fails
docs: $(VENV)/.installed-docs
	$(BIN)/mkdocs build --strict --quiet

clean:
	rm -rf $(VENV) $(LOWEST) .test-cache runs site
