"""ATI Net F/T and Ethernet Axia force sensors: RDT over UDP, configuration over HTTP, and a box that speaks both."""

from needleplan.devices.ati.configuration import Configuration, fetch_configuration, parse_configuration
from needleplan.devices.ati.in_process import BoxLink
from needleplan.devices.ati.limits import ForceLimits
from needleplan.devices.ati.sensor import NetFt
from needleplan.devices.ati.simulator import BoxFaults, BoxSettings, NetFtBox, NetFtServer

__all__ = [
    "BoxFaults",
    "BoxLink",
    "BoxSettings",
    "Configuration",
    "ForceLimits",
    "NetFt",
    "NetFtBox",
    "NetFtServer",
    "fetch_configuration",
    "parse_configuration",
]
