# make run | test | check | docs | links | bench | mutation | clean: each sets up .venv first, from nothing but Python 3.11+ and a package index.
PYTHON ?= python3
# Among so many processes the tests are shared out; one of them plays all that needs a Ray.
WORKERS ?= 2
BIN := .venv/bin
STAMP := .venv/.installed
# What the main job needs is less than half of what tests and checks do; who has the latter has it. Compiling the 18,000 files
# that are installed takes a minute and more; Python compiles those that it imports.
SERVICE := .venv/.service
DOCS := .venv/.docs
# Images for containers like to set it: then every process would compile all that it imports anew.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: run test check lint spelling types doctests docs links format bench mutation clean
.DEFAULT_GOAL := run

$(STAMP): EXTRA = dev
$(SERVICE): EXTRA = service
$(DOCS): EXTRA = docs
$(STAMP) $(SERVICE) $(DOCS): pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' \
		|| { echo "error: found $$($(PYTHON) --version), expected Python 3.11 or newer (make PYTHON=python3.12 …)"; exit 2; }
	test -x $(BIN)/python || $(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-compile -c constraints.txt -e ".[$(EXTRA)]"
	touch $@

run: $(if $(wildcard $(STAMP)),$(STAMP),$(SERVICE))
	$(BIN)/apel run distractor-maze

# First what actors will need is compiled: many at once would do so side by side, for minutes.
test: $(STAMP)
	$(BIN)/python -c "from cluster.compiling import DEEP_LEARNERS, compile_for; compile_for(('apel', 'fixed', 'ssbas', 'uniform', *DEEP_LEARNERS))"
	$(BIN)/python -m pytest --numprocesses $(WORKERS) --dist loadgroup --no-loadscope-reorder

check: lint spelling types doctests

lint: $(STAMP)
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/lint-imports

spelling: $(STAMP)
	$(BIN)/codespell

types: $(STAMP)
	$(BIN)/mypy

doctests: $(STAMP)
	$(BIN)/python -m pytest --quiet -p no:cacheprovider --doctest-modules apel cluster jobs

# The site, in build/site; nothing in it asks another host. Its search needs a server: python -m http.server -d build/site
docs: $(DOCS)
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --quiet

# Links to other hosts too, which needs them to answer; those within the site fail `make docs`, those of other pages a test.
links: docs
	$(BIN)/linkchecker --no-status --check-extern build/site/index.html

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
	$(BIN)/python -m benchmarks.model_cost
	$(BIN)/python -m benchmarks.thousand_runs
	$(BIN)/python -m benchmarks.pixels
	$(BIN)/python -m benchmarks.soak --faults 100

mutation: $(STAMP)
	$(BIN)/python -m tests.mutation

clean:
	rm -rf .venv build *.egg-info .pytest_cache .mypy_cache .ruff_cache .import_linter_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
