# `make demo` and `make test` set up a fresh Debian 12 machine and can be run again.
SUDO := $(shell [ "$$(id -u)" = 0 ] || echo sudo)
PACKAGES := build-essential pkg-config cmake clang libclang-dev libopencv-dev libudev-dev chromium slurm-wlm munge python3-pip
export DEBIAN_FRONTEND := noninteractive

.PHONY: demo test setup check exam peers

setup:
	@missing=""; for p in $(PACKAGES); do dpkg -s $$p >/dev/null 2>&1 || missing="$$missing $$p"; done; \
	if [ -n "$$missing" ]; then $(SUDO) apt-get update -qq && $(SUDO) apt-get install -y -qq --no-install-recommends $$missing >/dev/null; fi
	calib/mujoco/engine/fetch.sh

demo: setup
	cargo build --release --locked --bin wcal
	./target/release/wcal demo --out demo-out

test: setup
	cargo fmt --all --check
	cargo test --workspace --locked

# Lints compile everything a second time: a developer's check, not part of the tests.
check: setup
	cargo fmt --all --check
	cargo clippy --workspace --lib --bins --locked -- -D warnings

exam:
	cargo build --release --locked --bin wcal --example exam
	./target/release/examples/exam --draws 100 --mix all --wcal ./target/release/wcal

# Side by side with scipy, scikit-learn, MuJoCo, cv2, mrcal, PyTorch and the stage maker's client in one run each; prints tables and writes
# peers-*.json. YCB=FOLDER of STL files: also the paper's whole sweep set.
peers: setup
	for p in python3-venv mrcal; do dpkg -s $$p >/dev/null 2>&1 || $(SUDO) apt-get install -y -qq --no-install-recommends $$p >/dev/null; done
	test -x tests/peers/.venv/bin/python || python3 -m venv tests/peers/.venv
	tests/peers/.venv/bin/pip install -q numpy scipy scikit-learn opencv-python-headless pandas pyarrow mujoco==3.17.0
	tests/peers/.venv/bin/python tests/peers/rod_peers.py --json peers-rod.json
	tests/peers/.venv/bin/python tests/peers/map_peers.py --out peers-map.json
	cargo build --release --locked -p wcal-mujoco --example write_mjcf
	tests/peers/.venv/bin/python tests/peers/mujoco_statics.py target/release/examples/write_mjcf --json peers-mujoco.json
	test -x tests/peers/.venv-released/bin/python || python3 -m venv tests/peers/.venv-released
	tests/peers/.venv-released/bin/pip install -q numpy mujoco==3.1.6
	for p in .venv-released .venv; do tests/peers/$$p/bin/python tests/peers/released_labels.py; done
	cargo build --release --locked -p wcal-mujoco -p wcal-mujoco-engine --bin wcal-mujoco --example write_world --example compare_engines
	tests/peers/.venv/bin/python tests/peers/mujoco_rate.py target/release/examples/write_world target/release/wcal-mujoco --json peers-mujoco-rate.json
	target/release/examples/compare_engines target/convex 4
	cargo build --release --locked -p wcal -p wcal-vision --bin wcal --example solve_corners
	tests/peers/.venv/bin/python tests/peers/stereo.py target/release/wcal target/release/examples/solve_corners peers-stereo.json
	tests/peers/.venv/bin/python tests/peers/stereo_bench.py target/release/wcal
	cargo build --release --locked -p wcal-track --example network_time
	python3 tests/peers/network_peers.py target/release/examples/network_time --json peers-network.json
	if [ -n "$(YCB)" ]; then tests/peers/.venv/bin/python tests/peers/ycb_sweeps.py target/release/wcal "$(YCB)" --json peers-sweeps.json; fi
	cargo test --locked -p wcal-drivers --test vendor_client -- --ignored --nocapture
