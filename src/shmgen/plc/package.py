"""Writes the other files of a package that ROS 2 builds."""

from __future__ import annotations


def manifest(package: str, times: bool) -> str:
    depend = "  <depend>builtin_interfaces</depend>\n" if times else ""
    return f"""<?xml version="1.0"?>
<package format="3">
  <name>{package}</name>
  <version>0.0.0</version>
  <description>Data types of a PLC project</description>
  <maintainer email="nobody@localhost">nobody</maintainer>
  <license>unknown</license>
  <buildtool_depend>ament_cmake</buildtool_depend>
  <buildtool_depend>rosidl_default_generators</buildtool_depend>
{depend}  <exec_depend>rosidl_default_runtime</exec_depend>
  <member_of_group>rosidl_interface_packages</member_of_group>
  <export>
    <build_type>ament_cmake</build_type>
  </export>
</package>
"""


def cmake(package: str, files: list[str], times: bool) -> str:
    listed = "\n".join(f"  {file}" for file in files)
    find, depend = (
        ("find_package(builtin_interfaces REQUIRED)\n", " DEPENDENCIES builtin_interfaces") if times else ("", "")
    )
    return f"""cmake_minimum_required(VERSION 3.8)
project({package})
find_package(ament_cmake REQUIRED)
find_package(rosidl_default_generators REQUIRED)
{find}rosidl_generate_interfaces(${{PROJECT_NAME}}
{listed}
 {depend})
ament_package()
"""
