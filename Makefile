# `make demo` and `make test` set up a fresh Debian 12 machine and can be run again.
SUDO := $(shell [ "$$(id -u)" = 0 ] || echo sudo)
PACKAGES := build-essential pkg-config cmake clang libclang-dev libopencv-dev libudev-dev chromium slurm-wlm munge python3-pip
export DEBIAN_FRONTEND := noninteractive

.PHONY: demo test setup check exam peers

setup:
	@missing=""; for p in $(PACKAGES); do dpkg -s $$p >/dev/null 2>&1 || missing="$$missing $$p"; done; \
	if [ -n "$$missing" ]; then $(SUDO) apt-get update -qq && $(SUDO) apt-get install -y -qq --no-install-recommends $$missing >/dev/null; fi
	calib/mujoco/engine/fetch.sh

# With the engine beside it, so that `wcal twin --engine mujoco` works afterwards.
demo: setup
	cargo build --release --locked -p wcal -p wcal-mujoco-engine --bin wcal --bin wcal-mujoco
	./target/release/wcal demo --out demo-out

test: setup
	cargo fmt --all --check
	cargo test --workspace --locked

# Every target of every package. Nothing is generated or linked, but third-party code is checked once more: what tests build cannot be used.
check: setup
	cargo clippy --workspace --all-targets --locked -- -D warnings

exam:
	cargo build --release --locked --bin wcal --example exam
	./target/release/examples/exam --draws 100 --mix all --wcal ./target/release/wcal

# Side by side with scipy, scikit-learn, MuJoCo, cv2, mrcal, PyTorch and the stage maker's client in one run each; prints tables and writes
# peers-*.json. One that fails does not stop the others: its JSON and the exit status say so. YCB=FOLDER of STL files: also the paper's whole
# sweep set. PEERS="rod map": these alone.
peers: setup
	dpkg -s python3-venv >/dev/null 2>&1 || $(SUDO) apt-get install -y -qq --no-install-recommends python3-venv >/dev/null
	dpkg -s mrcal >/dev/null 2>&1 || $(SUDO) apt-get install -y -qq --no-install-recommends mrcal >/dev/null || echo "peers: without mrcal"
	test -x tests/peers/.venv/bin/python || python3 -m venv tests/peers/.venv
	tests/peers/.venv/bin/pip install -q numpy scipy scikit-learn opencv-python-headless pandas pyarrow mujoco==3.17.0
	python3 tests/peers/run_all.py $(if $(YCB),--ycb "$(YCB)") $(PEERS)
