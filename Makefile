# CI calls these words and no others; so does a contributor.
PYTHON ?= python3
VENV   ?= .venv
BENCH  ?= .venv-bench
SOURCE ?= $(wildcard $(or $(RACF_DATA),../shared/data))
BIN    := $(VENV)/bin
STAMP  := $(VENV)/.installed

.PHONY: setup check test test-extras bench bench-env study faults demo lock format clean

define NEEDS_PYTHON
import sys
has = sys.version_info[:2]
if not (3, 10) <= has <= (3, 13):
    sys.exit("Python 3.10 to 3.13 is needed and $(VENV) has %d.%d: remove $(VENV), then make setup PYTHON=python3.12" % has)
endef
export NEEDS_PYTHON

setup: $(STAMP)

# An environment that exists is kept: picamera2 needs one that was made with --system-site-packages.
$(STAMP): pyproject.toml requirements.lock
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	@$(BIN)/python -c "$$NEEDS_PYTHON"
	$(BIN)/python -m pip install --quiet $$(grep -oE '^uv==[^ ]+' requirements.lock)
	$(BIN)/uv pip install --quiet --python $(BIN)/python --compile-bytecode --require-hashes -r requirements.lock
	$(BIN)/uv pip install --quiet --python $(BIN)/python --no-deps --no-build-isolation -e .
	$(BIN)/python -c 'import racf; racf.warm_up()'
	touch $(STAMP)

check: setup
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/basedpyright
	$(BIN)/python -m tools.check_lock

test: setup
	$(BIN)/python -m pytest -n 2 -m "not realtime" --cov --cov-report=
	$(BIN)/coverage report --include='racf/*' --fail-under=95
	$(BIN)/coverage report --include='follow/safety/*' --fail-under=99
	$(BIN)/python -m pytest -m realtime -rs

# A second environment: CSRT and KCF come with OpenCV's contrib wheel, which cannot live beside the plain one.
$(BENCH)/.installed: pyproject.toml requirements.lock
	$(PYTHON) -m venv $(BENCH)
	$(BENCH)/bin/python -m pip install --quiet $$(grep -oE '^uv==[^ ]+' requirements.lock)
	sed '/^opencv-python-headless==/,/[^\\]$$/d' requirements.lock > $(BENCH)/requirements.txt
	$(BENCH)/bin/uv pip install --quiet --python $(BENCH)/bin/python --require-hashes -r $(BENCH)/requirements.txt
	$(BENCH)/bin/uv pip install --quiet --python $(BENCH)/bin/python 'distributed>=2025.1' \
		$$(grep -oE '^opencv-python-headless==[^ ]+' requirements.lock | sed 's/python/contrib-python/')
	$(BENCH)/bin/uv pip install --quiet --python $(BENCH)/bin/python --no-deps --no-build-isolation -e .
	touch $@

bench-env: $(BENCH)/.installed

bench: $(BENCH)/.installed
	$(BENCH)/bin/racf bench $(SOURCE) --updates 10000

# Which settings hold on sequences they were not chosen on: the tables of docs/study.md.  SOURCE as unpacked folders.
study: setup
	$(BIN)/python -m tools.studies.halves $(SOURCE) --out out/study

# Every fault, flown; a minute of garbage into each reader; a million wishes through the gate; a minute's flight each.
faults: setup
	$(BIN)/python -m tools.faults
	$(BIN)/python -m tools.fuzz.gate --rounds 1000000
	$(BIN)/python -m tools.fuzz.inputs --seconds 60
	$(BIN)/python -m tools.fuzz.page --seconds 60
	$(BIN)/python -m benchmarks.setpoint_timing --seconds 60
	FOLLOW_RUN_S=60 $(BIN)/python -m pytest tests/follow/test_follow_run.py

# The main job, end to end: a simulated walker, followed, recorded and scored.
demo: setup
	$(BIN)/follow sim walker --out out/demo

# What needs the extras: the Dask cluster, OpenCV's own trackers.
test-extras: $(BENCH)/.installed
	$(BENCH)/bin/python -m pytest tests/racf/test_evaluate_runner.py tests/racf/test_evaluate_speed.py tests/racf/test_evaluate_peers.py \
		tests/racf/test_study_halves.py

format: setup
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

lock: setup
	$(BIN)/uv pip compile pyproject.toml --extra dev --group build --universal --python-version 3.10 \
		--generate-hashes --no-emit-index-url --no-annotate --custom-compile-command "make lock" -o requirements.lock

clean:
	rm -rf $(VENV) $(BENCH) build dist
