"""Messages in exported ROS 2 bags have types, and the shipped definitions are those of the recordings."""

import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import needleplan as npl
from needleplan.artifacts import version
from needleplan.control._recorder import COMMAND, DECISION, TIP
from needleplan.recording import EVENT, Field, Json, MessageKind, Packed, Recorder, Recording
from needleplan.recording.rosbag import DEFINITIONS, write_rosbag
from tests.recording.samples import SESSION, START_NS

pytest.importorskip("rosbags", reason="rosbags is not installed")

TIP_VALUES = {each.name: 1.5 for each in TIP.fields} | {"time_ns": 7, "status": "coasting"}
DECISION_VALUES = {"number": 3, "action": "rotate", "state": [1, 2, 3, 0], "value": 8.5, "success": None, "turn": True,
                   "length_mm": "unknown", "tip": {"x_mm": 2.0, "at": [3, None], "status": "lost"}}  # fmt: skip


def exported(folder: Path, messages: dict[str, tuple[MessageKind, dict[str, Any]]]) -> dict[str, tuple[str, Any]]:
    """Return the type and the first message of each topic of the bag of a recording."""
    from rosbags.highlevel import AnyReader

    with Recorder(folder / "run.mcap", SESSION) as recorder:
        for topic, (kind, values) in messages.items():
            recorder.channel(topic, kind).put(START_NS, values)
    write_rosbag(Recording.read(folder / "run.mcap"), folder / "bag")
    with AnyReader([folder / "bag"]) as reader:  # without any definition but those of the bag
        return {each.topic: (each.msgtype, reader.deserialize(raw, each.msgtype)) for each, _, raw in reader.messages()}


def test_every_message_has_a_type_and_no_text_is_json(tmp_path: Path) -> None:
    tip = Packed(TIP.name, TIP.fields)
    own = Packed("my_msgs/msg/Temperature", (Field("celsius"), Field("place", "string")))
    odd = Packed("needs/no/ROS name", (Field("x_mm"),))
    found = exported(tmp_path, {
        "/tip": (tip, TIP_VALUES), "/decision": (DECISION, DECISION_VALUES),
        "/own": (own, {"celsius": 21.5, "place": "bath"}),
        "/odd": (odd, {"x_mm": 4.0}), "/json": (Json("lab.Note"), {"name": "stir", "speeds": [1, 2.5], "on": True}),
        "/event": (EVENT, {"name": "end", "cause": "target", "text": "", "step": 25}),
    })  # fmt: skip
    assert {topic: kind for topic, (kind, _) in found.items()} == {
        "/tip": TIP.name, "/decision": "needleplan_msgs/msg/Decision", "/own": own.name,
        "/odd": "needleplan_msgs/msg/Values", "/json": "needleplan_msgs/msg/Values",
        "/event": "needleplan_msgs/msg/Event", "/recorder": "needleplan_msgs/msg/RecorderStatus",
    }  # fmt: skip
    said = {topic: message for topic, (_, message) in found.items()}
    assert (said["/tip"].status, said["/tip"].STATUS_COASTING, said["/tip"].x_mm) == (2, 2, 1.5)
    decision = said["/decision"]
    assert (decision.number, decision.action, decision.turn, decision.state.tolist()) == (
        3,
        "rotate",
        True,
        [1, 2, 3, 0],
    )
    assert np.isnan([decision.success, decision.length_mm]).all()
    assert {each.key: each.value for each in decision.texts} == {"length_mm": "unknown", "tip.status": "lost"}
    assert [each.key for each in decision.numbers] == ["tip.x_mm", "tip.at.0", "tip.at.1"]
    assert (said["/own"].celsius, said["/own"].place) == (21.5, "bath")
    assert {each.key: each.value for each in said["/json"].numbers} == {"speeds.0": 1, "speeds.1": 2.5, "on": 1}
    assert (said["/event"].header.frame_id, said["/event"].numbers[0].value) == ("event", 25)


@pytest.mark.parametrize("kind", [TIP, COMMAND])
def test_the_shipped_definition_is_that_of_the_recordings(kind: Packed) -> None:
    shipped = (DEFINITIONS / f"{kind.name.rpartition('/')[2]}.msg").read_text().splitlines()[1:]
    assert shipped == ["std_msgs/Header header", *kind.schema.decode().splitlines()]


def test_the_shipped_package_has_the_version_of_needleplan() -> None:
    package = ET.parse(DEFINITIONS.parent / "package.xml").getroot()
    assert (package.findtext("name"), package.findtext("version")) == ("needleplan_msgs", version())
    assert npl.__version__ == version()
