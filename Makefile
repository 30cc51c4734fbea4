# The two commands a newcomer needs: `make run` and `make test`.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
DIALECT := link/dialect/skyrelay.py
# pytest-xdist workers
JOBS ?= 2

.PHONY: setup run test check quick soak format lock clean postgresql

setup: $(STAMP) $(DIALECT)

$(STAMP): requirements.lock pyproject.toml setup.py
	@test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes -r requirements.lock
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation --editable .
	@touch $(STAMP)

# Generated, not committed. The editable install above makes it too; this is for a changed overlay or pymavlink.
$(DIALECT): link/dialect/skyrelay.xml link/dialect/regenerate.py requirements.lock | $(STAMP)
	$(BIN)/python link/dialect/regenerate.py

run: setup
	@$(BIN)/skyrelay demo --serve || [ $$? -eq 130 ]

check: setup
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/pytest -q tests/system/test_house.py

quick: setup
	$(BIN)/pytest -q -n $(JOBS) --dist worksteal -m "not slow and not soak"

test: check postgresql
	$(BIN)/pytest -n $(JOBS) --dist worksteal -m "not soak"

# What the store's tests on PostgreSQL need: installed where it may be, said in one line where not.
postgresql: setup
	@$(BIN)/python -m tests.support.processes.postgresql

soak: setup postgresql
	$(BIN)/pytest -m soak --timeout 0

format: setup
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

# Needs uv; writes the pinned, hashed set every other target installs.
lock:
	uv pip compile --universal --python-version 3.11 --generate-hashes --all-extras --no-header --quiet pyproject.toml -o requirements.lock

clean:
	rm -rf $(VENV) $(DIALECT) build dist *.egg-info .mypy_cache .ruff_cache .pytest_cache .hypothesis
