# `make demo` and `make test` set up a fresh Debian 12 machine and can be run again.
SUDO := $(shell [ "$$(id -u)" = 0 ] || echo sudo)
PACKAGES := build-essential pkg-config cmake clang libclang-dev libopencv-dev libudev-dev chromium
export DEBIAN_FRONTEND := noninteractive

.PHONY: demo test setup check exam

setup:
	@missing=""; for p in $(PACKAGES); do dpkg -s $$p >/dev/null 2>&1 || missing="$$missing $$p"; done; \
	if [ -n "$$missing" ]; then $(SUDO) apt-get update -qq && $(SUDO) apt-get install -y -qq --no-install-recommends $$missing >/dev/null; fi

demo: setup
	cargo build --release --locked --bin wcal
	./target/release/wcal demo --out demo-out

test: setup check
	cargo test --workspace --locked

check:
	cargo fmt --all --check
	cargo clippy --workspace --lib --bins --locked -- -D warnings

exam:
	cargo build --release --locked --bin wcal --example exam
	./target/release/examples/exam --draws 100 --mix all --wcal ./target/release/wcal
