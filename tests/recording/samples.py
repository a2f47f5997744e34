"""Samples as devices make them, and recordings of them."""

import time
from pathlib import Path

import numpy as np

from needleplan.devices import ForceSample, Health, PoseSample, StageSample, Stamp
from needleplan.recording import EVENT, FORCE, POSE, STAGE, Recorder, Session, WhenFull

START_NS = 5_000_000_000
SESSION = Session(
    "run",
    {"table": "sha256:ab"},
    {"run.toml": "a = 1\n"},
    (0.0, 0.0, -1.0),
    START_NS,
    1_700_000_000_000_000_000,
    "test",
)


def force(number: int, time_ns: int = 0, newton: float = 0.5) -> ForceSample:
    return ForceSample(Stamp(time_ns, number, 0, number / 200), (0.1, 0.2, -newton), (1.0, 2.0, 3.0))


def pose(number: int, time_ns: int, x_mm: float, health: Health = Health.GOOD) -> PoseSample:
    return PoseSample(Stamp(time_ns, number), (x_mm, 1.0, 2.0), (1.0, 0.0, 0.0, 0.0), 0.1, health, ("a", "b"))


def stage(number: int, time_ns: int, depth_mm: float) -> StageSample:
    return StageSample(Stamp(time_ns, number), depth_mm, 5.0, 0.25, True)


def write_run(path: Path, seconds: float = 2.0, session: Session = SESSION) -> Path:
    """Record an insertion at 5 mm/s: stage at 1,000 Hz, force at 200 Hz, tracker at 40 Hz, two events."""
    with Recorder(path, session, when_full=WhenFull.WAIT) as recorder:
        channels = {topic: recorder.channel(topic, kind) for topic, kind in
                    (("/stage", STAGE), ("/force", FORCE), ("/tracker", POSE), ("/events", EVENT))}  # fmt: skip
        channels["/events"].put(START_NS, {"name": "start", "cause": "operator", "text": ""})
        for number in range(round(1000 * seconds)):
            now_ns, depth_mm = START_NS + 1_000_000 * number, 0.005 * number
            channels["/stage"].put(now_ns, stage(number, now_ns, depth_mm))
            if number % 5 == 0:
                channels["/force"].put(now_ns, force(number, now_ns, 0.1 * depth_mm))
            if number % 25 == 0:
                channels["/tracker"].put(now_ns, pose(number, now_ns, depth_mm))
        channels["/events"].put(now_ns, {"name": "end", "cause": "depth", "value": np.float64("nan")})
    assert recorder.status.ok, recorder.status
    return path


def wait_for(condition: object, seconds: float = 90.0) -> None:
    """Give another thread or process time until a condition holds."""
    assert callable(condition)
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "it did not happen"
        time.sleep(0.002)
