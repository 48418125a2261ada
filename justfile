# Short names for the commands of README.md, CONTRIBUTING.md and .ci/run, for those who have `just`.
# Nothing exists only here.

# The recipes.
default:
    @just --list --unsorted

# Fetches all sources, so that builds need no network afterwards (but for the console's npm packages).
setup:
    cargo fetch --locked

# A fleet maps a simulated town, another vehicle finds itself in it.
demo *ARGS:
    cargo run --release -- demo {{ ARGS }}

# The tests: unit, integration and documentation tests.
test *ARGS:
    cargo test --workspace {{ ARGS }}

# The tests on recorded drives; ECHOFIX_DATA_DIR names the folder that holds them.
test-data:
    cargo test --workspace -- --ignored --skip power_cut --skip an_operator_works_with_the_console --skip promtool --skip is_caught --skip file_system --skip object_store

# The tests of power cuts and full disks; as root, with loop devices.
test-power:
    cargo test -p echofix-tests --test power_cut --test trouble -- --ignored --test-threads 1

# Formatting, lints, the crates that must build without features, and what is linked (where cargo-deny is installed).
lint:
    cargo fmt --all --check
    cargo clippy --workspace --all-targets -- -D warnings
    cargo check -p echofix-client --no-default-features
    cargo check -p echofix --no-default-features
    @if cargo deny --version >/dev/null 2>&1; then cargo deny --locked check --hide-inclusion-graph bans licenses sources; else echo "NOT RUN: cargo deny is not installed"; fi

# The documentation of all crates, private items included.
doc:
    RUSTDOCFLAGS="-D warnings" cargo doc --workspace --no-deps --document-private-items

# The paper's experiments; `just evaluate --quick` takes minutes, all of them take hours.
evaluate *ARGS:
    cargo run --release -- evaluate {{ ARGS }}

# What a fix costs on this machine; `just bench --quick` only shows that it works.
bench *ARGS:
    cargo run --release -- bench {{ ARGS }}

# All that must hold before a change lands.
ci:
    bash .ci/run

# What is released, into dist/: binary, Debian package, SBOM, image, checksums. What cannot be made is said as NOT MADE.
release *ARGS:
    bash .ci/release {{ ARGS }}
