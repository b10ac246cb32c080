# Every target sets up what it needs, from a bare clone: Python 3.11 or newer, git and make.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
UV := $(BIN)/uv pip install --quiet --python $(BIN)/python
RUN := $(VENV)/.run
DEV := $(VENV)/.dev
PARTS := library client pages migrations service worker cli
PROJECTS := $(PARTS:%=%/pyproject.toml)

# Where this is set, every process compiles all the Python that it imports.
unexport PYTHONDONTWRITEBYTECODE
# One thread multiplies matrices: tests and diagnoses share the cores out themselves.
export OPENBLAS_NUM_THREADS ?= 1

.DEFAULT_GOAL := help
.PHONY: help setup demo look demo-arm serve test quick advisories check laws flow bench docs site \
	pictures gallery lock clean

help: ## list the targets
	@awk -F ':.*## ' '/^[a-z-]+:.*## / { printf "  make %-10s %s\n", $$1, $$2 }' $(MAKEFILE_LIST)

$(BIN)/uv:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and \
		"trueup needs Python 3.11 or newer: make PYTHON=python3.12 …")'
	@echo "making $(VENV) …"
	@$(PYTHON) -m venv $(VENV)
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check uv

$(RUN): $(BIN)/uv requirements.txt $(PROJECTS)
	@echo "installing what trueup needs to run …"
	@$(UV) --require-hashes -r requirements.txt
	@$(UV) --no-deps $(PARTS:%=--editable ./%)
	@echo "compiling the rollout kernels …"
	@$(BIN)/trueup kernels
	@touch $@

$(DEV): $(RUN) requirements-dev.txt
	@echo "installing what the tests need …"
	@$(UV) --require-hashes -r requirements-dev.txt
	@touch $@

setup: $(DEV) ## build the environment in .venv

demo: $(RUN) ## run the main job on a real recording, with embedded storage
	@$(BIN)/trueup demo

look: $(RUN) ## look at what the demo left behind, in a browser, until Ctrl-C
	@$(BIN)/trueup look --data .trueup/demo/data

demo-arm: $(RUN) ## run the main job for a six-joint arm given as MJCF; about two minutes
	@$(BIN)/trueup demo examples/so101 --work .trueup/demo-arm

serve: $(RUN) ## run the service with a worker, on embedded storage in .trueup
	@$(BIN)/trueup serve

test: $(DEV) ## run every test; brings its own PostgreSQL, S3 server and strace
	@$(BIN)/trueup kernels
	@$(BIN)/python tools/advisories.py --tell & \
		$(BIN)/python -m pytest -n 3 --dist loadfile --no-loadscope-reorder

quick: $(DEV) ## run the units, laws and structure without whole diagnoses; about a minute
	@$(BIN)/python -m pytest tests/unit tests/laws tests/structure -m 'not slow' -n 2 --dist loadfile

advisories: $(DEV) ## look the pinned packages up among published advisories; exit 1 if one is known
	@$(BIN)/python tools/advisories.py

check: $(DEV) ## format, lint, types, layers
	@$(BIN)/ruff format --check .
	@$(BIN)/ruff check .
	@$(BIN)/mypy
	@$(BIN)/lint-imports

laws: $(DEV) ## run the laws over every family, predictor and rule
	@$(BIN)/python -m pytest tests/laws

flow: $(DEV) ## run the tests from MCAP bytes to a moved pointer
	@$(BIN)/python -m pytest tests/flow

bench: $(DEV) ## measure, and print the figures beside their targets
	@$(BIN)/python -m bench

docs: $(RUN) ## write the pages that are made from the code
	@$(BIN)/python docs/make_settings.py
	@$(BIN)/python docs/make_effects.py
	@$(BIN)/python docs/make_tuning.py
	@PYTHONPATH=. $(BIN)/python docs/effect_pictures.py
	@$(BIN)/python docs/make_access.py
	@$(BIN)/python docs/make_commands.py
	@$(BIN)/python docs/make_api.py
	@$(BIN)/python docs/make_python.py
	@$(BIN)/python docs/make_gates.py
	@$(BIN)/python docs/make_figures.py
	@$(BIN)/python docs/make_capacity.py
	@$(BIN)/python docs/make_scoreboard.py

site: $(DEV) ## build the documentation as a site in build/site
	@$(BIN)/python docs/site/make_site.py
	@echo "build/site/index.html"

pictures: $(DEV) ## take the pictures of the documentation anew, from a diagnosis that runs now
	@PYTHONPATH=. $(BIN)/python docs/make_pictures.py
	@$(BIN)/python docs/method_pictures.py

OURS := trueup $(patsubst %,trueup-%,$(filter-out library,$(PARTS)))
COMPILE := $(BIN)/uv pip compile --quiet --universal --generate-hashes --no-annotate --no-header \
	$(OURS:%=--no-emit-package %)
gallery: $(DEV) ## run the notebooks of the gallery, and keep what they give
	@$(BIN)/jupyter execute --inplace --timeout=600 examples/gallery/*.ipynb

lock: $(BIN)/uv ## pin the dependencies anew
	@$(COMPILE) --extra mujoco --extra onnx --extra server $(PROJECTS) -o requirements.txt
	@$(COMPILE) -c requirements.txt --extra server --extra otlp --extra openid --extra mlflow --extra mujoco --extra onnx \
		--extra tables --extra ros --extra plot --extra usd --extra oci --extra fmu \
		--group pyproject.toml:dev $(PROJECTS) -o requirements-dev.txt
	@$(COMPILE) -c requirements-dev.txt --extra tables --extra ros --extra otlp --extra openid \
		cli/pyproject.toml service/pyproject.toml library/pyproject.toml -o deploy/server.txt
	@$(COMPILE) -c requirements-dev.txt --extra mujoco --extra onnx --extra otlp \
		cli/pyproject.toml service/pyproject.toml worker/pyproject.toml library/pyproject.toml \
		-o deploy/worker.txt

clean: ## remove the environment and everything that was made
	@rm -rf $(VENV) .trueup build
