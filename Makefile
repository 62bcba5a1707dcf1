# Two commands do everything: `make demo` and `make test`.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
INSTALLED := $(VENV)/installed
TESTED := $(VENV)/installed-test
# That run tests at once, whole files each: what a file's tests share is made once.
PROCESSES ?= 2

.PHONY: addon bench demo film docs test lint warm clean

demo: $(INSTALLED)
	$(BIN)/deepfracture shatter pot --out shattered

# Twenty seconds in six shots: runs/film/film.mp4.
film: $(INSTALLED)
	$(BIN)/python examples/film.py

# What each stage costs here, and against the last time: runs/bench.
bench: $(INSTALLED)
	$(BIN)/deepfracture bench all --record runs/bench

# The documentation as pages that open from disk: site/index.html.
docs: $(TESTED)
	$(BIN)/mkdocs build --strict

# The Blender add-on as one file: Edit > Preferences > Get Extensions > Install from Disk.
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

# What the demo shows needs two extras: a film and a page. Installing also compiles the kernels once, so that the first command is as quick as the next.
$(INSTALLED): $(BIN)/python pyproject.toml
	$(BIN)/pip install --quiet --editable '.[render,play]'
	$(BIN)/deepfracture warm
	touch $@

# All in one go, and bytecode of what is imported only: most of it never is.
$(TESTED): $(BIN)/python pyproject.toml
	$(BIN)/pip install --quiet --no-compile --editable '.[test]'
	npm install --silent --no-package-lock --prefix tests/tools || echo "no npm: the glTF validator test will be skipped"
	$(BIN)/deepfracture warm
	touch $(INSTALLED) $@

clean:
	rm -rf $(VENV) shattered runs
