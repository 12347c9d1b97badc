# Two commands for a newcomer: `make demo` and `make test`. `make help` lists the rest.
PYTHON ?= python3
ARGS ?=
BIN := .venv/bin
UV_VERSION := 0.13.9
PCL_INCLUDE = $(firstword $(wildcard /usr/include/pcl-*))
PCL_LIBRARIES := segmentation sample_consensus filters search kdtree common

.PHONY: help demo test check bench nightly lock clean system
.DEFAULT_GOAL := help

help:
	@echo "make demo             one whole assembly on fake devices, page at http://127.0.0.1:8080 (ARGS=--once ends)"
	@echo "make test             the tests"
	@echo "make check            lint, types, import contracts"
	@echo "make bench            benchmarks as ratios, to docs/benchmarks.md; ARGS=\"--only time\" for one part"
	@echo "make nightly MINUTES=60   long campaigns, figures to docs/figures"

system:
	@sh deploy/check-libraries.sh

# Rebuilt when the lock changes; uv comes from PyPI into the project's own environment.
$(BIN)/.ready: pyproject.toml uv.lock | system
	test -x $(BIN)/python || $(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --disable-pip-version-check uv==$(UV_VERSION)
	$(BIN)/uv sync --frozen --inexact --quiet
	touch $@

demo: $(BIN)/.ready
	$(BIN)/cellctl demo $(ARGS)

test: $(BIN)/.ready
	$(BIN)/pytest -n 2 $(ARGS)

check: $(BIN)/.ready
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

build/pcl_pipeline: tests/benchmarks/pcl_pipeline.cpp
	@sh tests/benchmarks/check-pcl.sh
	mkdir -p $(@D)
	$(CXX) -O3 -std=c++17 -fopenmp -I$(PCL_INCLUDE) -I/usr/include/eigen3 $< -o $@ $(PCL_LIBRARIES:%=-lpcl_%)

bench: $(BIN)/.ready build/pcl_pipeline
	OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(BIN)/python -m tests.benchmarks $(ARGS)

nightly: $(BIN)/.ready
	$(BIN)/python -m tests.nightly --minutes $(or $(MINUTES),60)

lock:
	$(BIN)/uv lock

clean:
	rm -rf .venv data dist build
