# Two commands do everything: `make demo` and `make test`.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
INSTALLED := $(VENV)/installed
TESTED := $(VENV)/installed-test

.PHONY: demo test lint warm bench clean

demo: $(INSTALLED)
	$(BIN)/deepfracture shatter pot --out shattered

test: $(TESTED)
	$(BIN)/ruff check src tests examples benchmarks
	$(BIN)/ruff format --check src tests examples benchmarks
	$(BIN)/pyright
	$(BIN)/pytest

lint: $(TESTED)
	$(BIN)/ruff check --fix src tests examples benchmarks
	$(BIN)/ruff format src tests examples benchmarks
	$(BIN)/pyright

bench: $(INSTALLED)
	$(BIN)/deepfracture bench all

$(BIN)/python:
	$(PYTHON) -m venv $(VENV)

# Installing also compiles the kernels once, so that the first command is as quick as the next.
$(INSTALLED): $(BIN)/python pyproject.toml
	$(BIN)/pip install --quiet --editable .
	$(BIN)/deepfracture warm
	touch $@

$(TESTED): $(INSTALLED)
	$(BIN)/pip install --quiet --editable '.[test]'
	npm install --silent --no-save --prefix tests/tools gltf-validator@2.0.0-dev.3.10 || echo "no npm: the glTF validator test will be skipped"
	touch $@

clean:
	rm -rf $(VENV) shattered runs
