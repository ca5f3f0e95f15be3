# `make mission` and `make test` set everything up by themselves, in .venv.

VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.set-up
export PIP_CONSTRAINT := $(CURDIR)/constraints.txt
export PIP_DISABLE_PIP_VERSION_CHECK := 1
# Where bytecode is not kept, every worker of the tests and every process that one starts compiles all modules anew.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: help setup mission test lint types imports docs generated tutorials figures slow benchmark mutants proto system-deps clean

help:
	@echo "make mission    set up, then fly the R-path mission in the simulated tank"
	@echo "make test       set up, then run the tests"
	@echo "make lint types imports    style, types, import rules"
	@echo "make docs       the documentation, in build/docs    make tutorials [PAGE=my_own_path]    every command of it"
	@echo "make generated  the parts of the documentation that come from the code"
	@echo "make slow       the long checks       make benchmark    speeds, as ratios"
	@echo "make mutants    how many small faults the tests of safety and tracking see    [SEED=1 SAMPLE=200]"

setup: $(STAMP)

$(STAMP): pyproject.toml constraints.txt
	@python=$$(tools/find-python) && echo "Setting up $(VENV) with $$python" && "$$python" -m venv $(VENV)
	@$(BIN)/python -m pip install --quiet --editable '.[dev]'
	@echo "Compiling kernels and building field tables"
	@$(BIN)/python -m sim.warm_up
	@touch $@

mission: setup
	@$(BIN)/smolbot run r_path --json

test: setup
	$(BIN)/python -m pytest -n auto --dist worksteal --durations=10 -m "not slow and not realtime"
	$(REALTIME) || $(REALTIME) --last-failed

# A machine that stands still for a tenth of a second is no fault of what is tested: what failed is tried once more.
# Only files that hold such tests are read.
REALTIME = $(BIN)/python -m pytest -n 0 -m "realtime and not slow" $$(grep -rl 'mark\.realtime' tests --include='*.py')

lint: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/python tools/docstrings.py

types: setup
	$(BIN)/mypy

imports: setup
	$(BIN)/lint-imports
	$(BIN)/python tools/rooms.py

# Tables of keys and commands, the list of decisions and the picture of the rooms, which stand in the pages.
generated: setup
	$(BIN)/python tools/generate_docs.py

docs: setup
	$(BIN)/python tools/generate_docs.py --check
	@rm -rf docs/reference/generated
	$(BIN)/sphinx-build -W --keep-going -q -b html -d build/doctrees docs build/docs
	@echo "Open build/docs/index.html"

# All pages, or PAGE=name; the one that needs an idle machine only by its name.
tutorials: setup
	$(BIN)/python docs/run_tutorials.py $(if $(PAGE),$(PAGE),--quick --jobs 2)

figures: setup
	$(BIN)/python docs/figures.py $(NAME)

slow: setup
	$(BIN)/python -m pytest -n auto -m "slow and not realtime"
	$(BIN)/python -m pytest -n 0 -m "slow and realtime"

benchmark: setup
	$(BIN)/python -m pytest tests/benchmarks --benchmark-enable --benchmark-only -s

mutants: setup
	$(BIN)/python tests/mutation/mutants.py --seed $(or $(SEED),1) --sample $(or $(SAMPLE),200)

# The messages of a record, from their description.
proto: setup
	$(BIN)/python -m grpc_tools.protoc -I. --python_out=. --pyi_out=. smolbot/runs/recording/run.proto

# Debian packages that some tests need; the only target that touches the system.
system-deps:
	@packages=$$(grep -v '^#' tools/system-packages.txt || true); \
	if [ -z "$$packages" ]; then echo "No system package is needed."; \
	else apt-get update -q && apt-get install -y -q $$packages; fi

clean:
	rm -rf $(VENV) build *.egg-info
