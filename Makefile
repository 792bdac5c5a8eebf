# `make run` and `make test` do all set-up themselves; the README shows the pip lines behind them.
PYTHON ?= python3
VENV ?= .venv
BIN = $(VENV)/bin
READY = $(VENV)/.ready
export PYTHONDONTWRITEBYTECODE := # else each process of the tests compiles every module again

.PHONY: run test slow-test lint perf docs leaderboard clean

run: $(READY)
	$(BIN)/bench run --model ft-mlp

test: $(READY)
	$(BIN)/python -m pytest -n auto --dist loadgroup

slow-test: $(READY)
	$(BIN)/python -m pytest -n auto --dist loadgroup -m slow

lint: $(READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/python tests/plain_words.py

# LONG=1: the benchmarks of many minutes, too. ONLY=EXPRESSION: some of them (pytest's -k), on screen.
PAGE = $(if $(ONLY),/dev/stdout,results/performance.md)
perf: $(READY)
	$(BIN)/python -m pip install --quiet --no-compile --constraint constraints.txt --editable ".[dev,perf]"
	OMP_NUM_THREADS=1 MKL_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(BIN)/python -m pytest \
	    tests/perf/perf_*.py --benchmark-only --benchmark-quiet --benchmark-json=$(VENV)/perf.json \
	    -v -rs -p no:xdist -p no:cacheprovider -m "$(if $(LONG),,not slow)" -k "$(ONLY)"
	$(BIN)/python tests/perf/write_page.py $(VENV)/perf.json $(PAGE)

docs: $(READY)
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict

leaderboard: $(READY)
	$(BIN)/bench reproduce leaderboard --write-only --site build/leaderboard

$(READY): pyproject.toml constraints.txt
	@echo "setting up $(VENV): a minute or more"
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --no-compile --constraint constraints.txt --editable ".[dev]"
	touch $(READY)

clean:
	rm -rf $(VENV) build dist *.egg-info
