# make demo: the whole pipeline on the demo shot.   make test: the tests.
# make test-long: the demo shot made anew as well.   make bench: the speed of the parts.
# Both install the system packages the build needs where they are missing (Debian, Ubuntu).

.PHONY: demo test test-long bench system clean

# What was built is called by its path: `cargo run` would build the library again, without the examples' needs.
BUILT := $(or $(CARGO_TARGET_DIR),target)/release

demo: system
	cargo build --release --bin platelight --example score_demo
	$(BUILT)/platelight run plates/demo/shot.toml --out out/demo
	$(BUILT)/examples/score_demo out/demo plates/demo

test: system
	cargo test --workspace
	cargo check --no-default-features --all-targets

# Also makes the demo shot anew (plates/demo/README.md says how long that takes): not one byte of it
# may differ. And charts the shots: what auto chooses must be near the best method.
test-long: test
	cargo run --release --quiet --example make_demo -- --out out/demo-anew
	diff -r --exclude=README.md out/demo-anew plates/demo
	cargo test --release --test chart -- --ignored --nocapture

bench: system
	cargo bench

system:
	@tools/install-system.sh

clean:
	cargo clean
	rm -rf out
