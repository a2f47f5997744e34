"""The lab twin in real time, as processes that speak the bytes of real devices."""

from needleplan.simulation.processes.real_time import RealTimeLab

__all__ = ["RealTimeLab"]
