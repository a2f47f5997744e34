"""What 3D Slicer is shown of an insertion: tip, target, planned and executed path, force and state.

All places are in mm in one frame, which Slicer takes for its own (RAS); where it is another, put a transform over the
nodes in Slicer. Nothing here waits for Slicer, or needs it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from enum import StrEnum

from needleplan.devices.address import Address
from needleplan.devices.igtl.contents import (
    Point,
    Sensor,
    Status,
    StatusCode,
    Unit,
    encode_points,
    encode_polyline,
    encode_sensor,
    encode_status,
    encode_string,
)
from needleplan.devices.igtl.poses import Pose, encode_transform
from needleplan.devices.igtl.server import MessageServer
from needleplan.devices.igtl.tracker import IGTL_PORT
from needleplan.errors import AddressError, InputError, Mistake

__all__ = ["Shown", "SlicerServer"]

_Place = tuple[float, float, float]
_TARGET_COLOUR = (255, 64, 64, 255)
_LARGEST = 1e6


class Shown(StrEnum):
    """The names of the nodes that appear in Slicer."""

    TIP = "NeedleTip"
    TARGET = "Target"
    PLANNED = "PlannedPath"
    EXECUTED = "ExecutedPath"
    FORCE = "Force"
    TORQUE = "Torque"
    STATE = "NeedleState"
    NOTE = "NeedleNote"


class SlicerServer(MessageServer):
    """A server that Slicer connects to, as a client (OpenIGTLinkIF), at port 18944.

    Every method returns at once. Raises InputError for what is not a number, and DeviceFault once it is closed.
    """

    @classmethod
    def open(cls, address: str = "igtl://127.0.0.1") -> SlicerServer:
        """Serve at `igtl://host[:18944]`: 127.0.0.1 for Slicer on this machine, 0.0.0.0 for any.

        Raises AddressError, and DeviceFault where the port is taken.
        """
        parsed = Address.parse(address)
        if parsed.scheme != "igtl":
            raise AddressError(Mistake("address", address, "must begin with igtl://"))
        parsed.only(())
        return cls(*parsed.network(IGTL_PORT))

    def show_tip(self, position_mm: _Place, quaternion: Sequence[float], time_s: float | None = None) -> None:
        """Show the pose of the tip; `quaternion` is (w, x, y, z), `time_s` in seconds since 1970 (now)."""
        w, x, y, z = quaternion
        _numbers("tip", (*position_mm, w, x, y, z))
        self.publish("TRANSFORM", Shown.TIP, encode_transform(Pose(position_mm, (w, x, y, z))), time_s)

    def show_target(self, position_mm: _Place, diameter_mm: float = 0.0) -> None:
        """Show where the tip is to go."""
        _numbers("target", (*position_mm, diameter_mm))
        point = Point(Shown.TARGET, position_mm, "Target", _TARGET_COLOUR, diameter_mm)
        self.publish("POINT", Shown.TARGET, encode_points([point]))

    def show_plan(self, points_mm: Sequence[_Place]) -> None:
        """Show the planned path, as a line; fewer than two points take it away."""
        self._line(Shown.PLANNED, points_mm)

    def show_path(self, points_mm: Sequence[_Place]) -> None:
        """Show the path of the tip so far, as a line; fewer than two points take it away."""
        self._line(Shown.EXECUTED, points_mm)

    def show_force(self, force_n: _Place, torque_n_mm: _Place | None = None) -> None:
        """Show the wrench at the base of the needle."""
        _numbers("force", force_n)
        self.publish("SENSOR", Shown.FORCE, encode_sensor(Sensor(force_n, Unit.NEWTON)))
        if torque_n_mm is not None:
            _numbers("torque", torque_n_mm)
            self.publish("SENSOR", Shown.TORQUE, encode_sensor(Sensor(torque_n_mm, Unit.NEWTON_MILLIMETRE)))

    def show_state(self, state: str, code: StatusCode = StatusCode.OK, cause: str = "") -> None:
        """Show the state of the robot (`ENABLED`, at most 20 bytes), and why it is in it."""
        self.publish("STATUS", Shown.STATE, encode_status(Status(code, state, cause)))

    def show_note(self, text: str) -> None:
        """Show a line of text."""
        self.publish("STRING", Shown.NOTE, encode_string(text))

    def _line(self, name: Shown, points_mm: Sequence[_Place]) -> None:
        _numbers(name, [number for point in points_mm for number in point])
        self.publish("POLYDATA", name, encode_polyline(points_mm))


def _numbers(what: str, numbers: Sequence[float]) -> None:
    if not all(map(math.isfinite, numbers)) or max(map(abs, numbers), default=0.0) > _LARGEST:
        raise InputError(Mistake(what, str(numbers), "must be numbers of at most a million"))
