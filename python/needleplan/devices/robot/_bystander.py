"""A stop by a bystander, who does not control the robot."""

from __future__ import annotations

from collections.abc import Callable

from needleplan.bystander import WITHIN_S, stop
from needleplan.devices._opening import Address
from needleplan.devices.robot.messages import ROBOT_PORT
from needleplan.errors import AddressError, DeviceFault, Mistake

__all__ = ["stop_robot"]


def stop_robot(address: str, within_s: float = WITHIN_S, on_silence: Callable[[], object] | None = None) -> float:
    """Stop the robot at `udp://host[:5005]` without taking control, and return the time (s) until its answer.

    The stop is sent again every 10 ms until the robot answers, and `on_silence` is called once after 1 s without an
    answer. The stop needs no key. If the robot has a controller, the robot enters FAULT, and the run of the controller
    ends. Raises AddressError if the address is wrong, DeviceFault if the robot does not confirm the stop within
    `within_s`.
    """
    parsed = Address.parse(address)
    if parsed.scheme != "udp":
        raise AddressError(Mistake("address", address, "a robot is reached by udp://host"))
    host, port = parsed.network(ROBOT_PORT)
    try:
        outcome = stop(host, port, within_s, on_silence)
    except (OSError, UnicodeError) as error:
        raise AddressError(Mistake("host", host, "is not a host that this machine can find")) from error
    if not outcome.is_confirmed:
        raise DeviceFault(outcome.why_not(f"udp://{parsed.host}:{port}"))
    return outcome.took_s
