# Two commands do all the set-up: `make compare` and `make test`.
# Folders carry the names of targets' subjects: every target is phony, and the stamp alone says what is installed.
PYTHON ?= python3
PRESET ?= standard
SCENES ?=
OUT    ?= out
# Processes of the main test lane (each compiles kernels and renders) and of the audit: more than the cores is no gain.
JOBS   ?= 2

.PHONY: help install compare variants view bench stress docs engines gallery quick test exam audit lint format clean distclean
.DEFAULT_GOAL := help

help: ## List the targets
	@awk -F ':.*## ' '/^[a-z]+:.*## /{printf "  make %-10s %s\n", $$1, $$2}' $(MAKEFILE_LIST)

.venv/.installed: pyproject.toml constraints.txt
	@echo "termwise: installing into .venv, which takes a minute or two"
	@$(PYTHON) -m venv .venv
	@.venv/bin/python -m pip install --disable-pip-version-check -qq -c constraints.txt -e '.[dev]'
	@.venv/bin/python -m termwise.reference.backend
	@touch $@

install: .venv/.installed ## Create .venv with everything in it

compare: .venv/.installed ## Render, compare and report: SCENES="monkey two_cubes" PRESET=quick OUT=out
	@.venv/bin/termwise compare $(SCENES) --study $(PRESET) --out $(OUT)

# The study of a preset other than `standard` carries its name.
variants: .venv/.installed ## Every estimator of the paper against what it converges to: PRESET=quick SCENES=monkey OUT=out
	@.venv/bin/termwise compare $(SCENES) --study variants$(patsubst %,-%,$(filter-out standard,$(PRESET))) --out $(OUT)

view: .venv/.installed ## All inputs on a local page, each term while it converges: SCENES=monkey OUT=out
	@.venv/bin/termwise view $(firstword $(SCENES)) --out $(OUT)

bench: .venv/.installed ## Speed beside Mitsuba's: rays, seconds to equal error, scaling, reductions, view; OUT=out
	@.venv/bin/termwise bench rays --out $(OUT)
	@.venv/bin/termwise bench terms --out $(OUT)
	@.venv/bin/termwise bench scaling --out $(OUT)
	@.venv/bin/termwise bench reductions --out $(OUT)
	@.venv/bin/termwise bench view --out $(OUT)

engines: .venv/.installed ## Other renderers, each into an environment of its own: Cycles, LuxCore
	@.venv/bin/python -m termwise.reports.engines.install

gallery: .venv/.installed ## Engines, rightly and wrongly set, on two scenes: one page of pictures and verdicts; OUT=out
	-@.venv/bin/termwise compare --diffuse --row total --no-probe --study reports/engines/gallery.toml --spp 128 \
	  $(addprefix --engine ,mitsuba cycles luxcore $(wildcard reports/engines/settings/*.toml)) --out $(OUT)/gallery \
	  $(if $(WORKERS),--workers $(WORKERS)) $(if $(SCHEDULER),--scheduler $(SCHEDULER))

stress: .venv/.installed ## Exact properties under hostile input, beside the paper's code and Mitsuba; OUT=out
	@.venv/bin/termwise stress --out $(OUT)

docs: .venv/.installed ## Build the manual, without network, where any warning is an error; OUT=out
	@.venv/bin/python -m sphinx -W --keep-going -q -d $(OUT)/.doctrees docs $(OUT)/docs
	@echo "$(OUT)/docs/index.html"

# A rare test has kernels of its own, those of glass, images or a light of each kind: here it runs as plain Python.
test: .venv/.installed ## Run all tests that take some seconds at most
	@.venv/bin/python -m tests.warm test $(JOBS)
	.venv/bin/python -m pytest -q -n $(JOBS) --dist loadfile -m "not (slow or rare or plain)"
	NUMBA_DISABLE_JIT=1 .venv/bin/python -m pytest -q -n $(JOBS) -m "(rare or plain) and not slow" tests/kernels \
	  tests/oracle/test_shadow_rule.py

exam: .venv/.installed ## Run what `make test` leaves out: what takes long, kernels of rare scenes, and all as plain Python
	@.venv/bin/python -m tests.warm exam $(JOBS)
	.venv/bin/python -m pytest -q -n $(JOBS) --dist loadfile -m "(slow or rare) and not plain"
	NUMBA_DISABLE_JIT=1 .venv/bin/python -m pytest -q -n $(JOBS) -m "slow or not (rare or plain)" tests/kernels

quick: .venv/.installed ## Tests of a minute or so, for work on the sources: no Mitsuba, no browser, nothing slow
	@.venv/bin/python -m tests.warm test $(JOBS)
	.venv/bin/python -m pytest -q -n $(JOBS) --dist loadfile -m "not (slow or rare or plain)" tests/kernels tests/unit tests/verdict

audit: .venv/.installed ## Judge the verdicts: their false alarms, and the faults planted in our sources that they catch; OUT=out
	OPENBLAS_NUM_THREADS=1 .venv/bin/python -m tests.audit --out $(OUT) --jobs $(JOBS)

lint: .venv/.installed ## Check style, types and layers
	.venv/bin/ruff check
	.venv/bin/ruff format --check
	.venv/bin/pyright
	.venv/bin/lint-imports

format: .venv/.installed ## Format the sources
	.venv/bin/ruff check --fix
	.venv/bin/ruff format

clean: ## Remove results and the tools' caches
	rm -rf out .pytest_cache .ruff_cache .hypothesis .import_linter_cache

distclean: clean ## Remove the environment and all cached work too
	rm -rf .venv .cache
