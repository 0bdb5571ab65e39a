"""Map names to names that Python accepts.

The keywords come from the language reference, section "Keywords". The lists of Python 3.10 to 3.14 are equal.
"""

from __future__ import annotations

from collections.abc import Iterator

from shmgen.core.model import Layout, TypeName
from shmgen.targets.naming import ClaimedName, Names, file_stem, words


def python_member(name: str) -> str:
    """Return a valid Python name for a field or a class: `from` -> `from_`."""
    return name + "_" if name in PYTHON_RESERVED else name


def python_class(name: TypeName) -> str:
    """Return the class name, such as `Pose`. Names that a generated module uses are escaped: `str` -> `str_`."""
    return name.name + "_" if name.name in PYTHON_RESERVED or name.name in PYTHON_USED else name.name


def module(name: TypeName) -> str:
    """Return the module name of a message, such as `_joint_state`."""
    return f"_{file_stem(name)}"


def classes(layout: Layout) -> list[str]:
    """Return the class names of a message: the message and, if requested, its publisher and subscriber."""
    name = python_class(layout.name)
    return [name, f"{name}Publisher", f"{name}Subscriber"] if layout.requested else [name]


def _claims(layout: Layout, root: str) -> Iterator[ClaimedName]:
    package = python_member(layout.name.package)
    space = f"{package}.{layout.name.kind}"
    yield ClaimedName("package", package, owner=layout.name.package)
    for name in classes(layout):
        yield ClaimedName("class", name, space)
    yield ClaimedName("file", f"{module(layout.name)}.py", space)


PYTHON_RESERVED = words("""
    False None True and as assert async await break class continue def del elif else except finally for from global
    if import in is lambda nonlocal not or pass raise return try while with yield
    __debug__ self
""")
"""The names to escape. `self` is included, because a generated method takes fields as keyword arguments."""

PYTHON_USED = words("""
    bool float int runtime str typing
""")
"""The builtins and modules that a generated module uses by name."""

NAMES = Names("Python", member=python_member, constant=python_member, claims=_claims)
