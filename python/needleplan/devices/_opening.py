"""Addresses of devices, and opening the link that an address names.

An address is `udp://host:port`, `tcp://host:port` or `serial:///dev/ttyUSB0?baud=9600`. Options follow the question
mark, as in `udp://192.168.1.1:49152?slot=2`. An unknown option is a mistake; the message names the known options.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from typing import TypeVar
from urllib.parse import parse_qsl, urlsplit

from needleplan.artifacts import CallRepr
from needleplan.config import Integer, Number, Rule, Violation, suggestion
from needleplan.devices._links import Link, SerialLink, TcpLink, UdpLink
from needleplan.errors import AddressError, Mistake

__all__ = ["BAUDS", "LAST_PORT", "Address", "open_link"]

LAST_PORT = 65_535
"""Largest number of a port."""

BAUDS = Integer(1, 10_000_000)
"""Rule for the speed of a serial line."""

_T = TypeVar("_T")


@dataclass(frozen=True)
class Address(CallRepr):
    """The parts of a device address.

    A network device has `host` and `port`; the path of a tracker address `igtl://` is the name of the tracked device. A
    serial port has only a `path`.
    """

    scheme: str
    host: str = ""
    port: int | None = None
    path: str = ""
    options: Mapping[str, str] = field(default_factory=dict)

    @classmethod
    def parse(cls, text: str) -> Address:
        """Return the parts of the address `text`. Raises AddressError with the violated rule."""
        try:
            parts = urlsplit(text.strip())
            port = parts.port
            pairs = parse_qsl(parts.query, keep_blank_values=True, strict_parsing=bool(parts.query))
        except ValueError as error:
            raise AddressError(Mistake("address", text, f"is not an address: {error}")) from error
        if not parts.scheme or "://" not in text:
            rule = "must begin with the kind of link, as in udp://192.168.1.1:49152 or serial:///dev/ttyUSB0"
            raise AddressError(Mistake("address", text, rule))
        if parts.fragment or parts.username is not None:
            raise AddressError(Mistake("address", text, "must have neither a user nor a part after #"))
        options = dict(pairs)
        if len(options) < len(pairs):
            raise AddressError(Mistake("address", text, "has an option twice"))
        return cls(parts.scheme, parts.hostname or "", port, parts.path, options)

    def network(self, default_port: int | None = None) -> tuple[str, int]:
        """Return host and port; the port is `default_port` if the address has none.

        Raises AddressError if the host or the port is missing, the port is not from 1 to 65535, or a path follows.
        """
        port = default_port if self.port is None else self.port
        if not self.host:
            raise AddressError(Mistake("address", str(self), f"must name a host: {self.scheme}://host:port"))
        if port is None or not 0 < port <= LAST_PORT:
            raise AddressError(
                Mistake("address", str(self), f"must name a port from 1 to 65535: {self.scheme}://host:port")
            )
        if self.path not in ("", "/"):
            raise AddressError(Mistake("address", str(self), "must not have a path after the port"))
        return self.host, port

    def option(self, name: str, rule: Rule, default: _T) -> _T:
        """Return an option of the address that a rule reads.

        Parameters
        ----------
        name : str
            Name of the option.
        rule : Integer, Number or Choice
            Rule for the value.
        default : object
            Result if the address has no such option.

        Returns
        -------
        object
            The value, or `default`.

        Raises
        ------
        AddressError
            The text of the option does not obey the rule.
        """
        if name not in self.options:
            return default
        text, kind = self.options[name], {Integer: int, Number: float}.get(type(rule), str)
        try:
            value: _T = rule.read(kind(text))
        except (ValueError, Violation):
            raise AddressError(Mistake(name, text, f"must be {rule}"), str(self)) from None
        return value

    def only(self, known: Collection[str]) -> None:
        """Raise AddressError, with the known options and a suggestion, if an option is not in `known`."""
        mistakes = []
        for name in self.options:
            if name not in known:
                hint = suggestion(name, known)
                rule = f"must be one of {', '.join(sorted(known))}{hint}" if known else "this address takes no options"
                mistakes.append(Mistake("option", name, rule))
        if mistakes:
            raise AddressError(mistakes, str(self))

    def __str__(self) -> str:
        host = f"[{self.host}]" if ":" in self.host else self.host
        port = "" if self.port is None else f":{self.port}"
        options = "&".join(f"{name}={value}" for name, value in self.options.items())
        return f"{self.scheme}://{host}{port}{self.path}{'?' if options else ''}{options}"


def open_link(address: str | Address, default_port: int | None = None) -> Link:
    """Open the link of an address.

    - `udp://host:port[?local_port=n]`: `local_port` is the receiving port of this machine, by default any free port.
    - `tcp://host:port[?timeout_s=3]`: `timeout_s` is the longest time (s) to connect, by default 3.
    - `serial:///dev/ttyUSB0[?baud=9600]`: `baud` is the speed of the line, by default 9600.

    Parameters
    ----------
    address : str or Address
        Address without the options that belong to the device.
    default_port : int, optional
        Port of an address without a port.

    Returns
    -------
    Link

    Raises
    ------
    AddressError
        The address is wrong.
    DeviceFault
        The link cannot be opened.
    """
    parsed = Address.parse(address) if isinstance(address, str) else address
    if parsed.scheme not in _OPENERS:
        hint = suggestion(parsed.scheme, _OPENERS)
        raise AddressError(Mistake("address", str(parsed), f"must begin with {', '.join(_OPENERS)}://{hint}"))
    return _OPENERS[parsed.scheme](parsed, default_port)


def _udp(address: Address, default_port: int | None) -> Link:
    address.only(("local_port",))
    host, port = address.network(default_port)
    return UdpLink(host, port, address.option("local_port", Integer(0, LAST_PORT), 0))


def _tcp(address: Address, default_port: int | None) -> Link:
    address.only(("timeout_s",))
    host, port = address.network(default_port)
    return TcpLink(host, port, address.option("timeout_s", Number("s", above=0, at_most=3600), 3.0))


def _serial(address: Address, _: int | None) -> Link:
    address.only(("baud",))
    if address.host or address.port is not None or len(address.path) < 2:
        rule = "must name a port of this machine after three slashes: serial:///dev/ttyUSB0"
        raise AddressError(Mistake("address", str(address), rule))
    return SerialLink(address.path, address.option("baud", BAUDS, 9600))


_OPENERS: dict[str, Callable[[Address, int | None], Link]] = {"udp": _udp, "tcp": _tcp, "serial": _serial}
