# python3.11 where there is one: it is what constraints.txt was tested with.
PYTHON := $(shell command -v python3.11 || command -v python3)
BIN := .venv/bin

.PHONY: demo monitor test test-all lint benchmark clean

# One install serves every target; the stamp is renewed when the requirements change.
.venv/.installed: pyproject.toml constraints.txt
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[plot,test,dev]'
	touch $@

demo: .venv/.installed
	$(BIN)/uwirl
	@echo "The commands of uwirl are in .venv; for this terminal: source .venv/bin/activate"

# On this machine alone, while runs go on.
LOGDIR ?= outputs
monitor: .venv/.installed
	$(BIN)/tensorboard --logdir $(LOGDIR) --host localhost

test: .venv/.installed
	$(BIN)/python -m pytest -n auto --dist worksteal -m 'not slow'

test-all: .venv/.installed
	$(BIN)/python -m pytest

lint: .venv/.installed
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

benchmark: .venv/.installed
	$(BIN)/python benchmarks/world.py
	$(BIN)/python benchmarks/planning.py
	$(BIN)/python benchmarks/sweep.py
	$(BIN)/python benchmarks/envs.py
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[compare]'
	$(BIN)/python benchmarks/estimation.py

clean:
	rm -rf .venv build dist
