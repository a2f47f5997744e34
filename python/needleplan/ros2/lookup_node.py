"""A ROS 2 node that answers poses of the tip with decisions of a policy table.

It subscribes to `tip` (geometry_msgs/PoseStamped, m, in the frame of the plan), and publishes `decision`
(needleplan_msgs/Decision) for every pose and `plan` (nav_msgs/Path, m) once, for subscribers that come later too. The
direction of the tip is the x axis of the pose, and its bevel is +1 where the z axis of the pose points up.

Build the messages first: copy the folder `needleplan_msgs` beside this file into a workspace, and run `colcon build`.
Then run, with the policy table as parameter::

    python lookup_node.py --ros-args -p table:=table.h5

This example was tested with stand-ins for rclpy and the messages, not with ROS 2 itself.
"""

from __future__ import annotations

import math

import rclpy
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Path
from needleplan_msgs.msg import Decision
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile

import needleplan as npl

__all__ = ["LookupNode", "main"]

_M = 1e-3  # metres in a millimetre


class LookupNode(Node):
    """Node that holds a policy table. Raises InputError if the table cannot be read."""

    def __init__(self) -> None:
        super().__init__("needleplan")
        self.declare_parameter("table", "table.h5")
        self.declare_parameter("frame", "plan")
        self._table = npl.PolicyTable.read(self.get_parameter("table").value)
        self._frame = self.get_parameter("frame").value
        self._number = 0
        self._decisions = self.create_publisher(Decision, "decision", 10)
        kept = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self._plan = self.create_publisher(Path, "plan", kept)
        self.create_subscription(PoseStamped, "tip", self.decide, 10)
        self.publish_plan()

    def decide(self, message: PoseStamped) -> None:
        """Publish the decision for a pose of the tip; log poses that lie outside of the table."""
        place, turn = message.pose.position, message.pose.orientation
        heading = math.atan2(2 * (turn.x * turn.y + turn.w * turn.z), 1 - 2 * (turn.y**2 + turn.z**2))
        bevel = 1 if 1 - 2 * (turn.x**2 + turn.y**2) > 0 else -1
        pose = [place.x / _M, place.y / _M, heading, float(bevel)]
        try:
            found = self._table.lookup(*pose[:3], bevel)
        except npl.InputError as error:
            self.get_logger().warning(str(error))
            return
        answer = Decision()
        answer.header = message.header
        answer.number, self._number = self._number, self._number + 1
        answer.action, answer.turn = found.action.name.lower(), found.action.code == 1
        answer.pose, answer.value, answer.success = pose, float(found.value), float(found.success)
        answer.table = self._table.digest
        self._decisions.publish(answer)

    def publish_plan(self) -> None:
        """Publish the path without noise from the best entry on the left edge."""
        plan = Path()
        plan.header.frame_id = self._frame
        plan.header.stamp = self.get_clock().now().to_msg()
        for x_mm, y_mm, *_ in self._table.path(self._table.best_entry(edge="left")).poses:
            point = PoseStamped()
            point.header = plan.header
            point.pose.position.x, point.pose.position.y = float(x_mm * _M), float(y_mm * _M)
            plan.poses.append(point)
        self._plan.publish(plan)


def main() -> None:
    """Run the node until it is shut down."""
    rclpy.init()
    node = LookupNode()
    try:
        rclpy.spin(node)
    finally:
        node.destroy_node()


if __name__ == "__main__":
    main()
