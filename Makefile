# demo: see it fly.  check: before each commit.  test: prove it.  lint: read it.  bench: time it.  Each makes .venv itself when there is none.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip --quiet --disable-pip-version-check
# tests/conftest.py says how many workers a machine's cores get, and which tests stay together.
WORKERS := -n logical --maxprocesses 8
BENCHES := $(patsubst %/__main__,%,$(basename $(shell grep -ls __main__ benches/*.py benches/*/__main__.py)))

INSTALL := @sh supply/install.sh $(BIN)/python

LIBRARIES := estimator/core/libdecklander.so.1 sitl/core/libdecklander_sim.so.1
BINDINGS := estimator/core/abi.py sitl/core/abi.py
CORE := $(LIBRARIES) $(BINDINGS)

.PHONY: core demo check test pythons qualify test-aarch64 test-image test-v4l2 test-install wheels size deb version lint bench docs fuzz mutants sbom licences audit workflows pins release emptied

# The core compiles while the packages are fetched.
demo:
	@$(MAKE) --no-print-directory -j2 core
	$(BIN)/decklander demo

# Before each commit: lint, types, the limits of benches/house.toml, and every test but those of the slow files that tests/conftest.py names.
check: lint
	@$(BIN)/python -m benches.house --check
	$(BIN)/pytest $(WORKERS) -m "not slow"

test: lint
	$(BIN)/pytest $(WORKERS)

# `make check` and one demo with every Python of the classifiers that this machine has, each in an environment of its own.
pythons:
	@sh supply/pythons.sh

# Slow proofs that a change of Python rarely breaks: sanitizers, another architecture, kernel devices, installations, a learned
# detector, no pad where there is none, the page and a report in a browser, each bench's smallest run, the guides' long flights.
qualify: $(VENV)/.dev $(VENV)/.compiler $(CORE)
	$(BIN)/pytest qualification

# The native libraries (estimator/core, sitl/core), with cc where there is one, else with zig's compiler. Only what changed is compiled.
core: $(CORE)
	@:

$(LIBRARIES) &: $(shell find estimator/core sitl/core -name "*.[ch]") supply/core.py | $(BIN)/python $(if $(shell command -v cc 2>&1),,$(VENV)/.compiler)
	@$(BIN)/python -m supply.core libraries

$(BINDINGS) &: estimator/core/decklander.h sitl/core/decklander_sim.h supply/core.py | $(VENV)/.runtime
	@$(BIN)/python -m supply.core bindings

# The core's calls as a Raspberry Pi computes them: cross-built by zig, under qemu-aarch64 (apt install qemu-user).
test-aarch64: $(VENV)/.dev $(VENV)/.compiler $(CORE)
	$(BIN)/pytest qualification/test_core.py -k architectures

# Wheels for x86-64 and aarch64 in dist/, which need no compiler where they are installed, and the source archive; ready for PyPI.
wheels: $(VENV)/.dev $(VENV)/.compiler
	$(BIN)/python -m supply.wheels

# Packages, MB and seconds of pip install: the wheel alone, each extra, and other libraries; the table of docs/installation.md.
size: wheels
	@$(BIN)/python -m supply.size --wheel $$(ls dist/decklander-*_$$(uname -m).whl)

# Each package on its own booted Debian: install, update, return, remove; and a card. As root, with debootstrap and a mirror in reach.
test-install: deb
	for system in debian12 debian13; do \
	  $(BIN)/python -m qualification.packaging.boot --system $$system $(if $(WORK),--work $(WORK)/$$system) \
	    --deb dist/decklander_*$$system\_$$(dpkg --print-architecture).deb || exit 1; done
	$(BIN)/python -m qualification.packaging.card --system debian13 $(if $(WORK),--work $(WORK)/card) \
	  --deb dist/decklander_*debian13_$$(dpkg --print-architecture).deb

# What git's tags and commits make of the version; the image's build is given it.
version: $(VENV)/.runtime
	@$(BIN)/python -m hatchling version

# Debian packages that carry every wheel, in dist/: make deb, or make deb SYSTEM=debian13 ARCHITECTURE=aarch64. WHEELS=DIR fetches nothing.
deb: $(VENV)/.supply $(VENV)/.compiler
	SOURCE_DATE_EPOCH=$${SOURCE_DATE_EPOCH:-$$(git log -1 --format=%ct)} \
	  $(BIN)/python -m supply.deb $(if $(SYSTEM),--system $(SYSTEM)) $(if $(ARCHITECTURE),--architecture $(ARCHITECTURE)) $(if $(WHEELS),--wheels $(WHEELS))

# Everything that a release hands out, in dist/, the same bytes from the same commit: wheels, source, Debian package, site,
# bills of materials, and their checksums. The image is built from the Dockerfile of the source archive.
release: export SOURCE_DATE_EPOCH := $(shell git log -1 --format=%ct)
release: emptied wheels deb sbom docs
	tar --sort=name --mtime=@$(SOURCE_DATE_EPOCH) --owner=0 --group=0 --numeric-owner -cf - site | gzip -n9 > dist/decklander-site.tar.gz
	cd dist && sha256sum *.whl *.tar.gz *.deb *.json > SHA256SUMS && sha256sum --check --quiet SHA256SUMS
	@$(BIN)/python -m supply.release || true

# A version of another commit in dist/ would be handed out too.
emptied:
	rm -rf dist

# The V4L2 driver on the kernel's own test camera, in a virtual machine by software emulation.
test-v4l2: $(VENV)/.dev $(CORE)
	@$(BIN)/python -c 'import sys; from qualification.v4l2_vm.machine import missing; sys.exit(missing())'
	$(BIN)/pytest qualification/v4l2_vm

# The images' own steps without an engine, up to a landing in them. As root, with debootstrap and a Debian mirror in reach.
test-image: $(VENV)/.dev $(CORE)
	$(BIN)/python -m qualification.packaging.image

lint: $(VENV)/.dev $(CORE)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

# What `make bench` gives the dear ones, so that all of them end within the hour; LONG=1 leaves it out.
SHORT_by_person := --runs 1 --speeds 1.5 --heights 3
SHORT_calibration := --sets 6
SHORT_chaos := --flights 4
SHORT_clear_deck := --runs 6 --clear 6
SHORT_estimator := --runs 1
SHORT_false_pads := --frames 200
SHORT_figures := docs/pads.md
SHORT_hands := --runs 1 --state ours landing
SHORT_killed := --perception model
SHORT_landings := --runs 1 --scenarios weather_2 weather_4
SHORT_real := --every 4
SHORT_search := --frames 4
SHORT_ship_sensors := --runs 1 --scenarios weather_3
SHORT_soak := --virtual --runs 12
SHORT_verification_fit := --frames 200
SHORT_vision := --frames 5

# Each bench to its end; those that fell short or broke are named at the end and make it red. ONLY="cost latency" for some.
bench: $(VENV)/.dev $(CORE)
	@failed=; $(foreach bench,$(if $(ONLY),$(addprefix benches.,$(ONLY)),$(subst /,.,$(BENCHES))),echo "== $(bench)"; \
	  $(BIN)/python -m $(bench) $(if $(LONG),,$(SHORT_$(patsubst benches.%,%,$(bench)))) || failed="$$failed $(bench) ($$?)";) \
	  [ -z "$$failed" ] || { echo "fell short or broke (exit code):$$failed" >&2; exit 1; }

# The documentation as a site in site/; a broken link, a page outside the navigation, or a search that misses its page fails it. A preview while writing: .venv/bin/mkdocs serve.
docs: $(VENV)/.docs
	$(BIN)/mkdocs build --quiet
	$(BIN)/pytest tests/docs/test_search.py

# Every parser, and every entry of the core where there is clang, against bytes of a fuzzer's making: make fuzz SECONDS=60, or HOURS=8, CPU=1 for CPU time. ONLY="pave at" for some targets, JOBS=1 for one core.
fuzz: $(VENV)/.fuzz $(CORE)
	$(BIN)/python -m fuzz $(if $(HOURS),--hours $(HOURS)) $(if $(SECONDS),--seconds $(SECONDS)) $(if $(JOBS),--jobs $(JOBS)) $(if $(CPU),--cpu) $(if $(ONLY),--only $(ONLY))

# Filter, vision, guidance and command streamers changed in one place at a time: how many of the changes do the tests notice? SHARE=0.1 for a sample.
mutants: $(VENV)/.dev $(CORE)
	$(BIN)/python -m mutants $(if $(SHARE),--share $(SHARE)) $(if $(SEED),--seed $(SEED)) $(if $(ONLY),--only $(ONLY))

# What is shipped: bills of materials (CycloneDX JSON) of an environment with every extra and of the pins, licences, known weaknesses.
# OSV=URL asks a server of the OSV interface for these in place of PyPI; STRICT=1 fails where none can be asked.
sbom: $(VENV)/.supply $(VENV)/shipped
	@mkdir -p dist
	$(BIN)/cyclonedx-py environment --pyproject pyproject.toml --output-reproducible -o dist/decklander.cdx.json $(VENV)/shipped
	$(BIN)/cyclonedx-py requirements --pyproject pyproject.toml --output-reproducible -o dist/decklander.pins.cdx.json requirements/video.txt

licences: $(VENV)/.dev
	sh supply/licences.sh $(BIN)/python > docs/licences.md.new && mv docs/licences.md.new docs/licences.md

audit: $(VENV)/.supply
	@sh supply/audit.sh $(BIN)/pip-audit $(if $(OSV),--vulnerability-service osv --osv-url $(OSV)) $(if $(STRICT),--strict)

# .github and CITATION.cff by their schemas, and the workflows by zizmor's rules; nothing is fetched for it.
workflows: $(VENV)/.workflows
	$(BIN)/check-jsonschema --builtin-schema vendor.github-workflows .github/workflows/*.yml
	$(BIN)/check-jsonschema --builtin-schema vendor.github-issue-forms .github/ISSUE_TEMPLATE/[!c]*.yml
	$(BIN)/check-jsonschema --builtin-schema vendor.github-issue-config .github/ISSUE_TEMPLATE/config.yml
	$(BIN)/check-jsonschema --builtin-schema vendor.dependabot .github/dependabot.yml
	$(BIN)/check-jsonschema --builtin-schema vendor.citation-file-format CITATION.cff
	$(BIN)/zizmor --quiet --offline --config .github/zizmor.yml .github

# The service with H.264, which the demo's simulated AR.Drone films in.
$(VENV)/.runtime: pyproject.toml requirements/build.txt requirements/video.txt | $(BIN)/pip
	$(INSTALL) requirements/build.txt requirements/video.txt
	$(PIP) install --no-deps --no-build-isolation --editable .
	@touch $@

# zig's compiler, which builds for other machines and where there is no `cc`.
$(VENV)/.compiler: requirements/compiler.txt | $(BIN)/pip
	$(INSTALL) requirements/compiler.txt
	@touch $@

# With the witnesses of benches/witness, which the tests ask too.
$(VENV)/.dev: requirements/dev.txt requirements/witness.txt requirements/rotorpy.txt $(VENV)/.runtime
	$(INSTALL) requirements/dev.txt requirements/witness.txt requirements/rotorpy.txt
	@touch $@

$(VENV)/.fuzz: requirements/fuzz.txt $(VENV)/.dev
	@$(BIN)/python -c 'import sys, platform as p; sys.exit(not ((3, 11) <= sys.version_info < (3, 14) and p.machine() == "x86_64" and p.system() == "Linux"))' || \
	  { echo "atheris, the fuzzer, has wheels for Python 3.11 to 3.13 on x86-64 Linux, and this is another; see 'make PYTHON=...'" >&2; exit 1; }
	$(INSTALL) requirements/fuzz.txt
	@touch $@

$(VENV)/.docs: requirements/docs.txt $(VENV)/.dev
	$(INSTALL) requirements/docs.txt
	@touch $@

$(VENV)/.workflows: requirements/workflows.txt | $(BIN)/pip
	$(INSTALL) requirements/workflows.txt
	@touch $@

$(VENV)/.supply: requirements/supply.txt $(VENV)/.runtime
	$(INSTALL) requirements/supply.txt
	@touch $@

# An environment with the service's needs and every extra's, and nothing else.
$(VENV)/shipped: requirements/runtime.txt requirements/report.txt requirements/lab.txt requirements/ros2.txt requirements/compare.txt requirements/rl.txt requirements/fleet.txt requirements/ship.txt requirements/video.txt | $(BIN)/python
	$(BIN)/python -m venv --clear --without-pip $@
	$(PIP) --python $@ install --require-hashes $(foreach pins,$^,-r $(pins))
	@touch $@

$(BIN)/python:
	@command -v $(PYTHON) >/dev/null || { echo "Decklander needs Python 3.11 or newer, and there is no $(PYTHON) here; see 'make PYTHON=...'" >&2; exit 1; }
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo "Decklander needs Python 3.11 or newer, and $(PYTHON) is older; say which to use: make PYTHON=python3.11" >&2; exit 1; }
	@$(PYTHON) -c 'import ensurepip, venv' 2>/dev/null || \
	  { echo "$(PYTHON) cannot make virtual environments; on Debian: apt install python3-venv" >&2; exit 1; }
	@echo "making $(VENV) (once)"
	@$(PYTHON) -m venv --without-pip $(VENV)

$(BIN)/pip: | $(BIN)/python
	@$(BIN)/python -m ensurepip --upgrade --default-pip >/dev/null

# Pins every dependency again, by name, version and hash, for all platforms. Needs pip-tools (pipx install pip-tools).
PIN := pip-compile --quiet --upgrade --generate-hashes --allow-unsafe --strip-extras --no-annotate --no-header --no-config --no-emit-options
# The extras that every file of pins holds: images, the Debian package and `make` install them.
SMALL := --extra service --extra mqtt --extra nmea --extra logs --extra pads
pins:
	$(PIN) --only-build-deps --build-deps-for=editable -o requirements/build.txt pyproject.toml
	$(PIN) --constraint requirements/build.txt $(SMALL) -o requirements/runtime.txt pyproject.toml
	$(PIN) --constraint requirements/runtime.txt $(SMALL) --extra video -o requirements/video.txt pyproject.toml
	$(PIN) --constraint requirements/build.txt --constraint requirements/runtime.txt $(SMALL) --extra ship -o requirements/ship.txt pyproject.toml
	$(PIN) --constraint requirements/ship.txt $(SMALL) --extra fleet -o requirements/fleet.txt pyproject.toml
	$(PIN) --constraint requirements/fleet.txt $(SMALL) --extra report -o requirements/report.txt pyproject.toml
	$(PIN) --constraint requirements/report.txt $(SMALL) --extra lab -o requirements/lab.txt pyproject.toml
	$(PIN) --constraint requirements/lab.txt $(SMALL) --extra ros2 -o requirements/ros2.txt pyproject.toml
	$(PIN) --constraint requirements/lab.txt $(SMALL) --extra compare -o requirements/compare.txt pyproject.toml
	$(PIN) --constraint requirements/lab.txt $(SMALL) --extra rl -o requirements/rl.txt pyproject.toml
	$(PIN) --constraint requirements/lab.txt $(SMALL) --extra witness -o requirements/witness.txt pyproject.toml
	awk 'NR == FNR { of_lab[$$1] = 1; next } /^[^ ]/ { added = !($$1 in of_lab) } added' requirements/lab.txt requirements/witness.txt > requirements/witness.new
	mv requirements/witness.new requirements/witness.txt
	$(PIN) -o requirements/rotorpy.new requirements/rotorpy.in
	awk '/^[^ ]/ { own = /^rotorpy==/ } own' requirements/rotorpy.new > requirements/rotorpy.txt
	rm requirements/rotorpy.new
	$(PIN) --constraint requirements/build.txt --constraint requirements/report.txt --constraint requirements/lab.txt --constraint requirements/ros2.txt --constraint requirements/compare.txt --constraint requirements/rl.txt --constraint requirements/fleet.txt --constraint requirements/ship.txt --constraint requirements/video.txt --extra all --extra dev -o requirements/dev.txt pyproject.toml
	$(PIN) -o requirements/fuzz.txt requirements/fuzz.in
	$(PIN) --constraint requirements/dev.txt -o requirements/supply.txt requirements/supply.in
	$(PIN) --constraint requirements/dev.txt -o requirements/workflows.txt requirements/workflows.in
	$(PIN) --constraint requirements/dev.txt -o requirements/docs.txt requirements/docs.in
	$(PIN) -o requirements/compiler.txt requirements/compiler.in
