"""Convert folders of .msg, .srv and .action files to .idl with rosidl_adapter. This script runs in its own process.

Arguments: the folder of packages, the folder to write to, and the names of packages. rosidl_adapter prints messages,
and skips the files that it rejects.
"""

from __future__ import annotations

import contextlib
import sys
from pathlib import Path

from rosidl_adapter.action import convert_action_to_idl
from rosidl_adapter.msg import convert_msg_to_idl
from rosidl_adapter.srv import convert_srv_to_idl

CONVERT = {"msg": convert_msg_to_idl, "srv": convert_srv_to_idl, "action": convert_action_to_idl}

source, target = Path(sys.argv[1]), Path(sys.argv[2])
for package in sys.argv[3:]:
    for kind, convert in CONVERT.items():
        for file in sorted((source / package / kind).glob(f"*.{kind}")):
            with contextlib.suppress(Exception):
                convert(source / package, package, Path(kind, file.name), target / package / kind)
