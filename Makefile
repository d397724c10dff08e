# `make demo` and `make test` set up a fresh Debian 12 machine and can be run again.
SUDO := $(shell [ "$$(id -u)" = 0 ] || echo sudo)
# What the program is built from and runs with; what only tests ask for.
PROGRAM_PACKAGES := build-essential pkg-config cmake clang libclang-dev libopencv-dev libudev-dev python3-pip
TEST_PACKAGES := chromium slurm-wlm munge
PACKAGING_PACKAGES := dpkg-dev patchelf
export DEBIAN_FRONTEND := noninteractive

.PHONY: demo test program setup check results exam peers docs package package-test wheel wheel-test

# Installs those of the packages that are missing.
install = @missing=""; for p in $(1); do dpkg -s $$p >/dev/null 2>&1 || missing="$$missing $$p"; done; \
	if [ -n "$$missing" ]; then $(SUDO) apt-get update -qq && $(SUDO) apt-get install -y -qq --no-install-recommends $$missing >/dev/null; fi

program:
	$(call install,$(PROGRAM_PACKAGES))
	calib/mujoco/engine/fetch.sh

setup: program
	$(call install,$(TEST_PACKAGES))

# With the engine beside it, so that `wcal twin --engine mujoco` works afterwards.
demo: program
	cargo build --release --locked -p wcal -p wcal-mujoco-engine --bin wcal --bin wcal-mujoco
	./target/release/wcal demo --out demo-out

# A Debian package and an archive in target/package, of a release build; the second puts it into a clean Debian 12 and uses it there.
package: program
	$(call install,$(PACKAGING_PACKAGES))
	packaging/build.sh

package-test: package
	$(call install,mmdebstrap)
	packaging/test.sh

# Built first, then run side by side (tests/run.sh). Examples are not linked here: `make check` compiles them.
test: setup
	cargo fmt --all --check
	cargo test --workspace --locked --tests --no-run
	tests/run.sh

# Every target of every package. Nothing is generated or linked, but third-party code is checked once more: what tests build cannot be used.
# Licences and sources are a test (tests/contracts/third_party.rs); known vulnerabilities need cargo-deny and its database on the network.
check: program
	cargo clippy --workspace --all-targets --locked -- -D warnings
	@if command -v cargo-deny >/dev/null; then cargo deny --workspace check; else echo "check: cargo-deny is not installed: known vulnerabilities are not checked"; fi

# README's table of results, by running its rows.
results: program
	WCAL_WRITE_DOCS=1 cargo test --workspace --locked --test contracts results::

exam: program
	cargo build --release --locked -p wcal -p wcal-lab --bin wcal --bin wcal-lab
	./target/release/wcal-lab exam --draws 100 --mix all

# Side by side with scipy, scikit-learn, MuJoCo, cv2, mrcal, PyTorch and the stage maker's client in one run each; prints tables and writes
# peers-*.json. One that fails does not stop the others: its JSON and the exit status say so. YCB=FOLDER of STL files: also the paper's whole
# sweep set. PEERS="rod map": these alone.
peers: program
	dpkg -s python3-venv >/dev/null 2>&1 || $(SUDO) apt-get install -y -qq --no-install-recommends python3-venv >/dev/null
	dpkg -s mrcal >/dev/null 2>&1 || $(SUDO) apt-get install -y -qq --no-install-recommends mrcal >/dev/null || echo "peers: without mrcal"
	test -x tests/peers/.venv/bin/python || python3 -m venv tests/peers/.venv
	tests/peers/.venv/bin/pip install -q numpy scipy scikit-learn opencv-python-headless pandas pyarrow mujoco==3.17.0
	python3 tests/peers/run_all.py $(if $(YCB),--ycb "$(YCB)") $(PEERS)

# The Python module as a wheel in target/wheels (python/README.md). PROFILE=dev: built as the tests are, within minutes.
PROFILE := release
PYTHON := target/python-venv/bin/python
wheel: program
	dpkg -s python3-venv >/dev/null 2>&1 || $(SUDO) apt-get install -y -qq --no-install-recommends python3-venv >/dev/null
	test -x $(PYTHON) || python3 -m venv target/python-venv
	$(PYTHON) -m pip install -q 'maturin>=1.9,<2'
	rm -f target/wheels/wcal-*.whl
	CARGO_TARGET_DIR=$(CURDIR)/target $(PYTHON) -m maturin build --locked --profile $(PROFILE) -m python/Cargo.toml --out target/wheels

# Its tests, on the wheel as a user installs it.
wheel-test: wheel
	$(PYTHON) -m pip install -q --force-reinstall --no-deps target/wheels/wcal-*.whl
	$(PYTHON) -m pip install -q pytest pandas numpy nbclient ipykernel
	cd python/tests && $(CURDIR)/$(PYTHON) -m pytest -q

# The pages of docs/ as a book, in target/book; mdBook comes into .mdbook (some minutes, once) where none of this version is there.
MDBOOK_VERSION := 0.5.4
MDBOOK := .mdbook/bin/mdbook
docs:
	@test "$$($(MDBOOK) --version 2>/dev/null)" = "mdbook v$(MDBOOK_VERSION)" || \
	  cargo install mdbook --version $(MDBOOK_VERSION) --locked --no-default-features --features search --root .mdbook
	@mkdir -p target; $(MDBOOK) build docs >target/book.log 2>&1; code=$$?; cat target/book.log; test $$code = 0
	@! grep -qE 'WARN|ERROR' target/book.log
