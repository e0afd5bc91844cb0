PYTHON ?= python3.11
VENV ?= .venv
BIN := $(VENV)/bin
TEST_WORKERS ?= 2

# The editable install links the files it finds, so it is made again when a file is added or removed.
SOURCES := $(sort $(wildcard $(shell find symsol_annot cli -name '*.py') blender_assets/*.py blender_assets/*/* symsol_annot/sample_data/*/* symsol_annot/bench/models/recipes/* symsol_annot/gallery/page/* symsol_annot/publish/card.md symsol_annot/publish/citation.cff))
INSTALLED := $(VENV)/installed-$(word 1,$(shell echo $(SOURCES) | cksum))

.PHONY: demo test check lint docs format soak perf attack mutate card lock assets sample release clean

demo: $(INSTALLED)  ## render, annotate, verify, score and draw a small set of two objects, in data/
	$(BIN)/symsol-annot render --object cylO --train 0 --test 64
	$(BIN)/symsol-annot render --object tetX --train 0 --test 32
	$(BIN)/symsol-annot verify data --audit 2
	$(BIN)/symsol-annot reference data/cylO data/tetX --row evenly-placed --out data/reference
	@echo "Pictures to look at:"
	@$(BIN)/symsol-annot plot images data/cylO --out data/cylO-test.png
	@$(BIN)/symsol-annot plot images data/tetX --out data/tetX-test.png

test: lint  ## every check, with all its set-up: what CI runs
	$(BIN)/pytest -n $(TEST_WORKERS) --dist loadfile

check: test

lint: $(INSTALLED)  ## the quick checks
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/mypy --config-file tools/mypy.ini tools/*.py tools/attack tools/soak
	$(BIN)/mypy --config-file tools/mypy.ini tools/perf
	$(BIN)/lint-imports
	$(BIN)/python -m symsol_annot_assets.build --check --out blender_assets

docs: $(INSTALLED)  ## the site, in build/site; a broken link is an error
	$(BIN)/mkdocs build --strict

soak: $(INSTALLED)  ## the slow tests, and long proofs on real renders and processes, in build/soak.json; as root, 40 minutes
	$(BIN)/pytest -n $(TEST_WORKERS) --dist loadfile -m slow
	$(BIN)/python tools/soak

perf: $(INSTALLED)  ## speed and memory, beside the common recipe, drawing every candidate, and PNG files
	$(BIN)/python tools/perf

attack: $(INSTALLED)  ## 15,000 damaged and hostile files for every reader, in build/attack.json; three quarters of an hour
	$(BIN)/python tools/attack

mutate: $(INSTALLED)  ## change the code a little, many times, and name the changes that no test notices; half an hour
	$(BIN)/python tools/mutations.py

card: $(INSTALLED)  ## write dataset_card.md again from the figures that were measured
	$(BIN)/python tools/dataset_card.py write

lock: $(INSTALLED)  ## pin what an installation with Blender brings, by version and hash, in constraints-render.txt
	$(BIN)/python tools/lock_render.py

format: $(INSTALLED)
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .
	$(BIN)/python docs/rooms.py

SAMPLE := symsol_annot/sample_data
sample: $(INSTALLED)  ## render the set inside the package again; seed 45 has a tetX whose marking barely shows
	rm -rf build/sample
	$(BIN)/symsol-annot render --object cylO --train 128 --test 64 --seed 45 --out build/sample
	$(BIN)/symsol-annot render --object tetX --train 256 --test 64 --seed 45 --out build/sample
	rm -rf $(SAMPLE)
	mv build/sample $(SAMPLE)

release: $(INSTALLED)  ## build wheel and sdist in dist/, and try them in empty environments: each Python, each extra
	$(BIN)/python tools/release.py

assets: $(INSTALLED)  ## build the objects again
	$(BIN)/python -m symsol_annot_assets.build --out blender_assets

clean:
	rm -rf $(VENV) build dist *.egg-info

$(INSTALLED): pyproject.toml constraints.txt
	$(PYTHON) -m venv $(VENV)
	$(BIN)/pip install --quiet --disable-pip-version-check --constraint constraints.txt \
		--editable '.[render,plot,publish,gallery,mesh,bench,tensorboard,cluster,docs,dev]' --config-settings editable_mode=strict
	$(BIN)/symsol-annot doctor --install
	$(BIN)/python tools/gallery_browser.py
	rm -f $(VENV)/installed-*
	touch $@
