"""Names that Python accepts.

The keywords are those of the language reference, section "Keywords" (3.10 to 3.14 agree).
"""

from __future__ import annotations

from collections.abc import Iterator

from shmgen.core.model import Layout, TypeName
from shmgen.targets.naming import ClaimedName, Names, file_stem, words


def python_member(name: str) -> str:
    """A field or a class in Python: `from` -> `from_`."""
    return name + "_" if name in PYTHON_RESERVED else name


def python_class(name: TypeName) -> str:
    """`Pose`; a ROS 1 message `struct` -> `struct_`, because a module refers to Python's own."""
    return name.name + "_" if name.name in PYTHON_RESERVED or name.name in PYTHON_USED else name.name


def module(name: TypeName) -> str:
    """The file of a message, without its ending: `_joint_state`."""
    return f"_{file_stem(name)}"


def classes(layout: Layout) -> list[str]:
    """Those of a message: itself, and what publishes it and subscribes to it where it was asked for."""
    name = python_class(layout.name)
    return [name, f"{name}Publisher", f"{name}Subscriber"] if layout.requested else [name]


def _made(layout: Layout, root: str) -> Iterator[ClaimedName]:
    package = python_member(layout.name.package)
    space = f"{package}.{layout.name.kind}"
    yield ClaimedName("package", package, of=layout.name.package)
    for name in classes(layout):
        yield ClaimedName("class", name, space)
    yield ClaimedName("file", f"{module(layout.name)}.py", space)


PYTHON_RESERVED = words("""
    False None True and as assert async await break class continue def del elif else except finally for from global
    if import in is lambda nonlocal not or pass raise return try while with yield
    __debug__ self
""")
"""`self` too: a generated method takes the fields as keyword arguments beside it."""

PYTHON_USED = words("""
    bool bytearray bytes ctypes float int memoryview runtime staticmethod str struct typing values
""")
"""What a generated module refers to by a bare name."""

PYTHON_STORED = words("""
    _anonymous_ _align_ _as_parameter_ _b_base_ _b_needsfree_ _check_counts _decode _digest_ _encode _fields_
    _layout_ _names_ _objects _pack_ _regions_ _set_defaults _swappedbytes_ _type_name_
""")
"""Attributes that ctypes and the generated classes have for themselves, and that all begin with an underscore."""

NAMES = Names("Python", member=python_member, constant=python_member, made=_made)
