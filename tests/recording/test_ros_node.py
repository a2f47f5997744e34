"""The ROS 2 node of the docs, with stand-ins for rclpy, and messages that are as strict as those of ROS 2."""

import importlib.util
import math
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest

import needleplan as npl
from needleplan.recording.rosbag import DEFINITIONS

pytest.importorskip("rosbags", reason="rosbags is not installed")

NODE = DEFINITIONS.parents[1] / "lookup_node.py"
TYPES = {"float64": float, "int64": int, "uint32": int, "int32": int, "string": str, "bool": bool}


def message(name: str, store: Any) -> type:
    """Return a class of messages that has the fields of the definition, with defaults, and refuses other types."""
    fields = dict(store.fielddefs[name][1])

    def default(field: str) -> Any:
        node, detail = fields[field]
        if node == node.NAME:
            return message(detail, store)()
        return TYPES[detail[0]]() if node == node.BASE else []

    class Message:
        __slots__ = tuple(fields)

        def __init__(self) -> None:
            for each in fields:
                setattr(self, each, default(each))

        def __setattr__(self, field: str, value: object) -> None:
            node, detail = fields[field]
            if node == node.BASE:
                assert type(value) is TYPES[detail[0]], (name, field, value)
            super().__setattr__(field, value)

    return Message


class Node:
    """Stand-in for rclpy.node.Node."""

    table = ""

    def __init__(self, name: str) -> None:
        self.name, self.published, self.warnings = name, {}, []  # type: ignore[var-annotated]

    def declare_parameter(self, name: str, value: object) -> None:
        assert name in ("table", "frame")
        self.frame = value

    def get_parameter(self, name: str) -> SimpleNamespace:
        return SimpleNamespace(value=Node.table if name == "table" else self.frame)

    def create_publisher(self, kind: type, topic: str, quality: object) -> SimpleNamespace:
        assert quality
        messages: list[Any] = self.published.setdefault(topic, [])

        def publish(each: object) -> None:
            assert type(each).__slots__ == kind.__slots__  # type: ignore[attr-defined]
            messages.append(each)

        return SimpleNamespace(publish=publish)

    def create_subscription(self, *arguments: object) -> None:
        self.subscribed = arguments

    def get_clock(self) -> SimpleNamespace:
        return SimpleNamespace(now=lambda: SimpleNamespace(to_msg=self.stamp))

    def get_logger(self) -> SimpleNamespace:
        return SimpleNamespace(warning=self.warnings.append)


@pytest.fixture
def node(table_file: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    for file in DEFINITIONS.glob("*.msg"):
        store.register(get_types_from_msg(file.read_text(), f"needleplan_msgs/msg/{file.stem}"))
    quality = {"DurabilityPolicy": SimpleNamespace(TRANSIENT_LOCAL=1), "QoSProfile": SimpleNamespace}
    contents: dict[str, dict[str, Any]] = {"rclpy": {}, "rclpy.node": {"Node": Node}, "rclpy.qos": quality}
    for name in ("geometry_msgs/msg/PoseStamped", "nav_msgs/msg/Path", "needleplan_msgs/msg/Decision"):
        package, _, kind = name.split("/")
        contents |= {package: {}, f"{package}.msg": {kind: message(name, store)}}
    for name, names in contents.items():
        module = ModuleType(name)
        vars(module).update(names)
        monkeypatch.setitem(sys.modules, name, module)
    Node.table = str(table_file)
    Node.stamp = message("builtin_interfaces/msg/Time", store)  # type: ignore[attr-defined]
    spec = importlib.util.spec_from_file_location("lookup_node", NODE)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.LookupNode()


def pose(node: Any, x_mm: float, y_mm: float, heading_rad: float, bevel: int) -> Any:
    kind, topic, callback, _ = node.subscribed
    assert (topic, callback) == ("tip", node.decide)
    found = kind()
    found.pose.position.x, found.pose.position.y = x_mm / 1000, y_mm / 1000
    turn, half = found.pose.orientation, heading_rad / 2
    if bevel == 1:
        turn.w, turn.z = math.cos(half), math.sin(half)
    else:  # rolled by half a turn about its own x axis
        turn.w, turn.x, turn.y, turn.z = 0.0, math.cos(half), math.sin(half), 0.0
    return found


@pytest.mark.parametrize("heading_rad", [0.0, 0.3, -2.5])
@pytest.mark.parametrize("bevel", [-1, 1])
def test_a_pose_is_answered_as_the_table_answers(
    node: Any, table: npl.PolicyTable, heading_rad: float, bevel: int
) -> None:
    for _ in range(2):
        node.decide(pose(node, 10.0, 20.0, heading_rad, bevel))
    first, second = node.published["decision"]
    found = table.lookup(10.0, 20.0, heading_rad, bevel)
    assert (first.action, first.turn) == (found.action.name.lower(), found.action is npl.planning.Action.ROTATE)
    assert (first.value, first.success) == pytest.approx((found.value, found.success), rel=1e-6)
    assert first.pose == pytest.approx([10.0, 20.0, heading_rad, bevel])
    assert (first.number, second.number, first.table) == (0, 1, table.digest)


def test_the_plan_is_published_once_in_metres(node: Any, table: npl.PolicyTable) -> None:
    (plan,) = node.published["plan"]
    expected = table.path(table.best_entry(edge="left")).poses
    assert [each.pose.position.x for each in plan.poses] == pytest.approx((expected[:, 0] / 1000).tolist())
    assert plan.header.frame_id == "plan"


def test_a_pose_outside_is_a_warning(node: Any) -> None:
    node.decide(pose(node, -50.0, 20.0, 0.0, 1))
    assert node.published["decision"] == []
    assert "must be finite, in the workspace" in node.warnings[0]
