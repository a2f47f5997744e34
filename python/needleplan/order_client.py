"""An order of a person to a run of another terminal, over a local socket: the smallest client.

`needleplan pause` must work on a machine that is busy with other programs, where each import costs time. So this module
imports only small modules of needleplan. `needleplan.control.OrderPort` is the other side.

A run that controls a robot listens at a datagram socket whose name follows from the address of the robot, in a folder
that only the user may enter. A request `{"order": "pause", "by": NAME}` gets a reply `{"state", "rest", "refused"}`.
"""

from __future__ import annotations

import contextlib
import json
import os
import socket
import time
import zlib

from needleplan.line_owner import run_folder
from needleplan.stopping import Rest

__all__ = ["OrderReply", "order_place", "send_to"]


class OrderReply:
    """State of the run after an order: operating state, rest of the needle, and why the order was refused, or ""."""

    state: str
    rest: Rest
    refused: str

    def __init__(self, state: str, rest: Rest, refused: str = "") -> None:
        self.state, self.rest, self.refused = state, rest, refused

    def encoded(self) -> bytes:
        """Return the reply as bytes."""
        return json.dumps({"state": self.state, "rest": str(self.rest), "refused": self.refused}).encode()


def order_place(scheme: str, host: str, port: int) -> str:
    """Return the path of the socket of the run that controls a robot. All names of one host have one path.

    Parameters
    ----------
    scheme : str
        Scheme of the address of the robot, such as `udp`.
    host : str
        Host of the address; for `serial`, the path of the serial port.
    port : int
        Port of the address; for `serial`, 0.

    Returns
    -------
    str
    """
    if scheme == "udp":
        with contextlib.suppress(OSError, UnicodeError):  # an unknown host: no run controls a robot there
            host = str(socket.getaddrinfo(host, None)[0][4][0])
    elif scheme == "serial":
        host = os.path.realpath(host)
    return f"{run_folder()}/{zlib.crc32(f'{scheme}://{host}'.encode()):08x}-{port}"


def send_to(place: str, order: str, by: str, within_s: float) -> OrderReply | None:
    """Send an order to the run that listens at a path, and return its reply.

    Parameters
    ----------
    place : str
        Path of the socket.
    order : str
        Order.
    by : str
        Who gives the order.
    within_s : float
        Longest time to wait for the reply (s).

    Returns
    -------
    OrderReply or None
        None if no run listens there, or if it does not reply within `within_s`.
    """
    # A name for each order: the late reply to an earlier one must not be taken for the reply to this one.
    mine = f"{place}-{os.getpid()}-{time.monotonic_ns()}"
    try:
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as link:
            link.bind(mine)
            try:
                link.connect(place)
                link.settimeout(within_s)
                link.send(json.dumps({"order": order, "by": by}).encode())
                reply = json.loads(link.recv(4096))
            finally:
                os.unlink(mine)  # noqa: PTH108 (`pathlib` takes longer to import than all of this module)
        return OrderReply(reply["state"], Rest(reply["rest"]), reply["refused"])
    except (OSError, AttributeError, ValueError, KeyError, TypeError):  # Windows has no AF_UNIX
        return None
