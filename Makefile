# `make train` and `make test` set up what they need, once.
PYTHON ?= $(shell for python in python3.11 python3.12 python3.13 python3; do \
	$$python -c '' 2>/dev/null && echo $$python && break; done)
BIN := .venv/bin
INSTALLED := .venv/installed

.PHONY: help setup train test lint types docs clean

help: ## Show what can be made.
	@grep -hE '^[a-z]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 10

setup: $(INSTALLED) ## Install everything into .venv (once).

$(INSTALLED): setup.cfg setup.py pyproject.toml constraints.txt
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable '.[dev]'
	@touch $@

train: $(INSTALLED) ## Watch a robot develop: 10,000 decisions in the toy room.
	$(BIN)/torch-iac train

test: $(INSTALLED) lint types ## Check style, types and import order, and run all tests.
	$(BIN)/pytest -n auto --dist loadgroup

lint: $(INSTALLED) ## Check style and the order of imports.
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/lint-imports

types: $(INSTALLED) ## Check types.
	$(BIN)/mypy

docs: $(INSTALLED) ## Build the site of the documentation in build/site.
	$(BIN)/python -m scripts.docs.build_site

clean: ## Remove the installation, not the runs.
	rm -rf .venv build dist *.egg-info
