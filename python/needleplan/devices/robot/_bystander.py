"""A stop by a bystander, who does not control the robot."""

from __future__ import annotations

from collections.abc import Callable, Collection

from needleplan.bystander import WITHIN_S, StopOutcome, stop
from needleplan.devices._opening import Address
from needleplan.devices.robot.messages import ROBOT_PORT
from needleplan.errors import AddressError, DeviceFault, Mistake

__all__ = ["robot_place", "stop_robot"]


def robot_place(address: str, known: Collection[str] | None = None) -> tuple[Address, tuple[str, int]]:
    """Return the parts, and host and port, of `udp://host[:5005]`; `known` are the options that it may have.

    Raises AddressError.
    """
    parsed = Address.parse(address)
    if parsed.scheme != "udp":
        raise AddressError(Mistake("address", address, "a robot is reached by udp://host"))
    if known is not None:
        parsed.only(known)
    return parsed, parsed.network(ROBOT_PORT)


def stop_robot(
    address: str, within_s: float = WITHIN_S, on_alarm: Callable[[StopOutcome], object] | None = None
) -> StopOutcome:
    """Stop the robot at `udp://host[:5005]` without taking control, until the needle is measured at rest.

    The stop is sent again every 10 ms. `on_alarm` gets the present outcome once if the needle still moves, and once if
    the robot reports no position. The stop needs no key. If the robot has a controller, the robot enters FAULT, and the
    run of the controller ends. Raises AddressError if the address is wrong, DeviceFault if the needle is not measured
    at rest within `within_s`.
    """
    parsed, (host, port) = robot_place(address)
    try:
        outcome = stop(host, port, within_s, on_alarm)
    except (OSError, UnicodeError) as error:
        raise AddressError(Mistake("host", host, "is not a host that this machine can find")) from error
    if not outcome.is_confirmed:
        raise DeviceFault(outcome.why_not(f"udp://{parsed.host}:{port}"))
    return outcome
