"""Force sensor and tracker as processes of their own, which speak their bytes and measure what they are told.

They need little: who starts them has the plant.
"""

from __future__ import annotations

import math
import socket
import threading
from multiprocessing.connection import Connection

from needleplan.devices._base import ForceSample, PoseSample
from needleplan.devices._clock import no_long_collections
from needleplan.devices.ati import NetFtBox, NetFtServer
from needleplan.devices.endpoint import Endpoint, PtyEndpoint, TcpEndpoint
from needleplan.devices.ndi import AuroraDevice, SimulatedTool
from needleplan.devices.ndi.frames import NdiVisibility
from needleplan.devices.processes.feeds import FeedReader
from needleplan.devices.processes.part import Ready, Served, call_at_end, place_or_tell, tell
from needleplan.devices.processes.places import LabPlaces, TrackerLine

__all__ = ["TOOL", "serve_force", "serve_tracker"]

TOOL = "NP000001"
"""The serial number of the coil in the needle."""


def serve_force(boss: Connection, places: LabPlaces, feed: socket.socket) -> None:
    """Be the force sensor's box."""
    wrench = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    box = NetFtBox(lambda _: wrench)

    def hear(values: tuple[float, ...]) -> None:
        nonlocal wrench
        fx, fy, fz, tx, ty, tz = values
        wrench = (fx, fy, fz, tx, ty, tz)
        box.faults.freeze = False

    def fall_silent() -> None:
        box.faults.freeze = True

    server = place_or_tell(boss, lambda: NetFtServer(box, places.host, places.force_port, places.http_port))
    if server is None:
        return
    ended = threading.Event()
    call_at_end(boss, ended.set)
    with no_long_collections(), server, FeedReader(feed, hear, fall_silent, ForceSample):
        boss.send(Ready(server.address))
        ended.wait()
    tell(boss, Served())


def serve_tracker(boss: Connection, places: LabPlaces, feed: socket.socket) -> None:
    """Be the tracker, with one coil."""
    nan = math.nan
    heard = now = (0.0, nan, nan, nan, nan, nan, nan, nan, nan)
    tool = SimulatedTool(TOOL, lambda _: ((now[1], now[2], now[3], now[4]), (now[5], now[6], now[7])))

    def hear(values: tuple[float, ...]) -> None:
        nonlocal heard
        frame, w, qx, qy, qz, x, y, z, error_mm = values
        heard = (frame, w, qx, qy, qz, x, y, z, error_mm)

    def count() -> int:
        """Take what was heard last for the frame that is asked for now: a frame is there as soon as it is measured."""
        nonlocal now
        now = heard
        tool.visibility, tool.error_mm = (
            (NdiVisibility.VALID if math.isfinite(now[1]) else NdiVisibility.MISSING),
            now[8],
        )
        return int(now[0])

    device = AuroraDevice([tool], count=count)

    def place() -> Endpoint:
        if places.tracker_line is TrackerLine.PTY:
            return PtyEndpoint(device)
        return TcpEndpoint(device, places.host, places.tracker_port)

    endpoint = place_or_tell(boss, place)
    if endpoint is None:
        return
    ended = threading.Event()
    call_at_end(boss, ended.set)
    with no_long_collections(), endpoint, FeedReader(feed, hear, lambda: None, PoseSample):
        boss.send(Ready(endpoint.address))
        ended.wait()
    tell(boss, Served())
