"""Makes classes of what every run loads: what `dataclasses.dataclass` makes, for a fifth of what that takes.

A short run is mostly Python loading modules, and of ours the longest was `dataclass`: it writes six methods of each
class as text and has them compiled. Here that is one, `__init__`, and the others are shared. To whoever checks types
it is the standard library's; `replace`, `fields` and `asdict` of that take these classes too.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from operator import attrgetter
from typing import TYPE_CHECKING, Any, TypeVar

if TYPE_CHECKING:
    from dataclasses import dataclass as dataclass

T = TypeVar("T")

_MISSING = dataclasses.MISSING


def _dataclass(*, slots: bool, frozen: bool = False) -> Callable[[type[T]], type[T]]:
    """With slots, without a base class. Of a field count `default`, `default_factory`, `compare`, `hash` and `repr`."""
    assert slots
    return lambda cls: _made(cls, frozen)


if not TYPE_CHECKING:
    dataclass = _dataclass if hasattr(dataclasses, "_FIELD") else dataclasses.dataclass


def _made(cls: type[T], frozen: bool) -> type[T]:
    fields = {name: _field(name, cls) for name in cls.__annotations__}
    body = {name: value for name, value in vars(cls).items() if name not in (*fields, "__dict__", "__weakref__")}
    body |= _FROZEN if frozen else {"__hash__": None}
    body |= {
        "__qualname__": cls.__qualname__,
        "__slots__": tuple(fields),
        "__match_args__": tuple(fields),
        "__dataclass_fields__": fields,
        "__init__": _init(cls, fields, "_set(self, {0!r}, {1})" if frozen else "self.{0} = {1}"),
        "__repr__": _repr,
        "__eq__": _eq,
        "_compared_": _getter([name for name, field in fields.items() if field.compare]),
    }
    if frozen:
        hashed = [name for name, field in fields.items() if (field.compare if field.hash is None else field.hash)]
        body["_hashed_"] = _getter(hashed)
    made: Any = type(cls)
    return made(cls.__name__, (), body)  # type: ignore[no-any-return]


def _field(name: str, cls: type) -> Any:
    given = vars(cls).get(name, _MISSING)
    made: Any = given if isinstance(given, dataclasses.Field) else dataclasses.field(default=given)
    made.name = name
    made._field_type = dataclasses._FIELD  # type: ignore[attr-defined] # as fields() and asdict() ask
    return made


def _init(cls: type, fields: dict[str, dataclasses.Field[Any]], assign: str) -> Any:
    scope: dict[str, Any] = {"_set": object.__setattr__, "_MISSING": _MISSING}
    parameters, lines = ["self"], []
    for name, field in fields.items():
        value = name
        if field.default_factory is not _MISSING:
            scope[f"_make_{name}"] = field.default_factory
            parameters.append(f"{name}=_MISSING")
            value = f"_make_{name}() if {name} is _MISSING else {name}"
        elif field.default is not _MISSING:
            scope[f"_default_{name}"] = field.default
            parameters.append(f"{name}=_default_{name}")
        else:
            parameters.append(name)
        lines.append(assign.format(name, value))
    exec(f"def __init__({', '.join(parameters)}):\n " + "\n ".join(lines), scope)
    scope["__init__"].__qualname__ = f"{cls.__qualname__}.__init__"
    return scope["__init__"]


def _getter(names: list[str]) -> Callable[[Any], Any]:
    return attrgetter(*names)


def _repr(self: Any) -> str:
    shown = (f"{name}={getattr(self, name)!r}" for name, field in self.__dataclass_fields__.items() if field.repr)
    return f"{type(self).__qualname__}({', '.join(shown)})"


def _eq(self: Any, other: Any) -> Any:
    same = other.__class__ is self.__class__
    return self._compared_(self) == self._compared_(other) if same else NotImplemented


def _hash(self: Any) -> int:
    return hash(self._hashed_(self))


def _refuse(self: Any, name: str, value: Any = None) -> None:
    raise dataclasses.FrozenInstanceError(f"{type(self).__qualname__}.{name} cannot be changed")


def _reduce(self: Any) -> tuple[type, tuple[Any, ...]]:
    """For copies and pickles, which would else set what is frozen."""
    return type(self), tuple(getattr(self, name) for name in self.__slots__)


_FROZEN = {"__setattr__": _refuse, "__delattr__": _refuse, "__hash__": _hash, "__reduce__": _reduce}
