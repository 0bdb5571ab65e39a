"""Describe the keys of shmgen.toml: as a JSON schema for editors, and as a table in docs/configuration.md."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

from shmgen.config.keys import BOUND_KEY, FREE_SECTIONS, KEYS, LISTS, MAX_NUMBER, SECTIONS, Key, header, keys_of


def schema() -> dict[str, Any]:
    """Return a JSON schema of shmgen.toml, draft 7, which SchemaStore requires.

    The schema cannot express all rules: shmgen also rejects some files that match the schema.
    """
    properties = {key.name: _property(key) for key in keys_of("")}
    for section, meaning in SECTIONS.items():
        table = _object({key.name: _property(key) for key in keys_of(section)})
        table |= {"required": needed} if (needed := [key.name for key in keys_of(section) if key.required]) else {}
        if section in FREE_SECTIONS:
            others = f"^(?!({'|'.join(key.name for key in keys_of(section))})$){BOUND_KEY}$"
            table["patternProperties"] = {others: {"type": "integer", "minimum": 1, "maximum": MAX_NUMBER}}
        shape = {"type": "array", "items": table} if section in LISTS else table
        properties[section] = {"description": meaning, **shape}
    return {"$schema": "http://json-schema.org/draft-07/schema#", "title": "shmgen.toml", **_object(properties)}


def table() -> str:
    """Return the table of all keys in Markdown."""
    return "\n".join(("| key | type | default | meaning |", "|---|---|---|---|", *_rows()))


def _rows() -> Iterator[str]:
    for key in KEYS:
        name = f"`{header(key.section)}` `{key.name}`" if key.section else f"`{key.name}`"
        default = "required" if key.required else "" if key.default is None else f"`{json.dumps(key.default)}`"
        yield f"| {name} | {_type(key)} | {default} | {key.meaning} |"
        if key.section in FREE_SECTIONS and key == keys_of(key.section)[-1]:
            name = f'`{header(key.section)}` `"package/Message.field"`'
            yield f"| {name} | 1 to {MAX_NUMBER} | | Replaces the key `default` for one field, message or package. |"


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
    schema_of_key: dict[str, Any] = {"description": key.meaning}
    if key.default is not None and not key.required:
        schema_of_key["default"] = key.default
    match key.kind:
        case "choice":
            return schema_of_key | {"enum": key.choices}
        case "strings":
            words: dict[str, Any] = {"type": "string"} | ({"enum": key.choices} if key.choices else {})
            return schema_of_key | {"type": "array", "items": words} | ({"minItems": 1} if key.choices else {})
        case "integer" | "number":
            return schema_of_key | {"type": key.kind, "minimum": key.least, "maximum": key.most}
    return schema_of_key | {"type": key.kind} | ({"pattern": f"^({key.pattern})$"} if key.pattern else {})
