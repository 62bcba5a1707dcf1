# Two commands do everything: `make demo` and `make test`.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
INSTALLED := $(VENV)/installed
TESTED := $(VENV)/installed-test
# Test processes; each runs whole files, so that the fixtures of a file are built once.
PROCESSES ?= 2

.PHONY: addon bench demo film docs test lint warm clean

demo: $(INSTALLED)
	$(BIN)/deepfracture shatter pot --out shattered

# A twenty-second film in six shots: runs/film/film.mp4.
film: $(INSTALLED)
	$(BIN)/python examples/film.py

# Time and memory of each stage on this machine, compared with the last run: runs/bench.
bench: $(INSTALLED)
	$(BIN)/deepfracture bench all --record runs/bench

# The documentation as web pages that open from disk: site/index.html.
docs: $(TESTED)
	$(BIN)/mkdocs build --strict

# The Blender add-on as a single file: Edit > Preferences > Get Extensions > Install from Disk.
addon: $(BIN)/python
	mkdir -p runs && rm -f runs/deepfracture-addon.zip
	cd blender/deepfracture && ../../$(BIN)/python -m zipfile -c ../../runs/deepfracture-addon.zip *.py *.toml

test: $(TESTED)
	$(BIN)/ruff check src tests benchmarks examples blender
	$(BIN)/ruff format --check src tests benchmarks examples blender
	$(BIN)/pyright
	$(BIN)/pytest --numprocesses $(PROCESSES) --dist loadfile

lint: $(TESTED)
	$(BIN)/ruff check --fix src tests benchmarks examples blender
	$(BIN)/ruff format src tests benchmarks examples blender
	$(BIN)/pyright

$(BIN)/python:
	$(PYTHON) -m venv $(VENV)

# The demo needs two extras, for the film and the page. Installing also compiles the kernels, so that the first command is fast.
$(INSTALLED): $(BIN)/python pyproject.toml
	$(BIN)/pip install --quiet --editable '.[render,play]'
	$(BIN)/deepfracture warm
	touch $@

# One pip call, without bytecode: most of the installed modules are never imported.
$(TESTED): $(BIN)/python pyproject.toml
	$(BIN)/pip install --quiet --no-compile --editable '.[test]'
	npm install --silent --no-package-lock --prefix tests/tools || echo "no npm: the glTF validator test will be skipped"
	$(BIN)/deepfracture warm
	touch $(INSTALLED) $@

clean:
	rm -rf $(VENV) shattered runs
