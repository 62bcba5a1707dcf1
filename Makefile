# Two commands do everything: `make demo` and `make test`.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
INSTALLED := $(VENV)/installed
TESTED := $(VENV)/installed-test

.PHONY: demo test lint warm clean

demo: $(INSTALLED)
	$(BIN)/deepfracture shatter pot --out shattered

test: $(TESTED)
	$(BIN)/ruff check src tests benchmarks examples
	$(BIN)/ruff format --check src tests benchmarks examples
	$(BIN)/pyright
	$(BIN)/pytest

lint: $(TESTED)
	$(BIN)/ruff check --fix src tests benchmarks examples
	$(BIN)/ruff format src tests benchmarks examples
	$(BIN)/pyright

$(BIN)/python:
	$(PYTHON) -m venv $(VENV)

# Installing also compiles the kernels once, so that the first command is as quick as the next.
$(INSTALLED): $(BIN)/python pyproject.toml
	$(BIN)/pip install --quiet --editable .
	$(BIN)/deepfracture warm
	touch $@

$(TESTED): $(INSTALLED)
	$(BIN)/pip install --quiet --editable '.[test]'
	npm install --silent --no-package-lock --prefix tests/tools || echo "no npm: the glTF validator test will be skipped"
	touch $@

clean:
	rm -rf $(VENV) shattered runs
