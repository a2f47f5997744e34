"""Configuration of an ATI sensor box, read by HTTP: the units of force and torque, and the counts per unit.

Units and factors depend on the active configuration of the box (for example a million counts per newton, or one count
per pound), so they are read at every start. An unknown unit or an impossible factor raises ConfigurationError.
"""

from __future__ import annotations

import math
import urllib.error
import urllib.request
from dataclasses import dataclass
from types import MappingProxyType
from xml.etree import ElementTree

from needleplan.artifacts import CallRepr
from needleplan.errors import ConfigurationError, DeviceFault, Mistake

__all__ = ["FORCE_UNITS", "TORQUE_UNITS", "Configuration", "fetch_configuration", "parse_configuration"]

_POUND_N = 0.453_592_37 * 9.806_65
_INCH_MM = 25.4

FORCE_UNITS = MappingProxyType({
    "N": 1.0, "kN": 1e3, "lbf": _POUND_N, "klbf": 1e3 * _POUND_N, "kgf": 9.806_65, "kg": 9.806_65,
})  # fmt: skip
"""Size in N of each unit of force, by the name that the box uses."""

TORQUE_UNITS = MappingProxyType({
    "N-mm": 1.0, "N-m": 1e3, "kN-m": 1e6, "lbf-in": _POUND_N * _INCH_MM, "lbf-ft": _POUND_N * 12 * _INCH_MM,
    "kgf-cm": 98.066_5, "kg-cm": 98.066_5, "kgf-mm": 9.806_65,
})  # fmt: skip
"""Size in N mm of each unit of torque, by name; the box also uses the names without hyphen, such as `Nmm`."""

_LONGEST = 1_000_000  # bytes of the configuration page that are read at most


@dataclass(frozen=True)
class Configuration(CallRepr):
    """Values of the page `netftapi2.xml` of the box: the factors and units that convert counts, and its identity."""

    counts_per_force: float
    counts_per_torque: float
    force_unit: str
    torque_unit: str
    product: str = ""
    serial: str = ""
    rate_hz: float | None = None
    measuring_hz: float = 7000.0
    """Rate (Hz) at which the box measures and counts `ft_sequence`."""

    bias: tuple[int, ...] | None = None
    """Bias of the six gages in counts, which changes with every bias command; None if the box does not report it."""

    @property
    def newton_per_count(self) -> float:
        """Force of one count, N."""
        return FORCE_UNITS[self.force_unit] / self.counts_per_force

    @property
    def newton_mm_per_count(self) -> float:
        """Torque of one count, N mm."""
        return TORQUE_UNITS[self.torque_unit] / self.counts_per_torque


def parse_configuration(xml: bytes, source: str = "") -> Configuration:
    """Return the configuration in `xml`, the page `netftapi2.xml`.

    Raises ConfigurationError with all missing and wrong values, or if `xml` is not plain XML.
    """
    if b"<!DOCTYPE" in xml or b"<!ENTITY" in xml:
        raise ConfigurationError("must be plain XML, without a document type", source)
    try:
        root = ElementTree.fromstring(xml)
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        raise ConfigurationError(f"is not XML: {error}", source) from error
    texts = {element.tag: (element.text or "").strip() for element in root.iter()}
    mistakes: list[Mistake] = []
    factors = [_factor(texts, key, mistakes) for key in ("cfgcpf", "cfgcpt")]
    units = [_unit(texts, key, known, mistakes) for key, known in (("scfgfu", FORCE_UNITS), ("scfgtu", TORQUE_UNITS))]
    if texts.get("comrdte", "Enabled").lower() not in ("enabled", "1"):
        mistakes.append(Mistake("comrdte", texts["comrdte"], "RDT must be enabled in the box"))
    if mistakes:
        raise ConfigurationError(mistakes, source)
    return Configuration(
        factors[0], factors[1], units[0], units[1],
        texts.get("prodname", ""), texts.get("setserial", ""), _number(texts.get("comrdtrate", "")),
        _measuring_hz(texts), _bias(texts.get("setbias", "")),
    )  # fmt: skip


def fetch_configuration(host: str, port: int = 80, slot: int | None = None, timeout_s: float = 2.0) -> Configuration:
    """Read the configuration `slot` (0 to 15) of the box at `host`; if `slot` is None, the active configuration.

    Raises DeviceFault if the page cannot be read, ConfigurationError if its values cannot be used.
    """
    name = f"[{host}]" if ":" in host else host
    url = f"http://{name}:{port}/netftapi2.xml" + ("" if slot is None else f"?index={slot}")
    try:
        # The box is in the local network, so a configured proxy must not be used.
        opener = urllib.request.build_opener(urllib.request.ProxyHandler({}))
        with opener.open(url, timeout=timeout_s) as answer:
            xml = answer.read(_LONGEST)
    except (OSError, ValueError, urllib.error.URLError) as error:
        reason = getattr(error, "reason", error)  # the cause of a URLError
        why = getattr(reason, "strerror", None) or reason
        raise DeviceFault(f"{url}: the configuration of the force sensor cannot be read: {why}") from error
    return parse_configuration(xml, url)


def _factor(texts: dict[str, str], key: str, mistakes: list[Mistake]) -> float:
    value = _number(texts.get(key, ""))
    if value is None or not value > 0:
        mistakes.append(Mistake(key, texts.get(key, ""), "must be a positive number: the counts per unit"))
        return math.nan
    return value


def _unit(texts: dict[str, str], key: str, known: MappingProxyType[str, float], mistakes: list[Mistake]) -> str:
    text = texts.get(key, "")
    for name in known:
        if text.replace("-", "").casefold() == name.replace("-", "").casefold():
            return name
    mistakes.append(Mistake(key, text, f"must be one of {', '.join(known)}"))
    return ""


def _measuring_hz(texts: dict[str, str]) -> float:
    """Return the rate of measurements: `runrate` of a Net F/T, `setrate` of an Ethernet Axia, else 7000 Hz."""
    rates = (_number(texts.get(key, "")) for key in ("runrate", "setrate"))
    return next((rate for rate in rates if rate is not None and rate > 0), Configuration.measuring_hz)


def _bias(text: str) -> tuple[int, ...] | None:
    try:
        values = tuple(int(number) for number in text.split(";"))
    except ValueError:
        return None
    return values if len(values) == 6 else None


def _number(text: str) -> float | None:
    try:
        value = float(text)
    except ValueError:
        return None
    return value if math.isfinite(value) else None
