"""Read definitions with genmsg (ROS 1). This script runs in its own process.

Standard input: [[package, kind, name, text], …]. Standard output: equal to by_rosidl.py, without defaults and units.
This script splits an .action at each line that begins with `---`, like a .srv, because genmsg reads no .action.
"""

from __future__ import annotations

import json
import re
import sys

from genmsg import msg_loader

ENDINGS = {"msg": ("",), "srv": ("_Request", "_Response"), "action": ("_Goal", "_Result", "_Feedback")}


def main() -> None:
    answers: list[object] = []
    for package, kind, name, text in json.load(sys.stdin):
        try:
            answers.append(
                [
                    to_answer(specification, f"{package}/{kind}/{name}{ending}")
                    for specification, ending in zip(
                        load_specifications(package, kind, name, text), ENDINGS[kind], strict=True
                    )
                ]
            )
        except Exception as error:
            answers.append([class_.__name__ for class_ in type(error).__mro__])
    json.dump(answers, sys.stdout)


def load_specifications(package: str, kind: str, name: str, text: str) -> list:
    context, full_name = msg_loader.MsgContext(), f"{package}/{name}"
    if kind == "msg":
        return [msg_loader.load_msg_from_string(context, text, full_name)]
    if kind == "srv":
        service = msg_loader.load_srv_from_string(context, text, full_name)
        return [service.request, service.response]
    parts = re.split(r"^---.*\n", text, flags=re.MULTILINE)
    return [msg_loader.load_msg_from_string(context, part, full_name) for part in parts]


def to_answer(specification: object, name: str) -> list:
    fields = [[name, type_, None, ""] for type_, name in specification.fields()]
    constants = [[constant.name, constant.type, constant.val] for constant in specification.constants]
    return [name, fields, constants]


main()
