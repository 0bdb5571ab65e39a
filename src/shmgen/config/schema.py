"""Describe the keys of shmgen.toml as a JSON schema for editors."""

from __future__ import annotations

from typing import Any

from shmgen.config.keys import BOUND_KEY, FREE_SECTIONS, LISTS, MAX_NUMBER, SECTIONS, Key, keys_of


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
