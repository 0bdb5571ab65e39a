"""What an IDE would import is what runs: Structured Text out of the PLCopen XML exchanges with Python."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from lxml import etree

from shmgen import pipeline
from shmgen.config import Config
from shmgen.model import TypeName
from tests.softplc import compile_st

from .support.build import classes, put

PLC = "{http://www.plcopen.org/xml/tc6_0201}"
TEXT = "{http://www.w3.org/1999/xhtml}xhtml"
CODESYS = "http://www.3s-software.com/plcopenxml/"


def imported(xml: str) -> dict[str, str]:
    """The objects as an IDE stores them: declaration, code, and the methods of a block, by name."""
    project = etree.fromstring(xml.encode())
    found = {}
    for tag in ("dataType", "globalVars", "pou"):
        for item in project.iter(PLC + tag):
            end = {"program": "END_PROGRAM\n", "functionBlock": "END_FUNCTION_BLOCK\n"}.get(item.get("pouType"), "")
            methods = [f"{declaration(one)}\n{code(one)}\nEND_METHOD\n" for one in data(item, "method")]
            found[item.get("name")] = f"{declaration(item)}\n{code(item)}\n{end}" + "".join(methods)
    return found


def data(item: Any, name: str) -> list[Any]:
    return list(item.findall(f"{PLC}addData/{PLC}data[@name='{CODESYS}{name}']/*"))


def declaration(item: Any) -> str:
    plain = item.find(f"{PLC}InterfaceAsPlainText")
    return str((plain if plain is not None else data(item, "interfaceasplaintext")[0]).findtext(f".//{TEXT}"))


def code(item: Any) -> str:
    return item.findtext(f"{PLC}body/{PLC}ST/{TEXT}") or ""


def test_a_message_crosses_both_ways(tmp_path: Path, topic: str) -> None:
    imu = TypeName("sensor_msgs", "msg", "Imu")
    texts = pipeline.generate(Config(tmp_path, package="shm_from_xml", targets=("python", "plcopen")), [str(imu)])
    put(texts, tmp_path)
    kind, publisher_kind, subscriber_kind = classes(tmp_path, "shm_from_xml", imu)
    plc = compile_st(imported(texts["plcopen/shmgen.xml"]))
    subscriber = plc.block("FB_sensor_msgs_Imu_Subscriber")
    publisher = plc.block("FB_sensor_msgs_Imu_Publisher")
    sent = kind()
    sent.header.frame_id, sent.orientation.w, sent.linear_acceleration_covariance[8] = "base", 0.5, 8.25
    with publisher_kind(topic) as robot, subscriber_kind(f"{topic}/back") as reader:
        robot.publish(sent)
        subscriber(xEnable=True, sTopic=topic)
        assert subscriber.xNewData
        received, answer = subscriber.Msg, publisher.Msg
        answer.header.frame_id = received.header.frame_id
        answer.orientation.w = received.orientation.w
        answer.linear_acceleration_covariance[8] = received.linear_acceleration_covariance[8]
        publisher(xEnable=True, sTopic=f"{topic}/back")
        assert publisher.xSent
        assert reader.read() == sent
