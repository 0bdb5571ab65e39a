"""Finds the Python classes of ROS 1 types, or generates them without catkin. genmsg computes all md5 sums."""

from __future__ import annotations

import struct
from types import SimpleNamespace
from typing import Any

import genmsg
import genpy
from genmsg.gentools import compute_md5
from genpy.dynamic import generate_dynamic

from shmgen.bridge.backend import ServiceWire
from shmgen.core.model import Message

_U32 = struct.Struct("<I")
_RULE = "\n" + "=" * 80 + "\n"
"""Separator between the definitions in a connection header and in a bag."""


def message(messages: tuple[Message, ...]) -> Any:
    """Return the installed or generated class of the last of `messages`. Raises ValueError if generating it fails."""
    type_name = messages[-1].name.short
    return genpy.message.get_message_class(type_name) or _generate_class(type_name, messages)


def raw(kind: Any) -> Any:
    """Return a class that rospy accepts in place of `kind`. Its objects hold the serialized message as `data`."""

    class Raw(kind):  # type: ignore[misc]
        __slots__ = ("data", "frame_id", "seq")

        def __init__(self, data: bytes = b"") -> None:
            self.data, self.frame_id = data, ""

        @property
        def header(self) -> Raw:
            """The object itself, so that rospy stores `header.seq` in the attribute `seq` of this object."""
            return self

        def deserialize(self, data: bytes) -> Raw:
            self.data = data
            return self

        def serialize(self, into: Any) -> None:
            into.write(_U32.pack(self.seq) + self.data[4:] if kind._has_header else self.data)

    return Raw


def means(kind: Any, messages: tuple[Message, ...]) -> bool:
    """Return True if the ROS class `kind` has the same definition, by md5 sum, as the last of `messages`."""
    context = genmsg.MsgContext.create_default()
    try:
        specs = [_known(context, message, message.text) for message in messages]
        return bool(compute_md5(context, specs[-1]) == kind._md5sum)
    except (genmsg.InvalidMsgSpec, genmsg.MsgNotFound, KeyError):  # no ROS 1 definition
        return False


def service(wire: ServiceWire) -> Any:
    """Return the installed class of the service, or a generated one. Raises ValueError if genmsg cannot generate it."""
    name = wire.type.short
    if installed := genpy.message.get_service_class(name):
        return installed
    request, response = (
        _generate_class(f"{name}{half}", messages)
        for half, messages in (("Request", wire.request), ("Response", wire.response))
    )
    return SimpleNamespace(
        _type=name, _md5sum=_service_md5(wire), _request_class=request, _response_class=response, __name__=name
    )


def _generate_class(name: str, messages: tuple[Message, ...]) -> Any:
    *dependencies, own = messages
    text = _RULE.join([own.text, *(f"MSG: {message.name.short}\n{_definition(message)}" for message in dependencies)])
    try:
        return generate_dynamic(name, text)[name]
    except (genmsg.InvalidMsgSpec, genmsg.MsgNotFound, genpy.MessageException, KeyError) as error:
        raise _unreadable(own, error) from None


def _definition(message: Message) -> str:
    """Return the definition installed with ROS 1, whose Header has the field `seq`, or else the text of `message`."""
    installed = genpy.message.get_message_class(message.name.short)
    return str(installed._full_text.partition(_RULE)[0]) if installed else message.text


def _service_md5(wire: ServiceWire) -> str:
    context = genmsg.MsgContext.create_default()
    for message in (*wire.request[:-1], *wire.response[:-1]):
        _known(context, message, _definition(message))
    text = f"{wire.request[-1].text}\n---\n{wire.response[-1].text}"
    return str(compute_md5(context, genmsg.msg_loader.load_srv_from_string(context, text, wire.type.short)))


def _known(context: Any, message: Message, text: str) -> Any:
    """Parse `text`, the definition of `message`, and register it in `context`, where genmsg finds nested messages."""
    name = message.name.short
    spec = genmsg.msg_loader.load_msg_from_string(context, text, name)
    context.register(name, spec)
    return spec


def _unreadable(message: Message, error: Exception) -> ValueError:
    hint = 'remove bounds, defaults and wstring, which ROS 1 does not have, and set source = "noetic" in shmgen.toml'
    return ValueError(
        f"{message.name.short}: ROS 1 cannot read {message.origin}: {error or type(error).__name__}\n  hint: {hint}"
    )
