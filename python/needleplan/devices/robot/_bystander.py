"""A stop by a bystander, who does not control the robot."""

from __future__ import annotations

from collections.abc import Callable

from needleplan.bystander import WITHIN_S, StopOutcome, stop
from needleplan.devices.robot._way import open_way
from needleplan.errors import AddressError, DeviceFault, Mistake

__all__ = ["stop_robot"]


def stop_robot(
    address: str, within_s: float = WITHIN_S, on_alarm: Callable[[StopOutcome], object] | None = None
) -> StopOutcome:
    """Stop the robot at `udp://host[:5005]` or `serial:///dev/ttyUSB0[?baud=460800]`, without taking control.

    Returns when the needle is measured at rest. A serial line is shared with the program that controls the robot.

    The stop is sent again every 10 ms. `on_alarm` gets the present outcome once if the needle still moves, and once if
    the robot reports no position. The stop needs no key. If the robot has a controller, the robot enters FAULT, and the
    run of the controller ends. Raises AddressError if the address is wrong, DeviceFault if the needle is not measured
    at rest within `within_s`.
    """
    with open_way(address, shared=True) as way:
        try:
            outcome = stop(way.host, way.port, within_s, on_alarm)
        except (OSError, UnicodeError) as error:
            raise AddressError(Mistake("host", way.host, "is not a host that this machine can find")) from error
        if not outcome.is_confirmed:
            name = f"serial://{way.address.path}" if way.address.scheme == "serial" else f"udp://{way.host}:{way.port}"
            raise DeviceFault("; ".join(filter(None, (outcome.why_not(name), way.hint))))
    return outcome
