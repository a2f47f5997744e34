"""Simulated devices as processes of their own: what they measure comes over a local socket, and no more."""

from needleplan.devices.processes.feeds import FeedReader, FeedSender, feed_pair
from needleplan.devices.processes.part import Failed, Ready, Served, call_at_end, place_or_tell, tell
from needleplan.devices.processes.places import LabAddresses, LabPlaces, TrackerLine
from needleplan.devices.processes.sensors import TOOL, serve_force, serve_tracker

__all__ = [
    "TOOL",
    "Failed",
    "FeedReader",
    "FeedSender",
    "LabAddresses",
    "LabPlaces",
    "Ready",
    "Served",
    "TrackerLine",
    "call_at_end",
    "feed_pair",
    "place_or_tell",
    "serve_force",
    "serve_tracker",
    "tell",
]
