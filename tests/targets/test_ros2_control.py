"""Check that the files of target ros2_control are consistent."""

from __future__ import annotations

from pathlib import Path

import pytest
from lxml import etree
from ruamel.yaml import YAML

from shmgen import config
from shmgen.core.diagnostics import Report
from shmgen.generator import pipeline

from ..support.build import put

CONFIG = """path = ["msgs"]
targets = ["ros2_control"]
ros_package = "cell"
[[topics]]
topic = "/command"
type = "cell_msgs/Command"
"""
COMMANDS = {
    "joints": "float64[2] position\nfloat64[2] velocity\n",
    "gpio": "uint8 enable\n",
    "both": "float64[2] position\nfloat64[2] velocity\nuint8[2] mode\nuint8 enable\nbool on\n",
}


@pytest.mark.parametrize("fields", COMMANDS.values(), ids=COMMANDS)
def test_each_command_interface_has_one_controller(fields: str, tmp_path: Path) -> None:
    put({"shmgen.toml": CONFIG, "msgs/cell_msgs/msg/Command.msg": fields}, tmp_path)
    settings = config.load(tmp_path / "shmgen.toml", "shmgen.toml", Report())
    texts = {path.removeprefix("ros2_control/cell/"): text for path, text in pipeline.generate(settings, ()).items()}
    yaml = YAML(typ="safe", pure=True)
    yaml.version = "1.1"  # ROS also reads an unquoted `on` as a bool
    parameters = {name: node["ros__parameters"] for name, node in yaml.load(texts["config/controllers.yaml"]).items()}
    types = {name: it["type"] for name, it in parameters.pop("controller_manager").items() if name != "update_rate"}
    interfaces = []
    for it in parameters.values():
        interfaces += [f"{joint}/{it['interface_name']}" for joint in it.get("joints", ())]
        interfaces += [
            f"{gpio}/{name}" for gpio in it.get("gpios", ()) for name in it["command_interfaces"][gpio]["interfaces"]
        ]
    urdf = etree.fromstring(texts["urdf/plc.ros2_control.xacro"].encode())
    assert sorted(interfaces) == sorted(
        f"{component.get('name')}/{it.get('name')}" for component in urdf.iter("joint", "gpio") for it in component
    )
    assert {*types} == {*parameters, "joint_state_broadcaster"}
    assert all(f'"{name}",' in texts["launch/control.launch.py"] for name in types)
    required = {it.text for it in etree.fromstring(texts["package.xml"].encode()).iter("exec_depend")}
    packages = {"joint_state_broadcaster", "forward_command_controller", "gpio_controllers"}
    assert required & packages == {it.partition("/")[0] for it in types.values()}
