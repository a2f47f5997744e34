"""ATI Net F/T and Ethernet Axia force sensors (RDT over UDP, configuration by HTTP), and a simulated sensor box."""

from needleplan.devices.ati._configuration import Configuration, fetch_configuration, parse_configuration
from needleplan.devices.ati._sensor import ForceLimits, NetFt
from needleplan.devices.ati._simulator import BoxFaults, BoxSettings, NetFtBox, NetFtServer

__all__ = [
    "BoxFaults",
    "BoxSettings",
    "Configuration",
    "ForceLimits",
    "NetFt",
    "NetFtBox",
    "NetFtServer",
    "fetch_configuration",
    "parse_configuration",
]
