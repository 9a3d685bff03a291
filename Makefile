# Everything a fresh clone needs: python3 (3.11 to 3.13) with venv, and make.
PYTHON ?= python3
BIN := .venv/bin
ONCE_MORE := --reruns 1 --only-rerun "TimeoutError|TimeoutExpired" -rR --durations 12
PIP := $(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt

.PHONY: demo test test-slow mutants lint figures figures-check docs clean

demo: .venv/sim.stamp
	$(BIN)/trocar run peg-transfer --method calibrated --trials 1 --seed 1 --out out/demo

# A test whose page or process does not answer in time is tried once more, and named.
test: .venv/dev.stamp
	$(BIN)/pytest -m "not slow and not realtime" -n auto --dist loadfile --no-loadscope-reorder $(ONCE_MORE)

# The few tests that take seconds each: real runs, studies, killed processes; then, alone, those on the machine's clock.
# The latter have up to three tries, and those of several are named: a busy machine holds up processes that have to keep
# time, which looks like many faults; a fault of the code fails three times.
test-slow: .venv/dev.stamp
	$(BIN)/pytest -m slow -n auto --dist loadfile --no-loadscope-reorder $(ONCE_MORE)
	$(BIN)/pytest -m realtime --reruns 2 -rR --durations 12

# Which small mistakes the tests would not notice: ten seconds for each mutant, so not in CI. MUTANTS="--changed", say.
mutants: .venv/dev.stamp
	$(BIN)/python benchmarks/mutants.py $(MUTANTS)

lint: .venv/dev.stamp
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/pyright
	$(BIN)/lint-imports

# Figures of README.md and docs/: measured where the code has changed since, an evening for all; ARGS="--at-most 5" leaves
# out what takes longer. The check fails where README's figures are not of this code.
figures: .venv/dev.stamp
	$(BIN)/python tools/figures.py measure $(ARGS)

figures-check: .venv/dev.stamp
	$(BIN)/python tools/figures.py check

docs: .venv/docs.stamp
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict

.venv/bin/python:
	$(PYTHON) -m venv .venv

.venv/sim.stamp: pyproject.toml constraints.txt | .venv/bin/python
	@echo "installing into .venv (a minute or two)"
	$(PIP) --no-compile -e '.[sim]'
	@touch $@

.venv/dev.stamp: pyproject.toml constraints.txt | .venv/bin/python
	@echo "installing into .venv (a minute or two)"
	$(PIP) --no-compile -e '.[dev]'
	@touch $@

.venv/docs.stamp: pyproject.toml constraints.txt | .venv/bin/python
	$(PIP) --no-compile -e '.[docs]'
	@touch $@

clean:
	rm -rf .venv build dist site out
