"""Define the wrappers: messages that combine a part of a .srv or .action with the number of its call or goal.

A request needs no wrapper, because the number of its sample identifies the call. docs/protocol.md describes the use of
wrappers in "Services" and "Actions".
"""

from __future__ import annotations

from shmgen.core.diagnostics import Span
from shmgen.core.model import Constant, Field, FieldType, Message, Ref, Scalar, TypeName, ros_type

WRAPPERS = {"msg": (), "srv": ("_Reply",), "action": ("_Command", "_Progress", "_Outcome")}
"""Kind of file -> the endings of its wrappers' names."""


def wrappers(definition: TypeName, path: str, origin: str) -> tuple[Message, ...]:
    """Return the wrappers for a service or an action, such as std_srvs/srv/SetBool. A message has none.

    Diagnostics print `path`.
    """
    place = Span(path)
    if definition.kind == "srv":
        return (_reply(definition, place, origin),)
    if definition.kind == "action":
        return tuple(make(definition, place, origin) for make in (_command, _progress, _outcome))
    return ()


def _reply(service: TypeName, place: Span, origin: str) -> Message:
    fields = (
        _field("call", Scalar.UINT32, place, "number of the answered request"),
        _field("status", Scalar.UINT8, place, "DONE or FAILED"),
        _part(service, "response", place, "not valid if status is FAILED"),
    )
    constants = (_constant("DONE", Scalar.UINT8, 1, place), _constant("FAILED", Scalar.UINT8, 2, place))
    return _message(service, "_Reply", f"Reply to a call of {service.short}.", fields, constants, place, origin)


def _command(action: TypeName, place: Span, origin: str) -> Message:
    fields = (
        _field("cancel", Scalar.UINT32, place, "number of the goal to cancel; 0 = this message is a new goal"),
        _part(
            action,
            "goal",
            place,
            "not valid in a request to cancel; the number of its sample is the number of the goal",
        ),
    )
    return _message(
        action, "_Command", f"A goal of {action.short}, or a request to cancel one.", fields, (), place, origin
    )


def _progress(action: TypeName, place: Span, origin: str) -> Message:
    fields = (
        _field("goal", Scalar.UINT32, place, "number of the goal"),
        _field("status", Scalar.INT8, place, "ACCEPTED, EXECUTING or CANCELING"),
        _part(action, "feedback", place, "not valid if status is ACCEPTED"),
    )
    # The numbers come from action_msgs/msg/GoalStatus, as in _outcome. Only REJECTED has no number there.
    statuses = {"ACCEPTED": 1, "EXECUTING": 2, "CANCELING": 3}
    constants = tuple(_constant(name, Scalar.INT8, value, place) for name, value in statuses.items())
    return _message(action, "_Progress", f"Progress of a goal of {action.short}.", fields, constants, place, origin)


def _outcome(action: TypeName, place: Span, origin: str) -> Message:
    fields = (
        _field("goal", Scalar.UINT32, place, "number of the goal that has ended"),
        _field("status", Scalar.INT8, place, "SUCCEEDED, CANCELED, ABORTED or REJECTED"),
        _part(action, "result", place, "not valid if status is REJECTED"),
    )
    statuses = {"SUCCEEDED": 4, "CANCELED": 5, "ABORTED": 6, "REJECTED": -1}
    constants = tuple(_constant(name, Scalar.INT8, value, place) for name, value in statuses.items())
    return _message(action, "_Outcome", f"Outcome of a goal of {action.short}.", fields, constants, place, origin)


def _field(name: str, type: FieldType, place: Span, doc: str) -> Field:
    return Field(name, type, ros_type(type), place, doc)


def _part(definition: TypeName, name: str, place: Span, doc: str) -> Field:
    """Return a wrapper's field that contains a part of the definition: `response` contains SetBool_Response."""
    return _field(name, Ref(definition.part(f"_{name.capitalize()}")), place, doc)


def _constant(name: str, type: Scalar, value: int, place: Span) -> Constant:
    return Constant(name, type, value, place)


def _message(
    definition: TypeName,
    ending: str,
    doc: str,
    fields: tuple[Field, ...],
    constants: tuple[Constant, ...],
    place: Span,
    origin: str,
) -> Message:
    lines = [f"{constant.type.value} {constant.name}={constant.value}" for constant in constants]  # type: ignore[union-attr]
    lines += [f"{field.written} {field.name}" for field in fields]
    return Message(definition.part(ending), fields, constants, place, origin, "\n".join(lines), doc)
