# Two commands do all the set-up themselves: `make demo` and `make test`.
PYTHON ?= python3
BIN := .venv/bin
export PIP_DISABLE_PIP_VERSION_CHECK = 1
export PIP_ROOT_USER_ACTION = ignore
# Several threads are slower than one on matrices as small as ours; the service and its commands see to it themselves.
export OPENBLAS_NUM_THREADS = 1
# Many tests start the program: without compiled modules each start compiles all of it anew, for half a second of CPU.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: demo demo-docker demo-docker-down test test-wheel lint docs bench fuzz dialect reference lock clean

# The environment with the program in it: .venv/bin/gcs-coloc.
.venv: .venv/.ready
.venv/.ready: requirements.lock pyproject.toml
	sh tools/make-venv $(PYTHON) requirements.lock
	touch $@

.venv/.ready-dev: requirements-dev.lock .venv/.ready
	$(BIN)/python -m pip install -qq --require-hashes -r requirements-dev.lock
	touch $@

demo: .venv/.ready
	$(BIN)/gcs-coloc study demo --out out/demo

# The same in containers, one for each aircraft; needs Docker with Compose and nothing else.
demo-docker:
	sh tools/demo-docker up

demo-docker-down:
	sh tools/demo-docker down

# Four processes on two cores: many tests wait for a wire. By file: a file's tests share what they have set up, as the containers.
# In the order of tests/conftest.py: files that wait among those that compute.
# In a fresh clone each of them would compile all tests: they are compiled once, while packages are fetched.
TEST_JOBS ?= 4
test: .venv/.ready-dev
	[ -d tests/unit/core/__pycache__ ] || $(BIN)/python -m pytest --collect-only -qq >/dev/null 2>&1 & sh tools/install-test-tools && wait
	$(BIN)/python -m pytest -n $(TEST_JOBS) --dist loadfile --no-loadscope-reorder

test-wheel:
	sh tools/test-wheel $(PYTHON)

lint: .venv/.ready-dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

# The site of documentation and API reference, out/docs/index.html. A broken link, anchor or reference ends the build.
docs: .venv/.ready-dev
	rm -rf out/docs docs/reference/modules
	$(BIN)/sphinx-build --quiet --fail-on-warning --keep-going --builder html docs out/docs

# Some ten minutes; BENCH= takes longer and measures more finely, BENCH="--quick accuracy" another section, BENCH=all everything, for hours.
BENCH ?= --quick
# What the service is measured beside, and with, has no build for every machine: the table says what is not installed.
bench: .venv/.ready-dev
	@$(BIN)/python -m pip install --quiet -e '.[bench]' || echo "the extra bench cannot be installed here whole"
	$(BIN)/python -m bench $(BENCH)

# Fuzzes the codec and the signatures, guided by coverage; an input that does harm is kept among the regression cases. So many runs are
# more than 10^7 bytes. atheris has no build for every machine: where it cannot be had, that is said.
FUZZ_RUNS ?= 50000
fuzz: .venv/.ready-dev
	@if $(BIN)/python -m pip install --quiet -e '.[fuzz]'; then \
	    $(BIN)/python tests/fuzz/fuzz_codec.py -atheris_runs=$(FUZZ_RUNS) -seed=1 -max_len=600 -len_control=0 -verbosity=0 -print_final_stats=1 \
	        -artifact_prefix=tests/fuzz/regressions/; \
	else echo "atheris cannot be installed here: not fuzzed"; fi

# Regenerates the committed message classes from gcs_coloc/mavlink/gcs_coloc.xml.
dialect: .venv/.ready
	$(BIN)/python -m tools.regenerate_dialect

# Writes the tables of settings in docs/reference from the settings' classes.
reference: .venv/.ready
	$(BIN)/python -m tools.settings_reference

# Renews the lock files from pyproject.toml; needs uv.
lock: 
	uv pip compile --quiet --universal --python-version 3.11 --generate-hashes --no-header --no-annotate --extra plots -o requirements.lock pyproject.toml
	uv pip compile --quiet --universal --python-version 3.11 --generate-hashes --no-header --no-annotate --extra plots --extra dev --extra docs -c requirements.lock -o requirements-dev.lock pyproject.toml

clean:
	rm -rf .venv out build *.egg-info
