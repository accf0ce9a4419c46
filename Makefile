# make demo    build, bake the Cornell box, say where the pictures are
# make test    the tests of the default build
# make ci      everything that must hold before a change goes in
# make bench   speed: form-factor rays against the ray tracer alone, two threads against one, growth with patches
#
# Each target first looks for what it needs and installs what is missing, where it may (see .ci/need).

SHELL := /bin/bash
.SHELLFLAGS := -euo pipefail -c
.DELETE_ON_ERROR:
.PHONY: demo test ci bench check-bindings needs slurm

export PATH := $(HOME)/.cargo/bin:$(PATH)

needs:
	@.ci/need

# What the tests of farms need; without it they say "skipped".
slurm:
	@.ci/slurm

demo: needs
	cargo build --release
	target/release/luxel bake scenes/cornell.toml -o out/cornell
	@echo
	@echo "The pictures, in $(CURDIR)/out/cornell:"
	@cd out/cornell && ls -1 *.png *.exr *.glb 2>/dev/null | sed 's/^/  /'

test: needs
	cargo test

bench: needs
	cargo bench

# Rewrites the bindings and compares them with those in the repository.
check-bindings: needs
	@.ci/check-bindings

# The builds share the dependencies of one target folder: only the crate itself is compiled once a build.
ci: needs slurm
	cargo fmt --check
	cargo clippy --all-targets -- -D warnings
	cargo clippy --all-targets --no-default-features -- -D warnings
	cargo test
	cargo test --no-default-features
	cargo test --no-default-features --features embree --lib --test backends
	cargo test --no-default-features --features openexr --lib
	RUSTDOCFLAGS="-D warnings" cargo doc --no-deps
	.ci/check-bindings
	.ci/debian13
