"""Links by address."""

from __future__ import annotations

from collections.abc import Callable
from difflib import get_close_matches

from needleplan.devices.address import Address
from needleplan.devices.link import Link
from needleplan.devices.network import TcpLink, UdpLink
from needleplan.devices.serial_port import SerialLink
from needleplan.errors import AddressError, Mistake

__all__ = ["open_link"]


def open_link(address: str | Address, default_port: int | None = None) -> Link:
    """Open the link that an address names.

    `udp://host:port[?local_port=n]`, `tcp://host:port[?timeout_s=3]`, `serial:///dev/ttyUSB0[?baud=9600]`. Options that
    belong to the device, not to the link, must have been taken out. Raises AddressError where the address is wrong,
    DeviceFault where nothing can be opened there.
    """
    parsed = Address.parse(address) if isinstance(address, str) else address
    if parsed.scheme not in _OPENERS:
        close = get_close_matches(parsed.scheme, _OPENERS, n=1)
        hint = f'; did you mean "{close[0]}"?' if close else ""
        raise AddressError(Mistake("address", str(parsed), f"must begin with {', '.join(_OPENERS)}://{hint}"))
    return _OPENERS[parsed.scheme](parsed, default_port)


def _udp(address: Address, default_port: int | None) -> Link:
    address.only(("local_port",))
    host, port = address.network(default_port)
    local_port = address.option("local_port", int, 0)
    if not 0 <= local_port <= 65_535:
        raise AddressError(Mistake("local_port", str(local_port), "must be from 0 to 65535"), str(address))
    return UdpLink(host, port, local_port)


def _tcp(address: Address, default_port: int | None) -> Link:
    address.only(("timeout_s",))
    host, port = address.network(default_port)
    timeout_s = address.option("timeout_s", float, 3.0)
    if not 0 < timeout_s < 3600:
        raise AddressError(Mistake("timeout_s", str(timeout_s), "must be positive, less than an hour"), str(address))
    return TcpLink(host, port, timeout_s)


def _serial(address: Address, _: int | None) -> Link:
    address.only(("baud",))
    if address.host or address.port is not None or len(address.path) < 2:
        rule = "must name a port of this machine after three slashes: serial:///dev/ttyUSB0"
        raise AddressError(Mistake("address", str(address), rule))
    return SerialLink(address.path, address.option("baud", int, 9600))


_OPENERS: dict[str, Callable[[Address, int | None], Link]] = {"udp": _udp, "tcp": _tcp, "serial": _serial}
