"""The XML for import beside what exports of CODESYS hold: tests/targets/codesys_exports.toml."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from shmgen.core import toml

from ..support import import_or_skip
from .test_plcopen import generate

etree = import_or_skip("lxml.etree")
FACTS = toml.loads((Path(__file__).parent / "codesys_exports.toml").read_text(encoding="utf-8"))
ELEMENTS, TYPES = FACTS["elements"], {*FACTS["types"]["seen_names"], *FACTS["types"]["schema_only"]}


@pytest.fixture(scope="module")
def xml(tmp_path_factory: pytest.TempPathFactory) -> str:
    return generate(tmp_path_factory.mktemp("exports"))["plcopen/shmgen.xml"]


def named(element: Any) -> str:
    name = etree.QName(element).localname
    return f"data {element.get('name').rpartition('/')[2]}" if name == "data" else name


def faults(xml: str) -> Iterator[str]:
    """What no export holds so."""
    root = etree.fromstring(xml.encode())
    if root.nsmap != {None: FACTS["namespace"]}:
        yield f"namespace {root.nsmap}"
    for element in root.iter(etree.Element):
        name = named(element)
        if name in ELEMENTS:
            yield from (f"{name}: {fault}" for fault in faults_of(element, ELEMENTS[name]))
        elif name not in TYPES or element.attrib or len(element):
            yield f"no element {name}"


def faults_of(element: Any, facts: dict[str, Any]) -> Iterator[str]:
    attributes = set(element.attrib) - ({"name", "handleUnknown"} if named(element).startswith("data ") else set())
    if unknown := attributes - set(facts.get("attributes", ())):
        yield f"no attribute {unknown}"
    if missing := set(facts.get("always", ())) - attributes:
        yield f"lacks {missing}"
    if facts.get("handle") != element.get("handleUnknown"):
        yield f"handleUnknown is {facts.get('handle')}"
    if element.get("constant") not in (None, *FACTS["values"]["constant"]):
        yield "constant is true or left out"
    order = facts.get("children", [])
    found = ["types" if "types" in order and named(child) in TYPES else named(child) for child in element]
    if unknown := {name for name in found if name not in order}:
        yield f"holds no {unknown}"
    elif [order.index(name) for name in found] != sorted(order.index(name) for name in found):
        yield f"the order is {order}, not {list(dict.fromkeys(found))}"
    if facts.get("never_empty") and not found:
        yield "is never empty"


def test_it_holds_what_exports_hold(xml: str) -> None:
    assert list(dict.fromkeys(faults(xml))) == []
    root = etree.fromstring(xml.encode())
    for library in root.iter(f"{{{FACTS['namespace']}}}Library"):
        name, values = library.get("Name"), FACTS["values"]
        kind = "placeholder" if library.get("DefaultResolution") else "reference"
        assert re.fullmatch(values[kind], name)
        assert re.fullmatch(values["reference"], library.get("DefaultResolution", name))
        assert values["libraries"].get(library.get("Namespace"), name) == name
    placed = [it.get("ObjectId") for it in root.iter(f"{{{FACTS['namespace']}}}Object")]
    kept = [it.text for it in root.iter(f"{{{FACTS['namespace']}}}ObjectId")]
    kept += [it.get("ObjectId") for it in root.iter(f"{{{FACTS['namespace']}}}Method")]
    assert len(set(placed)) == len(placed)
    assert sorted(placed) == sorted(kept), "each object has an id of its own, by which it is in a folder"


BEFORE = [
    ("tc6_0200", "tc6_0201", "namespace"),
    ("<configurations />", '<configurations><configuration name="D" /></configurations>', "configurations: holds no"),
    ("<inputVars>", '<inputVars constant="false">', "constant is true or left out"),
    ("<Attributes>", "<Attributes></Attributes><Attributes>", "Attributes: is never empty"),
    ('handleUnknown="discard"', 'handleUnknown="implementation"', "handleUnknown is discard"),
]


@pytest.mark.parametrize(("ours", "other", "fault"), BEFORE)
def test_the_check_can_fail(xml: str, ours: str, other: str, fault: str) -> None:
    """With what our file held before the records were read, and the like."""
    assert ours in xml
    assert any(fault in found for found in faults(xml.replace(ours, other)))


def test_each_fact_has_a_source() -> None:
    for name, facts in ELEMENTS.items():
        assert set(facts["seen"]) <= set(FACTS["sources"]), name
        assert facts["seen"] or facts["schema_only"], name
