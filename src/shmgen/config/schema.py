"""A JSON schema of shmgen.toml for editors, and the table of its keys in docs/configuration.md."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

from shmgen.config.keys import BOUND_KEY, KEYS, LISTS, MAX_NUMBER, OPEN, SECTIONS, Key, header, of


def schema() -> dict[str, Any]:
    """In draft 7, which SchemaStore asks for. What it refuses the parser refuses too, and not the other way round."""
    properties = {key.name: _property(key) for key in of("")}
    for section, meaning in SECTIONS.items():
        table = _object({key.name: _property(key) for key in of(section)})
        table |= {"required": needed} if (needed := [key.name for key in of(section) if key.required]) else {}
        if section in OPEN:
            others = f"^(?!({'|'.join(key.name for key in of(section))})$){BOUND_KEY}$"
            table["patternProperties"] = {others: {"type": "integer", "minimum": 1, "maximum": MAX_NUMBER}}
        shape = {"type": "array", "items": table} if section in LISTS else table
        properties[section] = {"description": meaning, **shape}
    return {"$schema": "http://json-schema.org/draft-07/schema#", "title": "shmgen.toml", **_object(properties)}


def table() -> str:
    """In Markdown."""
    return "\n".join(("| key | type | default | meaning |", "|---|---|---|---|", *_rows()))


def _rows() -> Iterator[str]:
    for key in KEYS:
        name = f"`{header(key.section)}` `{key.name}`" if key.section else f"`{key.name}`"
        default = "required" if key.required else "" if key.default is None else f"`{json.dumps(key.default)}`"
        yield f"| {name} | {_type(key)} | {default} | {key.meaning} |"
        if key.section in OPEN and key == of(key.section)[-1]:
            name = f'`{header(key.section)}` `"package/Message.field"`'
            yield f"| {name} | 1 to {MAX_NUMBER} | | The same for one field, message or package. |"


def _type(key: Key) -> str:
    if key.choices:
        words = ", ".join(f"`{choice}`" for choice in key.choices)
        return f"list of {words}" if key.kind == "strings" else words
    if key.kind in ("integer", "number"):
        return f"{key.least:.10g} to {key.most:.10g}{f' {key.unit}' if key.unit else ''}"
    return {"strings": "list of strings", "boolean": "`true`, `false`"}.get(key.kind, key.kind)


def _object(properties: dict[str, Any]) -> dict[str, Any]:
    return {"type": "object", "properties": properties, "additionalProperties": False}


def _property(key: Key) -> dict[str, Any]:
    made: dict[str, Any] = {"description": key.meaning}
    if key.default is not None and not key.required:
        made["default"] = key.default
    match key.kind:
        case "choice":
            return made | {"enum": key.choices}
        case "strings":
            words: dict[str, Any] = {"type": "string"} | ({"enum": key.choices} if key.choices else {})
            return made | {"type": "array", "items": words} | ({"minItems": 1} if key.choices else {})
        case "integer" | "number":
            return made | {"type": key.kind, "minimum": key.least, "maximum": key.most}
    return made | {"type": key.kind} | ({"pattern": f"^({key.pattern})$"} if key.pattern else {})
