"""Orders of a person from another terminal to a run: pause and resume, over a local socket of this machine."""

from __future__ import annotations

import contextlib
import json
import os
import socket
import threading
import time
from pathlib import Path

from needleplan.control.safety import GuardedStage, OperatingState, Order
from needleplan.devices import Address, Closing
from needleplan.errors import DeviceFault, MotionRefused
from needleplan.order_client import OrderReply, order_place, send_to
from needleplan.stopping import Rest

__all__ = ["OrderPort", "send_order"]

# longest time (s) until the thread sees that the port is closed; time between two looks at the guard
_TURN_S, _LOOK_S = 0.1, 0.005
# time (s) after `motion_s` for which rest is awaited
_MORE_S = 1.0
_ORDERS = {str(order): order for order in (Order.PAUSE, Order.RESUME)}


_PORT = 5005  # port of a robot without one in its address


def _place(robot: str) -> str:
    parsed = Address.parse(robot)
    if parsed.scheme == "serial":
        return order_place(parsed.scheme, parsed.path, 0)
    return order_place(parsed.scheme, parsed.host, parsed.port or _PORT)


class OrderPort(Closing):
    """A thread that gives the orders of a person to `guard`, until it is closed.

    Without local sockets on this system, or if the socket cannot be made, the run has no port: `obstacle` says why.
    """

    def __init__(self, guard: GuardedStage, robot: str) -> None:
        self._guard, self._path = guard, Path(_place(robot))
        self._closing = threading.Event()
        self._thread: threading.Thread | None = None
        self.obstacle: str = ""
        """Why there is no port; empty if there is one."""

        try:
            self._path.parent.mkdir(mode=0o700, exist_ok=True)
            if self._path.parent.lstat().st_uid != os.getuid():
                raise PermissionError(f"{self._path.parent} belongs to another user")
            self._path.unlink(missing_ok=True)  # of a run that was killed: the robot has one controller at a time
            self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
            self._socket.bind(str(self._path))
        except (OSError, AttributeError) as error:
            self.obstacle = str(error)
            return
        self._socket.settimeout(_TURN_S)
        self._thread = threading.Thread(target=self._serve, name="orders", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End the thread and remove the socket. Closing twice is harmless."""
        if self._thread is not None and not self._closing.is_set():
            self._closing.set()
            self._thread.join()
            self._socket.close()
            self._path.unlink(missing_ok=True)

    def _serve(self) -> None:
        while not self._closing.is_set():
            try:
                data, sender = self._socket.recvfrom(4096)
            except TimeoutError:
                continue
            with contextlib.suppress(ValueError, KeyError, TypeError, OSError):  # no order, or nobody waits any more
                request = json.loads(data)
                reply = self._obey(_ORDERS[request["order"]], str(request["by"]))
                self._socket.sendto(reply.encoded(), sender)

    def _obey(self, order: Order, by: str) -> OrderReply:
        guard = self._guard
        end_s = time.monotonic() + guard.limits.motion_s + _MORE_S
        try:
            if order is Order.PAUSE:
                with contextlib.suppress(DeviceFault):
                    guard.send_stop()
            guard.order(order, by)
        except MotionRefused as refusal:
            return OrderReply(str(guard.state.operating), guard.rest, str(refusal))
        while time.monotonic() < end_s and not self._is_done(order):
            time.sleep(_LOOK_S)
        is_void = order is Order.RESUME and guard.state.operating is not OperatingState.ENABLED
        return OrderReply(str(guard.state.operating), guard.rest, "the needle does not rest" if is_void else "")

    def _is_done(self, order: Order) -> bool:
        state = self._guard.state
        return self._guard.rest is Rest.RESTS if order is Order.PAUSE else state.waits is None


def send_order(robot: str, order: Order, by: str, within_s: float) -> OrderReply | None:
    """Give an order to the run on this machine that controls a robot.

    Parameters
    ----------
    robot : str
        Address of the robot.
    order : Order
        Order.
    by : str
        Who gives the order.
    within_s : float
        Longest time to wait for the reply (s).

    Returns
    -------
    OrderReply or None
        None if there is no such run, or if it does not reply within `within_s`.

    Raises
    ------
    AddressError
        The address is wrong.
    """
    return send_to(_place(robot), str(order), by, within_s)
