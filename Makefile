# Everything runs in .venv, which `make install` sets up from nothing.
PYTHON ?= python3
BIN := .venv/bin
DEMO := demo
# The studies of `make results`, with their options, and its time limit.
STUDY := all
MINUTES := 30
# Where pip finds torch. The default lets pip choose the build: with CUDA and 6 GB on Linux.
TORCH ?=
# A named place may lack the pinned versions of torch's own requirements, so there only torch is pinned; the package, installed next,
# brings the pinned versions.
# Without the byte code of 12,000 files, most of which no command imports: 1.6 GB in place of 1.9, in less time. Python writes the
# code of a file at its first import, whatever the environment says.
unexport PYTHONDONTWRITEBYTECODE
PIP_INSTALL := -m pip install --quiet --no-compile
INSTALL_TORCH := $(PIP_INSTALL) $(or $(TORCH),--constraint constraints.txt) $(shell grep -o '^torch==[0-9.]*' constraints.txt)

.DEFAULT_GOAL := help
.PHONY: help install demo test test-core test-apps slow bounds browser lint format docs notebooks results site check-site pictures dist lock release clean

help:
	@echo "make demo     set up, then book -> graph -> scorers -> agents -> a table and reports, on the book everyday"
	@echo "make test     set up, then the tests, in minutes, the core first; a part with make test-core, make test-apps"
	@echo "make install  set up .venv with the tools of tests; CPU build of torch with TORCH='--index-url URL', see docs/installation.md"
	@echo "make slow     thorough and long tests, property tests with more examples; of some rooms with ROOMS='tests/runs tests/models'"
	@echo "make bounds   the tests of scorers, policies and planning, with compiled loops that check bounds"
	@echo "make browser  the tests of pages in Chromium"
	@echo "make lint     ruff, mypy, directions of imports, generated pages"
	@echo "make docs     write docs/terms.md from the glossary, tables and figures of docs/evidence from their data"
	@echo "make results  train the next missing runs of all studies into results/ for MINUTES=30; of one with STUDY=parts"
	@echo "make notebooks  run the notebooks of docs/notebooks and store their outputs; of some with NOTEBOOKS='graphs agents'"
	@echo "make site     the guides, notebooks, Python reference and the demo in the explorer as a website, in site/"
	@echo "make check-site  every page of the website in Chromium: widths, colours, links, requests, sizes"
	@echo "make pictures  take the pictures of the guides again, in Chromium"
	@echo "make dist     build the sdist and the wheel in dist/, check both, and try them in clean environments"
	@echo "make lock     write benchmarks/requirements-results.txt: all packages of the results, with versions"
	@echo "make release  everything of a release but the upload: lint, tests, dist, versions and dates, commands to upload"
	@echo "make clean    remove what was built; .venv stays"

install: .venv/installed

# The package without the tools of tests, which the demo never needs.
.venv/package: pyproject.toml constraints.txt
	test -x $(BIN)/python || $(PYTHON) -m venv .venv
	@echo "installing torch and the package in .venv, 1.6 GB: about a minute"
	$(BIN)/python $(INSTALL_TORCH)
	$(BIN)/python $(PIP_INSTALL) --constraint constraints.txt --editable .
	touch $@

.venv/installed: .venv/package
	@echo "installing the tools of tests in .venv, .7 GB, once: browsers' clients, language-model clients, linters; a minute or two, pip alone"
	$(BIN)/python $(PIP_INSTALL) --constraint constraints.txt --editable ".[dev]"
	touch $@

demo: .venv/package
	$(BIN)/python examples/demo.py --out $(DEMO)

# In the order of tests/conftest.py, not by the number of tests.
FAST := -m "not slow and not browser" --numprocesses auto --dist loadfile --no-loadscope-reorder
# The core first, in the same session: libraries are imported and models of the tests trained once.
test: install
	@echo "5,700 tests: four minutes on two idle cores; the first run compiles byte code and inner loops, too"
	$(BIN)/python -m pytest $(FAST)

test-core: install
	$(BIN)/python -m pytest $(FAST) --ignore tests/apps

test-apps: install
	$(BIN)/python -m pytest $(FAST) tests/apps

# Property tests again, with more examples. 5: none of these rooms has a slow test. A slow test runs the
# notebooks, which needs the extra docs; those of Ray are skipped until `pip install -e ".[ray]"`. Bad input comes last.
slow: .venv/installed-docs
	$(BIN)/python -m pytest -m "(slow or hypothesis) and not browser" --hypothesis-profile thorough \
		--numprocesses auto --dist loadfile $(ROOMS) || [ $$? = 5 ]
	$(if $(ROOMS),,HOME=/nowhere $(BIN)/python -m benchmarks.fuzz --books 2000 --artefacts 1000 --folders 2000 --archives 10000 --values --every 4)

# Loops with checked bounds, and machine code of their own: the cached one checks none.
bounds: install
	NUMBA_BOUNDSCHECK=1 NUMBA_CACHE_DIR=$(CURDIR)/build/bounds $(BIN)/python -m pytest $(FAST) \
		tests/models/scorers tests/models/recipes tests/models/policies tests/planning

browser: install
	$(BIN)/python -m pytest -m browser --numprocesses auto --dist loadfile

lint: install
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	# Own ideas are short, and annotated only where it helps a reader.
	$(BIN)/mypy --strict examples --exclude examples/plugins
	$(BIN)/lint-imports --no-logo
	$(BIN)/python docs/make_terms.py --check
	$(BIN)/python docs/make_results.py --check
	$(BIN)/python docs/make_evidence.py --check
	$(BIN)/python docs/make_notebooks.py --check
	$(BIN)/python data/make_benchmark.py --check
	$(BIN)/python benchmarks/leaderboard_page.py leaderboard/everyday-v3 --out docs/leaderboard.md --check

format: install
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

docs: install
	$(BIN)/python docs/front_page.py
	$(BIN)/python docs/make_terms.py
	$(BIN)/python docs/make_results.py
	$(BIN)/python docs/make_evidence.py
	$(BIN)/python docs/make_notebooks.py --text

# 124: the time is over. Finished trainings stay in results/, and the next call resumes the unfinished ones.
results: install
	timeout --foreground --signal=INT $(MINUTES)m nice -n 19 sh -c '\
		$(BIN)/wordcraft-kg reproduce $(STUDY) --out results --keep metrics && \
		$(BIN)/wordcraft-kg reproduce $(STUDY) --book everyday --seeds 3 --out results --keep metrics' || [ $$? = 124 ]

.venv/installed-docs: .venv/installed
	$(BIN)/python $(PIP_INSTALL) --constraint constraints.txt --editable ".[docs]"
	touch $@

# Of some notebooks with NOTEBOOKS='graphs agents'; 5 minutes of CPU time in all.
notebooks: .venv/installed-docs
	$(BIN)/python docs/make_notebooks.py $(NOTEBOOKS)

# The site shows the demo's models and agents. Training takes longer than all pages, so a finished demo is kept.
$(DEMO)/reports/agents/index.html:
	$(MAKE) demo

site: .venv/installed-docs $(DEMO)/reports/agents/index.html
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict
	$(BIN)/wordcraft-kg explore $(DEMO)/graphs/everyday --model $(DEMO)/models/everyday-recipes --model $(DEMO)/models/everyday-partial \
		--run $(DEMO)/runs/recipes --run $(DEMO)/runs/no-kg --export site/everyday --force
	$(BIN)/wordcraft-kg explain $(DEMO)/runs/recipes --episodes 60 --json > $(DEMO)/explained.json
	$(BIN)/python docs/make_play.py $(DEMO)/explained.json $(DEMO)/graphs/everyday site/play/tasks.js

check-site: site
	$(BIN)/python docs/check_site.py site

pictures: site
	$(BIN)/python docs/make_pictures.py site/everyday $(DEMO)

dist: install
	$(BIN)/python .ci/check_dist $(TORCH)

# In an environment of its own: .venv also has the packages of tests. Usual indexes have no builds of torch with a local version, as
# 2.13.0+cpu.
LOCK := benchmarks/requirements-results.txt
lock:
	$(PYTHON) -m venv --clear build/lock
	build/lock/bin/python $(INSTALL_TORCH)
	build/lock/bin/python $(PIP_INSTALL) --constraint constraints.txt ".[text]"
	echo "# All packages of the results, by make lock on $$(build/lock/bin/python -VV | cut -d' ' -f1,2), $$(uname -sm)." > $(LOCK)
	echo "# The CPU build of torch comes first: its version below, from the index in docs/installation.md." >> $(LOCK)
	build/lock/bin/python -m pip freeze --exclude wordcraft-kg | sed 's/^\(torch==[0-9.]*\)+.*/\1/' >> $(LOCK)

release: install
	$(BIN)/python .ci/check_release
	$(MAKE) lint test slow browser dist
	@$(BIN)/python .ci/check_release --commands

clean:
	rm -rf $(DEMO) build site dist .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find . -name __pycache__ -not -path "./.venv/*" -prune -exec rm -rf {} +
