"""Structured Text from the PLCopen XML, which an IDE imports, exchanges messages with Python."""

from __future__ import annotations

from pathlib import Path

from shmgen.config import Config
from shmgen.core.model import TypeName
from shmgen.generator import pipeline
from tests.softplc import compile_st

from ..support.build import classes, put
from ..support.plc_demo import ready
from ..support.plcopen import imported


def test_message_passes_in_both_directions(tmp_path: Path, topic: str) -> None:
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
        publisher.xEnable, publisher.sTopic = True, f"{topic}/back"
        assert ready(publisher).xSent
        assert reader.read() == sent
