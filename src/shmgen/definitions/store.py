"""The message definitions that come with PyPI's rosbags.

Importing a store of rosbags takes longer than all the rest of a run, so its texts are kept in the user's cache folder.
"""

from __future__ import annotations

import functools
import json
import os
import zlib
from importlib import import_module
from importlib.machinery import PathFinder
from pathlib import Path
from typing import Any, cast

from shmgen.core import cache
from shmgen.core.model import TypeName
from shmgen.definitions.catalogue import Catalogue, Definition, package_of
from shmgen.definitions.tokens import Dialect

ROS1 = frozenset({"noetic"})


def names() -> tuple[str, ...]:
    """`jazzy`, `humble`, `noetic` and whatever else the installed rosbags brings."""
    stores = (file.stem for file in _files() if file.name.startswith(("ros1_", "ros2_")))
    return tuple(sorted(store.partition("_")[2] for store in stores))


def dialect(source: str) -> Dialect:
    """How the definitions of a distribution, and those beside it, are written."""
    return "ros1" if source in ROS1 else "ros2"


def catalogue(source: str) -> Catalogue:
    """All of the store called `source`, one of names()."""
    packages: dict[str, list[Definition]] = {}
    for full_name, text in {**_texts(source), **_SERVICES}.items():
        name = TypeName(*full_name.split("/"))
        definition = Definition(name, f"{source}:{full_name}.{name.kind}", f"built-in store {source}", text)
        packages.setdefault(name.package, []).append(definition)
    place = f"built-in store {source}"
    return {name: (package_of(name, place, definitions),) for name, definitions in packages.items()}


# rosbags.interfaces.Nodetype, by value: importing the enumeration costs as much as reading the cache.
_BASE, _NAME, _ARRAY, _SEQUENCE = 1, 2, 3, 4
_ANSWER = "bool success\nstring message\n"
_SERVICES = {
    "std_srvs/srv/Empty": "---\n",
    "std_srvs/srv/SetBool": f"bool data\n---\n{_ANSWER}",
    "std_srvs/srv/Trigger": f"---\n{_ANSWER}",
}
"""The services of every ROS, which rosbags leaves out; they are the same in all distributions."""
_FILLER = "structure_needs_at_least_one_member"
"""How rosidl, and rosbags after it, writes a message without fields."""
_QUATERNION = "float64 x 0\nfloat64 y 0\nfloat64 z 0\nfloat64 w 1\n"
"""With the defaults of common_interfaces, which rosbags drops: all zeros is no rotation."""


def _texts(source: str) -> dict[str, str]:
    """Full name -> .msg text, from the cache if it holds exactly what the installed rosbags would give."""
    kept = _cache_name(source)
    texts = _cached(kept)
    if texts is None:
        module = f"ros{dialect(source)[-1]}_{source}"
        definitions = import_module(f"rosbags.typesys.stores.{module}").FIELDDEFS
        texts = {name: _text(name, definitions[name], source) for name in sorted(definitions)}
        cache.write(kept, json.dumps(texts).encode())
    return texts


def _text(name: str, definition: Any, source: str) -> str:
    if name == "geometry_msgs/msg/Quaternion" and dialect(source) == "ros2":
        return _QUATERNION
    constants, fields = definition
    lines = [f"{type} {constant}={_literal(type, value, source)}\n" for constant, type, value in constants]
    lines += [f"{_spelled(type, source)} {field}\n" for field, type in fields if field != _FILLER]
    return "".join(lines)


def _literal(type: str, value: object, source: str) -> str:
    if type not in ("string", "wstring") or dialect(source) == "ros1":
        return str(value)
    return '"' + str(value).replace("\\", "\\\\").replace('"', '\\"') + '"'


def _spelled(type: tuple[int, Any], source: str) -> str:
    node, content = type
    if node == _BASE:
        base, capacity = content
        return f"{base}<={capacity}" if capacity else str(base)
    if node == _NAME:
        name = str(content).replace("/msg/", "/")
        clock = name.removeprefix("builtin_interfaces/").lower()
        return clock if dialect(source) == "ros1" and clock in ("time", "duration") else name
    element, length = content
    if node == _ARRAY:
        return f"{_spelled(element, source)}[{length}]"
    assert node == _SEQUENCE, node
    return f"{_spelled(element, source)}[{f'<={length}' if length else ''}]"


@functools.cache
def _files() -> tuple[Path, ...]:
    """What rosbags keeps its stores in, found without importing it."""
    spec = PathFinder.find_spec("rosbags")
    roots = spec.submodule_search_locations if spec else None
    folders = [os.path.join(root, "typesys", "stores") for root in roots or ()]
    return tuple(
        Path(folder, name) for folder in folders for name in sorted(os.listdir(folder)) if name.endswith(".py")
    )


def _cache_name(source: str) -> str:
    """After what its content follows from: the files of rosbags' stores, and this one."""
    files = [Path(__file__), *_files()]
    state = [(str(file), status.st_size, status.st_mtime_ns) for file in files for status in [file.stat()]]
    return f"{source}-{zlib.crc32(repr(state).encode()):08x}.json"


def _cached(name: str) -> dict[str, str] | None:
    """None if it is not in the cache."""
    kept = cache.read(name)
    return None if kept is None else cast("dict[str, str]", json.loads(kept))
