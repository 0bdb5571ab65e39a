"""Compare the XML for import with the elements of CODESYS exports (tests/targets/codesys_exports.toml)."""

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


def label(element: Any) -> str:
    name = etree.QName(element).localname
    return f"data {element.get('name').rpartition('/')[2]}" if name == "data" else name


def export_faults(xml: str) -> Iterator[str]:
    """Yield the differences from all recorded exports."""
    root = etree.fromstring(xml.encode())
    if root.nsmap != {None: FACTS["namespace"]}:
        yield f"namespace {root.nsmap}"
    for element in root.iter(etree.Element):
        name = label(element)
        if name in ELEMENTS:
            yield from (f"{name}: {fault}" for fault in element_faults(element, ELEMENTS[name]))
        elif name not in TYPES or element.attrib or len(element):
            yield f"no element {name}"


def element_faults(element: Any, facts: dict[str, Any]) -> Iterator[str]:
    attributes = set(element.attrib) - ({"name", "handleUnknown"} if label(element).startswith("data ") else set())
    if unknown := attributes - set(facts.get("attributes", ())):
        yield f"no attribute {unknown}"
    if missing := set(facts.get("always", ())) - attributes:
        yield f"lacks {missing}"
    if facts.get("handle") != element.get("handleUnknown"):
        yield f"handleUnknown is {facts.get('handle')}"
    if element.get("constant") not in (None, *FACTS["values"]["constant"]):
        yield "constant is true or left out"
    order = facts.get("children", [])
    names = ["types" if "types" in order and label(child) in TYPES else label(child) for child in element]
    if unknown := {name for name in names if name not in order}:
        yield f"holds no {unknown}"
    elif [order.index(name) for name in names] != sorted(order.index(name) for name in names):
        yield f"the order is {order}, not {list(dict.fromkeys(names))}"
    if facts.get("never_empty") and not names:
        yield "is never empty"


def test_xml_uses_only_elements_of_codesys_exports(xml: str) -> None:
    assert list(dict.fromkeys(export_faults(xml))) == []
    root = etree.fromstring(xml.encode())
    for library in root.iter(f"{{{FACTS['namespace']}}}Library"):
        name, values = library.get("Name"), FACTS["values"]
        kind = "placeholder" if library.get("DefaultResolution") else "reference"
        assert re.fullmatch(values[kind], name)
        assert re.fullmatch(values["reference"], library.get("DefaultResolution", name))
        assert values["libraries"].get(library.get("Namespace"), name) == name
    folder_ids = [node.get("ObjectId") for node in root.iter(f"{{{FACTS['namespace']}}}Object")]
    object_ids = [node.text for node in root.iter(f"{{{FACTS['namespace']}}}ObjectId")]
    object_ids += [node.get("ObjectId") for node in root.iter(f"{{{FACTS['namespace']}}}Method")]
    assert len(set(folder_ids)) == len(folder_ids)
    assert sorted(folder_ids) == sorted(object_ids), "each object has an id of its own, by which it is in a folder"


FORMER_FAULTS = [
    ("tc6_0200", "tc6_0201", "namespace"),
    ("<configurations />", '<configurations><configuration name="D" /></configurations>', "configurations: holds no"),
    ("<inputVars>", '<inputVars constant="false">', "constant is true or left out"),
    ("<Attributes>", "<Attributes></Attributes><Attributes>", "Attributes: is never empty"),
    ('handleUnknown="discard"', 'handleUnknown="implementation"', "handleUnknown is discard"),
]


@pytest.mark.parametrize(("ours", "other", "fault"), FORMER_FAULTS)
def test_check_detects_former_faults(xml: str, ours: str, other: str, fault: str) -> None:
    """Restore mistakes that the XML contained before the exports were recorded, and similar mistakes."""
    assert ours in xml
    assert any(fault in reported for reported in export_faults(xml.replace(ours, other)))


def test_each_recorded_fact_names_its_source() -> None:
    for name, facts in ELEMENTS.items():
        assert set(facts["seen"]) <= set(FACTS["sources"]), name
        assert facts["seen"] or facts["schema_only"], name
