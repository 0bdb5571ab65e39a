"""What rosidl_adapter and rosidl_parser (ROS 2) make of definitions; to be run on its own.

Standard input: [[package, kind, name, text], …]; the argument: `adapter`, `parser` or `parser-without-comments`.
Standard output: for each either its messages, as `Read` in __init__.py, or the names of the exception's classes.
"""

from __future__ import annotations

import ast
import contextlib
import json
import os
import sys

from rosidl_adapter import parser as adapter
from rosidl_adapter.resource import evaluate_template
from rosidl_parser import definition as idl
from rosidl_parser import parser

PARSE = {
    "msg": adapter.parse_message_string,
    "srv": adapter.parse_service_string,
    "action": adapter.parse_action_string,
}
PARTS = {"msg": (), "srv": ("request", "response"), "action": ("goal", "result", "feedback")}


def main(reference: str) -> None:
    answers: list[object] = []
    for package, kind, name, text in json.load(sys.stdin):
        with open(os.devnull, "w") as nowhere, contextlib.redirect_stderr(nowhere):
            try:
                found = PARSE[kind](package, name, text)
                if reference == "adapter":
                    answers.append([adapted(message, kind) for message in parts(found, kind)])
                else:
                    answers.append(through_idl(found, package, kind, name, reference == "parser"))
            except (Exception, SystemExit) as error:
                answers.append([class_.__name__ for class_ in type(error).__mro__])
    json.dump(answers, sys.stdout)


def parts(found: object, kind: str) -> list:
    return [getattr(found, part) for part in PARTS[kind]] or [found]


def adapted(message: adapter.MessageSpecification, kind: str) -> list:
    fields = [
        [field.name, str(field.type), field.default_value, field.annotations.get("unit", "")]
        for field in message.fields
    ]
    constants = [[constant.name, constant.type, constant.value] for constant in message.constants]
    return [f"{message.base_type.pkg_name}/{kind}/{message.msg_name}", fields, constants]


def through_idl(found: object, package: str, kind: str, name: str, with_comments: bool) -> list:
    """Made into .idl by rosidl_adapter, as a build of ROS does it; comments take nine tenths of the time."""
    for message in parts(found, kind):
        for item in (message, *message.fields, *message.constants):
            if not with_comments:
                item.annotations["comment"] = []
    data = {"pkg_name": package, "relative_input_file": f"{kind}/{name}.{kind}", kind: found}
    text = evaluate_template(f"{kind}.idl.em", data)
    text = text.encode("iso-8859-1").decode()  # so it is written by rosidl_adapter, and so read by rosidl_parser
    (content,) = parser.parse_idl_string(text).get_elements_of_type((idl.Message, idl.Service, idl.Action))
    if isinstance(content, idl.Service):
        return [parsed(content.request_message), parsed(content.response_message)]
    return [parsed(message) for message in parts(content, kind)]


def parsed(message: idl.Message) -> list:
    fields = [
        [member.name, spelled(member.type), default(member), annotation(member, "unit", "")]
        for member in message.structure.members
        if member.name != "structure_needs_at_least_one_member"
    ]
    constants = [
        [constant.name, spelled(constant.type).partition("<=")[0], constant.value] for constant in message.constants
    ]
    return ["/".join(message.structure.namespaced_type.namespaced_name()), fields, constants]


def default(member: idl.Member) -> object:
    value = annotation(member, "default", None)
    return ast.literal_eval(value) if isinstance(member.type, idl.AbstractNestedType) and value else value


def annotation(member: idl.Member, name: str, missing: object) -> object:
    return member.get_annotation_value(name)["value"] if member.has_annotation(name) else missing


def spelled(type_: idl.AbstractType) -> str:
    """As it would stand in a .msg."""
    if isinstance(type_, idl.Array):
        return f"{spelled(type_.value_type)}[{type_.size}]"
    if isinstance(type_, idl.BoundedSequence):
        return f"{spelled(type_.value_type)}[<={type_.maximum_size}]"
    if isinstance(type_, idl.UnboundedSequence):
        return f"{spelled(type_.value_type)}[]"
    if isinstance(type_, idl.AbstractGenericString):
        word = "wstring" if isinstance(type_, idl.AbstractWString) else "string"
        return f"{word}<={type_.maximum_size}" if type_.has_maximum_size() else word
    if isinstance(type_, idl.NamespacedType):
        return "/".join(type_.namespaced_name())
    words = {"boolean": "bool", "octet": "byte", "float": "float32", "double": "float64"}
    return words.get(type_.typename, type_.typename)


main(sys.argv[1])
