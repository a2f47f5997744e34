"""What is fixed in the lab: the rates of its sensors and the average of the force (thesis, appendix A)."""

from __future__ import annotations

__all__ = ["AVERAGED", "FORCE_HZ", "TRACKER_HZ"]

FORCE_HZ = 200
TRACKER_HZ = 40
AVERAGED = 5
"""Samples of the force that the sensor averages."""
