"""Read definitions with rosidl_adapter and rosidl_parser (ROS 2). This script runs in its own process.

Standard input: [[package, kind, name, text], …]; the argument: `adapter`, `parser` or `parser-without-comments`.
Standard output: for each its messages, as MessageInfo in __init__.py, or the names of the exception's classes.
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
        with open(os.devnull, "w") as null, contextlib.redirect_stderr(null):
            try:
                specification = PARSE[kind](package, name, text)
                if reference == "adapter":
                    answers.append([from_adapter(message, kind) for message in parts_of(specification, kind)])
                else:
                    answers.append(convert_through_idl(specification, package, kind, name, reference == "parser"))
            except (Exception, SystemExit) as error:
                answers.append([class_.__name__ for class_ in type(error).__mro__])
    json.dump(answers, sys.stdout)


def parts_of(specification: object, kind: str) -> list:
    return [getattr(specification, part) for part in PARTS[kind]] or [specification]


def from_adapter(message: adapter.MessageSpecification, kind: str) -> list:
    fields = [
        [field.name, str(field.type), field.default_value, field.annotations.get("unit", "")]
        for field in message.fields
    ]
    constants = [[constant.name, constant.type, constant.value] for constant in message.constants]
    return [f"{message.base_type.pkg_name}/{kind}/{message.msg_name}", fields, constants]


def convert_through_idl(specification: object, package: str, kind: str, name: str, with_comments: bool) -> list:
    """Convert to .idl with rosidl_adapter, as a build of ROS does. Comments take nine tenths of the time."""
    for message in parts_of(specification, kind):
        for item in (message, *message.fields, *message.constants):
            if not with_comments:
                item.annotations["comment"] = []
    data = {"pkg_name": package, "relative_input_file": f"{kind}/{name}.{kind}", kind: specification}
    text = evaluate_template(f"{kind}.idl.em", data)
    text = text.encode("iso-8859-1").decode()  # rosidl_adapter writes Latin-1, rosidl_parser reads UTF-8
    (content,) = parser.parse_idl_string(text).get_elements_of_type((idl.Message, idl.Service, idl.Action))
    if isinstance(content, idl.Service):
        return [from_parser(content.request_message), from_parser(content.response_message)]
    return [from_parser(message) for message in parts_of(content, kind)]


def from_parser(message: idl.Message) -> list:
    fields = [
        [member.name, spell_type(member.type), default_value(member), annotation_value(member, "unit", "")]
        for member in message.structure.members
        if member.name != "structure_needs_at_least_one_member"
    ]
    constants = [
        [constant.name, spell_type(constant.type).partition("<=")[0], constant.value] for constant in message.constants
    ]
    return ["/".join(message.structure.namespaced_type.namespaced_name()), fields, constants]


def default_value(member: idl.Member) -> object:
    value = annotation_value(member, "default", None)
    return ast.literal_eval(value) if isinstance(member.type, idl.AbstractNestedType) and value else value


def annotation_value(member: idl.Member, name: str, fallback: object) -> object:
    return member.get_annotation_value(name)["value"] if member.has_annotation(name) else fallback


def spell_type(type_: idl.AbstractType) -> str:
    """Return the spelling of a type in a .msg."""
    if isinstance(type_, idl.Array):
        return f"{spell_type(type_.value_type)}[{type_.size}]"
    if isinstance(type_, idl.BoundedSequence):
        return f"{spell_type(type_.value_type)}[<={type_.maximum_size}]"
    if isinstance(type_, idl.UnboundedSequence):
        return f"{spell_type(type_.value_type)}[]"
    if isinstance(type_, idl.AbstractGenericString):
        word = "wstring" if isinstance(type_, idl.AbstractWString) else "string"
        return f"{word}<={type_.maximum_size}" if type_.has_maximum_size() else word
    if isinstance(type_, idl.NamespacedType):
        return "/".join(type_.namespaced_name())
    words = {"boolean": "bool", "octet": "byte", "float": "float32", "double": "float64"}
    return words.get(type_.typename, type_.typename)


main(sys.argv[1])
