# Reel's few verbs. Build output goes to one place outside the checkout, so that clones and worktrees share it.
export CARGO_TARGET_DIR ?= $(HOME)/.cache/reel
# Arguments for the test programs, e.g. `make test TEST_ARGS=--show-output`.
TEST_ARGS ?=
# Arguments for the benches, e.g. `make bench BENCH_ARGS=render`.
BENCH_ARGS ?=
# The simulated service: built with a clock that can be held, and without tables, beside everything else.
SIMULATE = cargo test --locked -p reel-server --no-default-features --features simulation --test simulate

.PHONY: help demo test test-long pages web test-web wheel test-python perf bench fuzz bench-sql bench-ingest bench-export bench-taxonomy bench-pages bench-proxy proxy scale cluster screenshots viewers eval-tasks eval-taxonomy eval-blame eval-preferences eval-insight eval-attribution eval-skills load prove-sft prove-loop eval-learned hostile-sql simulate kills agreement conformance service real-contract docs lint supply-chain reproducible release acceptance determinism determinism-cross clean
.DEFAULT_GOAL := help

help: ## list these verbs
	@sed -n 's/^\([a-z-]*\):.*## /  make \1\t/p' Makefile | expand -t 26

demo: pages ## build reel; then record, replay, ask, export and draw episodes in demo-out
	@echo "building reel: the first time compiles all its dependencies, about 20 minutes on two cores"
	@start=$$(date +%s); cargo build --locked --workspace --bin reel && echo "built in $$(($$(date +%s) - start)) s"
	"$(CARGO_TARGET_DIR)/debug/reel" demo --out demo-out

test: pages ## build the tests and install what they compare Reel with, run every test of the workspace, list what was skipped
	@status=0; tests/setup.sh & setup=$$!; web/build.sh --quick & web=$$!; cargo test --locked --workspace --no-run || status=$$?; wait $$setup || status=$$?; wait $$web || status=$$?; exit $$status
	@tests/skips.sh --forget
	@status=0; set -x; cargo test --locked --workspace -- $(TEST_ARGS) && $(SIMULATE) -- $(TEST_ARGS) || status=$$?; tests/skips.sh; exit $$status

test-long: ## `make test` with its long forms: browser tests, clusters, LeRobot, taxonomy (half an hour more)
	REEL_LONG=1 $(MAKE) test

wheel: pages ## build the Python package with the command line as a wheel in python/dist (an optimised build; an hour)
	python/wheel.sh

test-python: ## build the wheel, install it into an empty environment, run all tests of the Python package, PyTorch and trainers included
	python/test.sh

pages: ## build the web pages that `reel serve` shows (needs Node, which it installs where it may)
	dashboards/build.sh

web: ## build the simulator for browsers, and the player around it, into web/dist (needs Node and clang, or root on Debian; ten minutes at first)
	web/build.sh

test-web: ## every golden trace in Node and Chromium, and 500 changed bytes, beside the native build (needs Node, Chromium)
	tests/web/run.sh

perf: ## measure what things cost in the lean release build, as ratios within one run (`reel dev perf`)
	cargo run --locked --release -p reel-cli --no-default-features -- dev perf

bench: ## time single operations: rendering, replay, rewards, parsing (divan; BENCH_ARGS filters)
	cargo bench --locked --profile fast -p reel-cli --no-default-features --bench reel -- $(BENCH_ARGS)

fuzz: ## feed each parser of outside bytes with mutated inputs, FUZZ_S seconds each or FUZZ_TOTAL_S in all (needs nightly Rust)
	tests/fuzz.sh

bench-sql: ## a million synthetic episodes: the same questions to reel and to DuckDB (needs Python; 5 GB)
	tests/bench/sql.sh

bench-ingest: ## the same traces through reel, a Python script and a bare decoding loop (needs Python)
	tests/bench/ingest.sh

bench-export: ## the same training set by reel and by a Python script with mcap and datasets (needs Python)
	tests/bench/export.sh

bench-taxonomy: ## the failure rules over up to a million synthetic episodes
	tests/bench/taxonomy.sh

bench-pages: ## how long the web pages take over 100,000 synthetic episodes, and whether they keep memory (needs Node, Chromium)
	tests/pages/large.sh

bench-proxy: ## what `reel record` adds to a call, beside a direct connection in the same run (needs Python)
	tests/proxy/run.sh bench.py

proxy: ## `reel record` from outside: same bytes, a hundred sessions, kills, full disks, secrets, revisions of MCP, the tables of its traces (needs Python)
	tests/proxy/run.sh proxy.py
	tests/proxy/run.sh revisions.py

screenshots: pages ## every web page in light and dark, on a laptop, a projector and a phone, into screenshots/ (needs Node, Chromium)
	tests/pages/run.sh --screenshots screenshots

viewers: ## traces and recordings through Rerun's own checks (needs Python)
	tests/viewers.sh

eval-taxonomy: ## how often the failure taxonomy is right, on 3,000 episodes with injected faults (ten minutes)
	tests/eval-taxonomy.sh

eval-skills: ## how reliable the skills of --skills real-v1 are, beside the paper's table, over 21 seeds (ten minutes)
	REEL_SKILL_SEEDS=20 cargo test --locked --workspace --test skills -- --nocapture

eval-tasks: ## make 2,000 tasks, check them and annotated ones from outside, let the oracle do them, lay them beside REAL-Bench (needs Python)
	tests/generate/run.sh

eval-attribution: ## whether the intervals of `reel attribute` hold the true share, on injected faults (ten minutes)
	tests/eval-attribution.sh

eval-blame: ## how often the decisive step is right, on 600 episodes with injected faults (ten minutes)
	tests/eval-blame.sh

eval-preferences: ## whether 500 preference pairs choose what is possible, succeeds and asks where asking was missing (ten minutes; needs Python)
	tests/eval-preferences.sh

eval-insight: ## how often taxonomy and blame are right on perturbed competent play whose truth is played out, 1,000 episodes
	tests/eval-insight.sh

scale: ## ten million synthetic episodes: made, compacted, asked; and read by third-party readers (needs Python; 20 GB; an hour)
	tests/bench/scale.sh

cluster: ## scheduler and executors on machines of their own, with a bucket: same answers, node failure, growth (needs Python; half an hour)
	tests/cluster/run.sh

load: ## a thousand agents acting in one server, beside a server that does nothing and a simulator alone (fifteen minutes)
	tests/load.sh

prove-sft: ## train a small language model on an exported set and measure it in a home it never saw (needs Python)
	tests/training/prove-sft.sh

eval-learned: ## play the small learned policy in homes it never saw and write its failures down for blind labels (needs Python)
	tests/training/learned.sh

prove-loop: ## teach a small policy that sees in generated homes, reinforce it, and measure in homes it never saw (needs Python; two to three hours)
	cargo build --locked --workspace --bin reel
	REEL="$(CARGO_TARGET_DIR)/debug/reel" LOOP_DIR="$${LOOP_DIR:-out/loop}" python/loop/prove.sh

agreement: ## every policy and fault with every family, over 2 seeds: one set of numbers in traces, recordings, imports, tables and REST (twenty minutes)
	REEL_SEEDS=2 cargo test --locked --workspace --test cli -- --nocapture one_episode_has_one_set_of_numbers

hostile-sql: ## 2,000 hostile questions in SQL by seeds, over REST: each ends within its limits, and leaves nothing running (an hour)
	REEL_SEEDS=2000 cargo test --locked --workspace --test cli -- --nocapture hostile_questions

simulate: ## `reel serve` in 10,000 worlds with faults of disk, wires and power: what was acknowledged is there (an hour)
	REEL_SEEDS=$${REEL_SEEDS:-10000} $(SIMULATE) -- --nocapture what_was_acknowledged

kills: ## 1,000 kills at random moments of serve, mcp, record, ingest, export and a cluster: nothing acknowledged is lost, no table torn (needs Python; an hour)
	cargo build --locked --workspace --bin reel
	REEL="$(CARGO_TARGET_DIR)/debug/reel" PYTHONDONTWRITEBYTECODE=1 python3 tests/service/kills.py $(KILLS_ARGS)

conformance: ## the published MCP conformance suites against our stack and against `reel serve` (needs npm)
	tests/conformance.sh

service: ## `reel serve` from outside: agents, published texts, leaks, faults, fuzzing (needs Python; twelve minutes)
	tests/service.sh

real-contract: ## hold every answer, payload, reward and file against what REAL's published code computes (needs Python)
	tests/real-contract.sh

docs: ## build the guides as a book in out/book (installs mdbook where it is missing)
	command -v mdbook >/dev/null || cargo install --locked mdbook
	PATH="$$PATH:$$HOME/.cargo/bin" mdbook build
	@# links that leave docs/ lead into the checkout
	sed -i -E 's#href="\.\./#href="@@/#g; s,(href="@@/[^"#]*\.)html,\1md,g; s#"@@/#"../../#g' out/book/*.html

lint: ## check format, lints and documentation
	cargo fmt --all --check
	cargo clippy --locked --workspace --all-targets -- -D warnings
	RUSTDOCFLAGS="-D warnings" cargo doc --locked --workspace --no-deps

supply-chain: ## check dependencies (advisories, licences, duplicates) and list them in out/reel.cdx.json (needs the network, or OFFLINE=1)
	tests/supply-chain.sh

reproducible: ## build the release binary twice, in different folders: the same bytes (FULL=1: the whole binary, hours)
	tests/reproducible.sh

release: ## archive, list of packages, checksums and signature of the whole binary in out/release (needs REEL_SIGNING_KEY, or UNSIGNED=1)
	tests/release.sh

acceptance: ## play all of REAL-Bench, replay it in every build and print figures (needs the data)
	$(MAKE) test-long
	tests/acceptance.sh
	tests/determinism.sh
	tests/eval-taxonomy.sh
	tests/eval-blame.sh
	tests/eval-preferences.sh
	tests/eval-insight.sh
	tests/eval-attribution.sh
	$(MAKE) eval-skills
	$(MAKE) hostile-sql
	$(MAKE) simulate
	$(MAKE) agreement
	$(MAKE) kills
	tests/conformance.sh
	tests/service.sh
	tests/real-contract.sh
	tests/proxy/run.sh proxy.py
	tests/proxy/run.sh revisions.py
	tests/viewers.sh
	tests/pages/large.sh
	tests/web/run.sh
	tests/cluster/run.sh
	FUZZ_TOTAL_S=3600 tests/fuzz.sh

determinism: ## execute the golden traces in every build and condition of this machine: one table
	tests/determinism.sh

determinism-cross: ## the same with other C libraries, compilers and processors (root; at first half an hour)
	tests/determinism-cross.sh

clean: ## remove what was built and written here
	rm -rf demo-out
	cargo clean
