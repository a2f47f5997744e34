"""A ROS 2 node that lets needleplan drive a CRTK robot: it serves the robot protocol, and speaks CRTK topics.

It subscribes to `measured_js` and publishes `servo_jp` (sensor_msgs/JointState: depth in m, roll in rad) 200 times per
second, from the present positions to the goals at the commanded speeds. All rules of the protocol hold: limits,
deadlines, the watchdog. Enable and home the robot by its own CRTK commands. Run it in the namespace of the robot::

    python robot_node.py --ros-args -r __ns:=/needle -p port:=5005

A robot that does not follow within 0.2 mm or 0.05 rad, or sends no `measured_js` for 50 ms, is a fault. This example
was tested with stand-ins for rclpy and the messages, not with ROS 2 itself.
"""

from __future__ import annotations

import math
import threading

import rclpy
from rclpy.node import Node
from sensor_msgs.msg import JointState

from needleplan.devices.robot import Fault, RobotDriveState, RobotMachine, RobotServer

__all__ = ["CrtkDrive", "main"]

_M = 1e-3  # metres in a millimetre
_PERIOD_S = 0.005  # time (s) between two `servo_jp`
_STALE_S = 0.05  # time (s) without `measured_js` after which the drive reports a fault


class CrtkDrive:
    """Drives of the insertion axis (mm) and of the roll (rad) behind the topics of `node`."""

    def __init__(self, node: Node) -> None:
        self._servo = node.create_publisher(JointState, "servo_jp", 1)
        node.create_subscription(JointState, "measured_js", self.measure, 1)
        self.measured: list[float] = []
        self._before: list[float] = []
        self._wanted: list[float] = []
        self._goals, self._speeds, self._velocities = [0.0, 0.0], [0.0, 0.0], [0.0, 0.0]
        self._now_s = self._seen_s = self._sent_s = -math.inf

    def measure(self, message: JointState) -> None:
        """Take the measured positions; the first ones are the goals."""
        depth_m, roll_rad = message.position[:2]
        self.measured, self._seen_s = [depth_m / _M, roll_rad], self._now_s
        if not self._wanted:
            self._wanted, self._goals, self._before = ([*self.measured] for _ in range(3))

    def advance(self, time_s: float) -> RobotDriveState:
        """Advance the commanded positions to the time `time_s`, send them, and return the state of the drives."""
        passed_s = time_s - self._now_s if self._now_s > -math.inf else 0.0
        self._now_s = time_s
        for axis in range(2):
            left = self._goals[axis] - self._wanted[axis]
            self._wanted[axis] += math.copysign(min(abs(left), self._speeds[axis] * passed_s), left)
        if time_s - self._sent_s >= _PERIOD_S:
            if self._sent_s > -math.inf:
                passed_s = time_s - self._sent_s
                self._velocities = [
                    (now - before) / passed_s for now, before in zip(self.measured, self._before, strict=True)
                ]
            self._before, self._sent_s = self.measured, time_s
            self._send()
        stale = time_s - self._seen_s > _STALE_S and self._seen_s > -math.inf
        depth_mm, roll_rad = self.measured
        return RobotDriveState(
            depth_mm, self._velocities[0], roll_rad, self._velocities[1], *self._wanted,
            self._wanted != self._goals, Fault.DRIVE if stale else Fault(0),
        )  # fmt: skip

    def insert(self, depth_mm: float, velocity_mm_s: float) -> None:
        """Begin a motion to a depth."""
        self._goals[0], self._speeds[0] = depth_mm, velocity_mm_s

    def rotate(self, roll_rad: float, velocity_rad_s: float) -> None:
        """Begin a rotation to a roll angle."""
        self._goals[1], self._speeds[1] = roll_rad, velocity_rad_s

    def stop(self) -> None:
        """Let both axes stand where they are measured."""
        self._wanted, self._goals = [*self.measured], [*self.measured]
        self._send()

    def _send(self) -> None:
        message = JointState()
        message.position = [self._wanted[0] * _M, self._wanted[1]]
        self._servo.publish(message)


def main() -> None:
    """Serve the robot from its first measured positions on, until the node is shut down."""
    rclpy.init()
    node = Node("needleplan_robot")
    node.declare_parameter("port", 5005)
    drive = CrtkDrive(node)
    while rclpy.ok() and not drive.measured:
        rclpy.spin_once(node)
    threading.Thread(target=rclpy.spin, args=(node,), daemon=True).start()
    RobotServer(RobotMachine(drive, homed=False), "0.0.0.0", node.get_parameter("port").value).run()


if __name__ == "__main__":
    main()
