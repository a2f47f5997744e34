"""A stop by a bystander, who does not control the robot."""

from __future__ import annotations

import time

from needleplan.devices._links import Link
from needleplan.devices._opening import Address, open_link
from needleplan.devices.robot.messages import ROBOT_PORT, Answer, Head, Result, RobotCommand, RobotKind, decode, encode
from needleplan.errors import AddressError, DeviceFault, Mistake, ProtocolError

__all__ = ["stop_robot"]

# time (s) without an answer after which the stop is sent again
_AGAIN_S = 0.02


def stop_robot(address: str, within_s: float = 2.0) -> float:
    """Stop the robot at `udp://host[:5005]` without taking control, and return the time (s) until its answer.

    The stop is sent again every 20 ms until the robot answers. It needs no key. If the robot has a controller, the
    robot enters FAULT, and the run of the controller ends. Raises AddressError if the address is wrong, DeviceFault if
    the robot does not confirm the stop within `within_s`.
    """
    parsed = Address.parse(address)
    if parsed.scheme != "udp":
        raise AddressError(Mistake("address", address, "a robot is reached by udp://host"))
    host, port = parsed.network(ROBOT_PORT)
    with open_link(Address("udp", host, port)) as link:
        began_s = time.monotonic()
        number = 0
        while time.monotonic() - began_s < within_s:
            number += 1
            link.send(encode(RobotCommand(Head(0, number, time.monotonic_ns(), number=number), RobotKind.STOP)))
            if _is_confirmed(link, time.monotonic() + _AGAIN_S):
                return time.monotonic() - began_s
    raise DeviceFault(f"robot: no answer to the stop within {within_s:g} s; use the emergency stop")


def _is_confirmed(link: Link, until_s: float) -> bool:
    while (left_s := until_s - time.monotonic()) > 0:
        try:
            answer = decode(link.receive(left_s))
        except ProtocolError:
            continue
        if isinstance(answer, Answer) and answer.asked == RobotKind.STOP and answer.head.session == 0:
            if answer.result is not Result.ACCEPTED:
                raise DeviceFault(f"robot: the stop is refused ({answer.result.name}); use the emergency stop")
            return True
    return False
