"""Define the wrappers: messages that combine a part of a .srv or .action with the number of its call or goal.

A request needs no wrapper, because the number of its sample identifies the call. docs/protocol.md describes the use of
wrappers in "Services" and "Actions".
"""

from __future__ import annotations

from shmgen.core.diagnostics import Span
from shmgen.core.model import Constant, Field, FieldType, Message, Ref, Scalar, ros_type
from shmgen.definitions.catalogue import Definition


def wrappers(definition: Definition) -> tuple[Message, ...]:
    """Return the wrappers for a service or an action, such as std_srvs/srv/SetBool. A message has none."""
    if definition.name.kind == "srv":
        return (_reply(definition),)
    if definition.name.kind == "action":
        return (_command(definition), _progress(definition), _outcome(definition))
    return ()


def _reply(service: Definition) -> Message:
    fields = (
        _field(service, "call", Scalar.UINT32, "number of the answered request"),
        _field(service, "status", Scalar.UINT8, "DONE or FAILED"),
        _part(service, "response", "not valid if status is FAILED"),
    )
    constants = _constants(service, Scalar.UINT8, DONE=1, FAILED=2)
    return _message(service, "_Reply", f"Reply to a call of {service.name.short}.", fields, constants)


def _command(action: Definition) -> Message:
    condition = "not valid in a request to cancel; the number of its sample is the number of the goal"
    fields = (
        _field(action, "cancel", Scalar.UINT32, "number of the goal to cancel; 0 = this message is a new goal"),
        _part(action, "goal", condition),
    )
    return _message(action, "_Command", f"A goal of {action.name.short}, or a request to cancel one.", fields)


def _progress(action: Definition) -> Message:
    fields = (
        _field(action, "goal", Scalar.UINT32, "number of the goal"),
        _field(action, "status", Scalar.INT8, "ACCEPTED, EXECUTING or CANCELING"),
        _part(action, "feedback", "not valid if status is ACCEPTED"),
    )
    # The numbers come from action_msgs/msg/GoalStatus, as in _outcome. Only REJECTED has no number there.
    constants = _constants(action, Scalar.INT8, ACCEPTED=1, EXECUTING=2, CANCELING=3)
    return _message(action, "_Progress", f"Progress of a goal of {action.name.short}.", fields, constants)


def _outcome(action: Definition) -> Message:
    fields = (
        _field(action, "goal", Scalar.UINT32, "number of the goal that has ended"),
        _field(action, "status", Scalar.INT8, "SUCCEEDED, CANCELED, ABORTED or REJECTED"),
        _part(action, "result", "not valid if status is REJECTED"),
    )
    constants = _constants(action, Scalar.INT8, SUCCEEDED=4, CANCELED=5, ABORTED=6, REJECTED=-1)
    return _message(action, "_Outcome", f"Outcome of a goal of {action.name.short}.", fields, constants)


def _field(definition: Definition, name: str, type: FieldType, doc: str) -> Field:
    return Field(name, type, ros_type(type), Span(definition.path), doc)


def _part(definition: Definition, name: str, doc: str) -> Field:
    """Return the wrapper's field `name`, whose type is a part of the definition: SetBool_Response for `response`."""
    return _field(definition, name, Ref(definition.name.part(f"_{name.capitalize()}")), doc)


def _constants(definition: Definition, type: Scalar, **values: int) -> tuple[Constant, ...]:
    return tuple(Constant(name, type, value, Span(definition.path)) for name, value in values.items())


def _message(
    definition: Definition, ending: str, doc: str, fields: tuple[Field, ...], constants: tuple[Constant, ...] = ()
) -> Message:
    lines = [f"{ros_type(constant.type)} {constant.name}={constant.value}" for constant in constants]
    lines += [f"{field.written} {field.name}" for field in fields]
    name, place, text = definition.name.part(ending), Span(definition.path), "\n".join(lines)
    return Message(name, fields, constants, place, definition.origin, text, doc)
