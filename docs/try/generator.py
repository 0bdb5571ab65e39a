"""Run shmgen in the page: one JSON document with the user's input comes in, one with all results goes out.

The page keeps the user's input as one object, called the state:

    * source: the built-in store, such as "jazzy"
    * files: path -> text of definitions, such as "my_msgs/msg/Job.msg"
    * messages: types from the store, such as "geometry_msgs/Pose"
    * topics: objects with the keys topic, type, direction and depth, as in shmgen.toml
    * bounds: key of [bounds] in shmgen.toml -> number of elements
"""

from __future__ import annotations

import io
import json
import os
import shutil
import zipfile
from pathlib import Path, PurePosixPath
from typing import Any

from shmgen import config as configuration
from shmgen.cli import init, requested
from shmgen.config import Config
from shmgen.core.diagnostics import Diagnostic, Rejected, Report
from shmgen.core.model import Layouts, Schema, TypeName
from shmgen.core.toml import dumps
from shmgen.definitions import store
from shmgen.definitions.catalogue import SECTIONS
from shmgen.generator import bounds, pipeline
from shmgen.generator.render import render
from shmgen.show import memory_map, table


def load_stores(folder: str) -> None:
    """Read the definitions of each built-in store from `<store>.json` in `folder`."""
    store.preloaded.update({file.stem: json.loads(file.read_text()) for file in Path(folder).glob("*.json")})


def stored_types(source: str) -> list[str]:
    """Return the name of each message, service and action of a built-in store, such as "geometry_msgs/Pose"."""
    names = (name for [package] in store.catalogue(source).values() for name in package.definitions)
    return sorted({name.short if name.kind == "msg" else name.short.rpartition("_")[0] for name in names})


def toml(state: dict[str, Any]) -> str:
    """Return the shmgen.toml with which the command line gives the same files."""
    own = sorted({path.partition("/")[0] for path in state["files"]})
    document: dict[str, Any] = {"messages": [*state["messages"], *own]}
    document |= {"path": ["."]} if own else {}
    document["source"] = state["source"]
    document |= {"bounds": dict(sorted(state["bounds"].items()))} if state["bounds"] else {}
    document |= {"topics": state["topics"]} if state["topics"] else {}
    return dumps(document)


def run(state: dict[str, Any], folder: str = "/work") -> dict[str, Any]:
    """Generate everything the state asks for.

    Return the keys `toml`, `diagnostics`, `missing` (bounds that the user must give), `messages` (with layout and
    picture) and `files` (path -> text). If anything is wrong, `files` and `messages` are empty.
    """
    text = toml(state)
    result: dict[str, Any] = {"toml": text, "diagnostics": [], "missing": [], "messages": [], "files": {}}
    _write_input(Path(folder), {**state["files"], "shmgen.toml": text})
    if not state["messages"] and not state["files"] and not state["topics"]:
        return result
    try:
        config = configuration.load(Path("shmgen.toml"), "shmgen.toml", Report())
        requests = requested.configured(config)
        opened = pipeline.library(config)
        result["missing"] = _missing(config, pipeline.read(config, dict.fromkeys(requests), opened))
        layouts = pipeline.lay_out(config, dict.fromkeys(requests), opened)
        result["files"] = pipeline.render_layouts(config, layouts)
        result["messages"] = [_message(name, layouts) for name, layout in layouts.items() if layout.requested]
    except Rejected as rejected:
        result["diagnostics"] = [_diagnostic(entry) for entry in rejected.diagnostics]
    return result


def _write_input(folder: Path, files: dict[str, str]) -> None:
    shutil.rmtree(folder, ignore_errors=True)
    for path, text in files.items():
        file = folder / path
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text, encoding="utf-8", newline="")
    os.chdir(folder)


def _missing(config: Config, schema: Schema) -> list[dict[str, Any]]:
    """List each sequence without a bound: the key for [bounds], its place, and the proposed number of elements."""
    keys = {key for missing in bounds.unbounded(schema, config.bounds).values() for key in missing}
    return [
        {"key": key, "proposed": init.DEFAULT, "type": field.written, **_place(field.span)}
        for key, field in _fields(schema).items()
        if key in keys
    ]


def _fields(schema: Schema) -> dict[str, Any]:
    return {f"{message.name.short}.{field.name}": field for message in schema.messages for field in message.fields}


def _place(span: Any) -> dict[str, Any]:
    return {"path": span.path, "line": span.line, "column": span.column, "width": span.width}


def _diagnostic(entry: Diagnostic) -> dict[str, Any]:
    return {"code": entry.code, "text": str(entry), **_place(entry.span)}


def _message(name: TypeName, layouts: Layouts) -> dict[str, Any]:
    [(_, drawing)] = render([memory_map.plan(layouts[name], layouts)]).items()
    [layout] = json.loads(table.as_json([layouts[name]], layouts))
    return {**layout, "type": name.short, "svg": drawing}


def pack_zip(state: dict[str, Any], files: dict[str, str]) -> bytes:
    """Return a zip of the generated files, below `generated/`, beside the definitions and the shmgen.toml."""
    content = {f"generated/{path}": text for path, text in files.items()}
    content |= {**state["files"], "shmgen.toml": toml(state)}
    target = io.BytesIO()
    with zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED) as archive:
        for path, text in sorted(content.items()):
            archive.writestr(zipfile.ZipInfo(path), text.encode(), zipfile.ZIP_DEFLATED)
    return target.getvalue()


def unpack_zip(name: str, content: bytes) -> dict[str, str]:
    """Return the definitions and package.xml files of a zip: path, from the folder of the package on -> text.

    `name` is the zip's own name; it names the package if the zip holds msg/, srv/ or action/ at its top. Raise
    UnicodeDecodeError if a file is not UTF-8, and BadZipFile if `content` is not a zip.
    """
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        paths = [PurePosixPath(path) for path in archive.namelist()]
        roots = {root for path in paths if (root := _package_of(path))}
        texts = {}
        for path in paths:
            root = path.parent if path.name == "package.xml" else _package_of(path)
            if root in roots:
                package = root.name or Path(name).stem
                text = archive.read(str(path)).decode("utf-8")
                texts[str(package / path.relative_to(root))] = text
    return texts


def _package_of(path: PurePosixPath) -> PurePosixPath | None:
    """Return the folder of the package that a definition belongs to, None if the file is not a definition."""
    is_definition = path.suffix in (".msg", ".srv", ".action", ".idl") and path.parent.name in SECTIONS
    return path.parent.parent if is_definition else None
