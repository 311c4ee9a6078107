# `make book` and `make test` do everything, starting from an empty clone.

PYTHON ?= python3
SCALE  := $(or $(OFFAIRL_SCALE),demo)

BIN   := .venv/bin
ENV   := .venv/.installed
STAGE := build/$(SCALE)
HTML  := _build/html

# A chapter or a laboratory note is run again when it, the package, a record or the environment has
# changed, at each scale apart. (The usual execution caches look at the notebook alone.) If a cell
# fails, the page is rendered with a mark, and run again the next time.
CHAPTERS := $(wildcard book/*.ipynb book/notes/*.ipynb)
SOURCES  := $(wildcard book/*.py book/figures/*.py book/_static/toys/*) book/checks/__init__.py $(shell find offairl_lite book/records -type f -not -name '*.pyc' -not -name curve.png -not -path '*/checkpoint/*' 2>/dev/null)
RUN      := $(CHAPTERS:%=$(STAGE)/%.run)
CHANGED  := $(STAGE)/changed

# The seconds of a cell: at most ten minutes, except at full scale.
CELL    := $(if $(filter full,$(SCALE)),-1,600)
EXECUTE := --nbmake --overwrite --nbmake-kernel=python3 --nbmake-timeout=$(CELL)

# Processes that share the tests and the chapters.
WORKERS ?= auto

# One thread: small networks gain nothing from more, and curves do not depend on the machine's
# cores. So as many chapters run side by side, up to four: each needs about a gigabyte of memory.
export OMP_NUM_THREADS ?= 1
JOBS ?= $(shell getconf _NPROCESSORS_ONLN | awk '{print ($$1 < 4 ? $$1 : 4)}')
export IPYTHONDIR := $(CURDIR)/build/ipython

.PHONY: help book lab stage html test portable soak system clean

help:
	@echo 'make book    run every chapter that has changed and render the book'
	@echo 'make lab     open the chapters in JupyterLab, to change and run them'
	@echo 'make test    run all checks: style, package, chapters, rendered book, browser'
	@echo 'make portable  repeat pages as other processors would round: PAGES=05_off_policy_airl RUNS=5'
	@echo 'make soak    kill runs of all kinds at random moments, as long as you like: MINUTES=10'
	@echo 'make system  install Chromium, which the browser checks need (Debian, Ubuntu; as root)'
	@echo 'make clean   remove everything the commands above have made'

book: $(ENV) stage
	@rm -f $(CHANGED)
	@$(MAKE) --no-print-directory $(RUN)
	@[ ! -e $(CHANGED) ] || $(BIN)/python book/execute.py run $(STAGE) $$(cat $(CHANGED)) --jobs=$(JOBS) --timeout=$(CELL) || true
	@$(MAKE) --no-print-directory html
	@$(BIN)/python book/execute.py report $(STAGE)
	@echo 'The book is ready. Open $(CURDIR)/$(HTML)/index.html'

# The pages to run. A page's own checks are book/checks/PAGE.py.
.SECONDEXPANSION:
$(STAGE)/%.run: % $(SOURCES) $$(wildcard book/checks/$$(basename $$(notdir $$*)).py) $$(wildcard book/rollouts/*.py) $(ENV) | stage
	@cp $< $(STAGE)/$<
	@echo $< >> $(CHANGED)

lab: $(ENV) stage
	$(BIN)/jupyter lab book

# All of the book but the chapters, which are executed in the staging folder; and a profile that
# keeps the kernels' start-up notices out of the output.
stage:
	@mkdir -p $(STAGE) build/ipython/profile_default
	@tar -cf - --exclude '*.ipynb' --exclude .ipynb_checkpoints --exclude checkpoint --exclude curve.png --exclude __pycache__ book README.md _config.yml _toc.yml | tar -xf - -C $(STAGE)
	@echo 'c.IPKernelApp.log_level = 40' > build/ipython/profile_default/ipython_kernel_config.py

# Render the chapters as executed. For the tests a warning is an error, the next time too: forget
# what was read. A reader gets the book whatever happens.
html: $(ENV) stage
	@$(BIN)/jupyter-book build $(STAGE) --path-output . -q $(if $(filter 1,$(OFFAIRL_STRICT)),-W --keep-going) \
	  || { rm -rf _build/.doctrees; exit 1; }

# Tests trust no earlier run: every chapter is executed afresh, once, and that is what is rendered.
# A statement of a page that does not hold is an error.
test: export OFFAIRL_STRICT = 1
test: $(ENV)
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/mypy
	@rm -rf $(STAGE) _build
	@$(MAKE) --no-print-directory stage
	@tar -cf - $(CHAPTERS) | tar -xf - -C $(STAGE)
	$(BIN)/pytest -rs -n $(WORKERS) --dist worksteal --ignore tests/book tests $(STAGE)/book $(EXECUTE)
	$(BIN)/pytest -rs tests/book --book $(STAGE)
	JOBS=$(JOBS) $(BIN)/python book/portable.py --changed
	@touch $(RUN)

# Which statements would fail on another machine? PAGES are those that compute something, or some of
# them; RUNS adds so many runs to what book/portable.json has of them.
portable: $(ENV)
	JOBS=$(JOBS) $(BIN)/python book/portable.py $(PAGES) $(if $(RUNS),--runs $(RUNS))

# Every trial names a seed, with which SOAK_SEED=... does it again.
soak: $(ENV)
	SOAK_MINUTES=$(or $(MINUTES),10) $(BIN)/pytest -q -s -k any_kind tests/runs/test_folders.py

$(ENV): pyproject.toml constraints.txt
	@command -v $(PYTHON) >/dev/null \
	  || { echo '$(PYTHON) not found: install Python 3.11 or newer, or name one: make PYTHON=/path/to/python' >&2; exit 1; }
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' \
	  || { echo "$$($(PYTHON) --version) is too old: Python 3.11 or newer is needed: make PYTHON=/path/to/python" >&2; exit 1; }
	@$(PYTHON) -c 'import ensurepip, venv' 2>/dev/null \
	  || { echo '$(PYTHON) has no venv module: install it (Debian, Ubuntu: apt install python3-venv)' >&2; exit 1; }
	@echo 'Installing into .venv; the first time takes some minutes.'
	@$(PYTHON) -m venv .venv
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[dev]'
	@touch $@

system:
	@if command -v chromium >/dev/null || command -v google-chrome >/dev/null; then :; \
	elif ! command -v apt-get >/dev/null; then \
	  echo 'make system knows apt only: install Chromium or Google Chrome by hand.' >&2; exit 1; \
	elif [ "$$(id -u)" != 0 ]; then \
	  echo 'Chromium is installed as root: sudo make system' >&2; exit 1; \
	else \
	  apt-get update -qq && DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends chromium >/dev/null; \
	fi

clean:
	rm -rf build _build .venv
