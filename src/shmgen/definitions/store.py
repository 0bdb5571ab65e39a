"""The built-in stores: message definitions of the PyPI package rosbags.

Importing a store of rosbags takes longer than the rest of a run, so the texts are saved in the user's cache folder.
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
from shmgen.core.type_hash import FILLER
from shmgen.definitions.catalogue import Catalogue, Definition, package_of
from shmgen.definitions.tokens import Dialect

ROS1 = frozenset({"noetic"})
preloaded: dict[str, dict[str, str]] = {}
"""Store -> full name -> .msg text. Empty, except in the web page that generates code: a browser has no rosbags."""


def names() -> tuple[str, ...]:
    """Return the names of the stores: `jazzy`, `humble`, `noetic` and the others of the installed rosbags."""
    if preloaded:
        return tuple(sorted(preloaded))
    stores = (file.stem for file in _files() if file.name.startswith(("ros1_", "ros2_")))
    return tuple(sorted(store.partition("_")[2] for store in stores))


def dialect(source: str) -> Dialect:
    """Return the dialect of a distribution, which is also the default for packages in folders."""
    return "ros1" if source in ROS1 else "ros2"


def catalogue(source: str) -> Catalogue:
    """Return all packages of the store called `source`, which is one of names()."""
    packages: dict[str, list[Definition]] = {}
    for full_name, text in {**texts(source), **_SERVICES}.items():
        name = TypeName(*full_name.split("/"))
        definition = Definition(name, f"{source}:{full_name}.{name.kind}", f"built-in store {source}", text)
        packages.setdefault(name.package, []).append(definition)
    place = f"built-in store {source}"
    return {name: (package_of(name, place, definitions),) for name, definitions in packages.items()}


# The values of rosbags.interfaces.Nodetype: importing the enumeration takes as long as reading the cache.
_BASE, _NAME, _ARRAY, _SEQUENCE = 1, 2, 3, 4
_ANSWER = "bool success\nstring message\n"
_SERVICES = {
    "std_srvs/srv/Empty": "---\n",
    "std_srvs/srv/SetBool": f"bool data\n---\n{_ANSWER}",
    "std_srvs/srv/Trigger": f"---\n{_ANSWER}",
}
"""The services of std_srvs, which rosbags lacks. They are the same in all distributions."""
_QUATERNION = "float64 x 0\nfloat64 y 0\nfloat64 z 0\nfloat64 w 1\n"
"""The fields with the defaults of common_interfaces, which rosbags drops. All zeros would not be a rotation."""


def texts(source: str) -> dict[str, str]:
    """Return the .msg texts of a store by full name. Use the cache if the cache matches the installed rosbags."""
    if source in preloaded:
        return preloaded[source]
    cache_name = _cache_name(source)
    cached = cache.read(cache_name)
    if cached is None:
        module = f"ros{dialect(source)[-1]}_{source}"
        definitions = import_module(f"rosbags.typesys.stores.{module}").FIELDDEFS
        known = {name: _text(name, definitions[name], source) for name in sorted(definitions)}
        cached = json.dumps(known).encode()
        cache.write(cache_name, cached)
    return cast("dict[str, str]", json.loads(cached))


def _text(name: str, definition: Any, source: str) -> str:
    if name == "geometry_msgs/msg/Quaternion" and dialect(source) == "ros2":
        return _QUATERNION
    constants, fields = definition
    lines = [f"{type} {constant}={_literal(type, value, source)}\n" for constant, type, value in constants]
    lines += [f"{_spelled(type, source)} {field}\n" for field, type in fields if field != FILLER]
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
    """Return the files with the stores of rosbags, without importing rosbags."""
    spec = PathFinder.find_spec("rosbags")
    roots = spec.submodule_search_locations if spec else None
    folders = [os.path.join(root, "typesys", "stores") for root in roots or ()]
    return tuple(
        Path(folder, name) for folder in folders for name in sorted(os.listdir(folder)) if name.endswith(".py")
    )


def _cache_name(source: str) -> str:
    """Return the name of a store's cache file, which changes with the files of rosbags and with this module."""
    files = [Path(__file__), *_files()]
    state = [(str(file), status.st_size, status.st_mtime_ns) for file in files for status in [file.stat()]]
    return f"{source}-{zlib.crc32(repr(state).encode()):08x}.json"
