"""The built-in stores: message definitions of the PyPI package rosbags.

Importing a store of rosbags takes longer than the rest of a run, so the texts are saved in the user's cache folder.
"""

from __future__ import annotations

import functools
import json
import os
import zlib
from importlib.machinery import PathFinder
from pathlib import Path
from typing import cast

from shmgen.core import cache
from shmgen.core.model import TypeName
from shmgen.definitions.catalogue import Catalogue, Definition, package_of
from shmgen.definitions.tokens import Dialect

ROS1 = frozenset({"noetic"})
preloaded: dict[str, dict[str, str]] = {}
"""Store -> full name -> .msg text. Empty, except in the web page that generates code: a browser has no rosbags."""


def names() -> tuple[str, ...]:
    """Return the names of the built-in stores: `jazzy`, `humble`, `noetic` and the others of the installed rosbags."""
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


_ANSWER = "bool success\nstring message\n"
_SERVICES = {
    "std_srvs/srv/Empty": "---\n",
    "std_srvs/srv/SetBool": f"bool data\n---\n{_ANSWER}",
    "std_srvs/srv/Trigger": f"---\n{_ANSWER}",
}
"""The services of std_srvs, which rosbags lacks. They are the same in all distributions."""
_QUATERNION = "float64 x 0\nfloat64 y 0\nfloat64 z 0\nfloat64 w 1\n"
"""The fields with the defaults of common_interfaces, which rosbags drops. All zeros would not be a rotation."""
_SEPARATOR = "=" * 80
"""The line that rosbags writes between a definition and the definitions of the nested messages."""


def texts(source: str) -> dict[str, str]:
    """Return the .msg texts of a store by full name. Use the cache if the cache matches the installed rosbags."""
    if source in preloaded:
        return preloaded[source]
    cache_name = _cache_name(source)
    cached = cache.read(cache_name)
    if cached is None:
        cached = json.dumps(_texts_of_rosbags(source)).encode()
        cache.write(cache_name, cached)
    return cast("dict[str, str]", json.loads(cached))


def _texts_of_rosbags(source: str) -> dict[str, str]:
    from rosbags.typesys import Stores, get_typestore

    version = int(dialect(source)[-1])
    store = get_typestore(Stores(f"ros{version}_{source}"))
    definitions = ((name, store.generate_msgdef(name, version)[0]) for name in sorted(store.fielddefs))
    known = {name: definition.partition(_SEPARATOR)[0] for name, definition in definitions}
    if version == 2:
        known["geometry_msgs/msg/Quaternion"] = _QUATERNION
    return known


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
