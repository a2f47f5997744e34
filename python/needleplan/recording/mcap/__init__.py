"""Recordings of a run: written while it goes on, recovered where it was killed, read back, exported."""

from needleplan.recording.mcap.kinds import EVENT, FORCE, POSE, STAGE, STATUS, Field, Json, Kind, Packed
from needleplan.recording.mcap.recorder import Channel, Recorder, RecorderState, RecorderStatus, WhenFull
from needleplan.recording.mcap.recording import Message, Recording
from needleplan.recording.mcap.recovery import Recovery, recover
from needleplan.recording.mcap.session import Session

__all__ = [
    "EVENT",
    "FORCE",
    "POSE",
    "STAGE",
    "STATUS",
    "Channel",
    "Field",
    "Json",
    "Kind",
    "Message",
    "Packed",
    "Recorder",
    "RecorderState",
    "RecorderStatus",
    "Recording",
    "Recovery",
    "Session",
    "WhenFull",
    "recover",
]
