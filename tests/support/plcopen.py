"""Read PLCopen XML as an IDE does."""

from __future__ import annotations

from typing import Any

from lxml import etree

PLC = "{http://www.plcopen.org/xml/tc6_0200}"
TEXT = "{http://www.w3.org/1999/xhtml}xhtml"
CODESYS = "http://www.3s-software.com/plcopenxml/"


def imported(xml: str) -> dict[str, str]:
    """Return each object as an IDE stores it: declaration, code, and the methods of a block, by name."""
    project = etree.fromstring(xml.encode())
    objects = {}
    for tag in ("dataType", "globalVars", "pou"):
        for item in project.iter(PLC + tag):
            end = {"program": "END_PROGRAM\n", "functionBlock": "END_FUNCTION_BLOCK\n"}.get(item.get("pouType"), "")
            methods = [f"{declaration(one)}\n{code(one)}\nEND_METHOD\n" for one in data(item, "method")]
            objects[item.get("name")] = f"{declaration(item)}\n{code(item)}\n{end}" + "".join(methods)
    return objects


def data(item: Any, name: str) -> list[Any]:
    return list(item.findall(f"{PLC}addData/{PLC}data[@name='{CODESYS}{name}']/*"))


def declaration(item: Any) -> str:
    plain = item.find(f"{PLC}InterfaceAsPlainText")
    return str((plain if plain is not None else data(item, "interfaceasplaintext")[0]).findtext(f".//{TEXT}"))


def code(item: Any) -> str:
    return item.findtext(f"{PLC}body/{PLC}ST/{TEXT}") or ""
