# make run | test | check | bench | clean: each sets up .venv first, from nothing but Python 3.11+ and a package index.
PYTHON ?= python3
BIN := .venv/bin
STAMP := .venv/.installed

.PHONY: run test check format bench clean
.DEFAULT_GOAL := run

$(STAMP): pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' \
		|| { echo "error: found $$($(PYTHON) --version), expected Python 3.11 or newer (make PYTHON=python3.12 …)"; exit 2; }
	test -x $(BIN)/python || $(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e ".[dev]"
	touch $(STAMP)

run: $(STAMP)
	$(BIN)/apel run distractor-maze

test: $(STAMP)
	$(BIN)/python -m pytest

check: $(STAMP)
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/python -m pytest --quiet -p no:cacheprovider --doctest-modules apel cluster jobs

format: $(STAMP)
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

bench: $(STAMP)
	$(BIN)/python -m benchmarks.main_job
	$(BIN)/python -m benchmarks.selector_cost
	$(BIN)/python -m benchmarks.linear_cost
	$(BIN)/python -m benchmarks.statistics
	$(BIN)/python -m benchmarks.startup
	$(BIN)/python -m benchmarks.monitoring
	$(BIN)/python -m benchmarks.checkpoint_cost
	$(BIN)/python -m benchmarks.thousand_runs
	$(BIN)/python -m benchmarks.pixels
	$(BIN)/python -m benchmarks.soak --faults 100

clean:
	rm -rf .venv build *.egg-info .pytest_cache .mypy_cache .ruff_cache .import_linter_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
