"""What genmsg (ROS 1) makes of definitions; to be run on its own.

Standard input: [[package, kind, name, text], …]. Standard output: as by_rosidl.py has it, without defaults and units.
genmsg leaves .action to others: those are split here as it splits a .srv, at each line that begins with `---`.
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
                    read(specification, f"{package}/{kind}/{name}{ending}")
                    for specification, ending in zip(
                        specifications(package, kind, name, text), ENDINGS[kind], strict=True
                    )
                ]
            )
        except Exception as error:
            answers.append([class_.__name__ for class_ in type(error).__mro__])
    json.dump(answers, sys.stdout)


def specifications(package: str, kind: str, name: str, text: str) -> list:
    context, full = msg_loader.MsgContext(), f"{package}/{name}"
    if kind == "msg":
        return [msg_loader.load_msg_from_string(context, text, full)]
    if kind == "srv":
        found = msg_loader.load_srv_from_string(context, text, full)
        return [found.request, found.response]
    pieces = re.split(r"^---.*\n", text, flags=re.MULTILINE)
    return [msg_loader.load_msg_from_string(context, piece, full) for piece in pieces]


def read(specification: object, name: str) -> list:
    fields = [[name, type_, None, ""] for type_, name in specification.fields()]
    constants = [[constant.name, constant.type, constant.val] for constant in specification.constants]
    return [name, fields, constants]


main()
