"""Curvatures as NDARRAY and the tip in images as POINT, over a link in this process."""

from __future__ import annotations

import math
import struct
import time
from pathlib import Path

import numpy as np
import pytest

from needleplan.cli import main
from needleplan.devices import FibreSample, Health, ImageSample, Link
from needleplan.devices.igtl import IgtlPoseLimits, NeedleSensor, _needle_sensors, open_fibre, open_images
from needleplan.devices.igtl.contents import Point, decode_array, encode_array, encode_points
from needleplan.devices.igtl.messages import IgtlMessage, encode_message, stamp_of
from needleplan.errors import ConfigurationError, DeviceFault, LinkClosed, ProtocolError

CURVATURES = np.array([[0.01, 0.0], [0.005, math.nan], [0.0, -0.002]])
NOW_S = 1.7e9
REAL = ("--robot", "udp://r", "--force-sensor", "udp://f", "--tracker", "igtl://t/N")


def test_an_array_is_read_in_its_shape_and_type() -> None:
    assert decode_array(encode_array(CURVATURES)).tolist() == pytest.approx(CURVATURES, nan_ok=True)
    # By hand: type, number of dimensions, sizes, then the numbers, row by row, all big-endian.
    assert decode_array(b"\x0a\x02\x00\x02\x00\x01" + struct.pack(">2f", 1.5, -2)).tolist() == [[1.5], [-2.0]]
    assert decode_array(b"\x04\x01\x00\x03" + struct.pack(">3h", 1, -2, 300)).tolist() == [1, -2, 300]
    assert decode_array(b"\x0b\x01\x00\x00").shape == (0,)


@pytest.mark.parametrize(
    "content",
    [b"", b"\x0b", b"\x0b\x01", b"\x0d\x01\x00\x00", b"\x01\x01\x00\x01a", encode_array(CURVATURES)[:-1],
     encode_array(CURVATURES) + b"a", b"\x0b\x04" + b"\xff" * 8, b"\x0b\xff" + b"\xff" * 8, b"\x0b\xff" + bytes(510)],
)  # fmt: skip
def test_what_is_no_array_is_refused(content: bytes) -> None:
    with pytest.raises(ProtocolError, match="NDARRAY"):
        decode_array(content)


class Served(Link):
    """A connection to a server in this process."""

    def __init__(self) -> None:
        self.waiting: list[bytes] = []

    def send(self, data: bytes) -> None:
        raise AssertionError(data)

    def receive(self, timeout_s: float) -> bytes:
        if not self.waiting:
            time.sleep(timeout_s)
        return self.waiting.pop(0) if self.waiting else b""

    def close(self) -> None:
        self.waiting.clear()


@pytest.fixture
def served(monkeypatch: pytest.MonkeyPatch) -> Served:
    """The connection that is opened next."""
    server = Served()
    monkeypatch.setattr(_needle_sensors, "open_named", lambda _: server)
    return server


def send(server: Served, kind: str, content: bytes, number: int, name: str = "Needle") -> None:
    server.waiting.append(encode_message(IgtlMessage(kind, name, content, stamp_of(NOW_S + 0.01 * number))))


def read(sensor: NeedleSensor) -> FibreSample | ImageSample:
    sample = sensor.read(0.5)
    assert sample is not None
    return sample


def test_curvatures_become_samples(served: Served) -> None:
    send(served, "NDARRAY", encode_array(CURVATURES + 1), 0, "Another")
    for number in (1, 1, 2):
        send(served, "NDARRAY", encode_array(CURVATURES), number)
    with open_fibre("igtl://plus/Needle", 3) as sensor:
        for number in range(2):  # the repeated message is none
            sample = read(sensor)
            assert isinstance(sample, FibreSample)
            assert np.array(sample.curvatures_per_mm) == pytest.approx(CURVATURES, nan_ok=True)
            assert (sample.stamp.sequence, sample.health) == (number, Health.GOOD)
        send(served, "NDARRAY", encode_array(CURVATURES[:2]), 3)
        for _ in range(2):  # a fault stays
            with pytest.raises(DeviceFault, match=r"shape \(2, 2\) instead of \(3, 2\)"):
                sensor.read(0.5)
    with pytest.raises(LinkClosed):
        sensor.read(0.0)


def test_points_become_samples(served: Served) -> None:
    for number, points in enumerate(([Point("tip", (3.0, -4.0, 0.0))], [], [Point("tip", (math.nan, 0.0, 0.0))])):
        send(served, "POINT", encode_points(points), number)
    with open_images("igtl://plus/Needle") as sensor:
        seen = [read(sensor) for _ in range(3)]
        assert all(isinstance(sample, ImageSample) for sample in seen)
        assert [sample.health for sample in seen] == [Health.GOOD, Health.MISSING, Health.MISSING]
        assert isinstance(seen[0], ImageSample)
        assert (seen[0].u_mm, seen[0].v_mm) == (3.0, -4.0)
        send(served, "POINT", encode_points([Point("a", (0, 0, 0)), Point("b", (0, 0, 0))]), 9)
        with pytest.raises(DeviceFault, match="2 points instead of the tip alone"):
            sensor.read(0.5)


def test_silence_and_a_time_that_goes_back_are_faults(served: Served, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(_needle_sensors, "IgtlPoseLimits", lambda: IgtlPoseLimits(start_s=0.05, silence_s=0.05))
    with pytest.raises(ConfigurationError, match="NDARRAY that the server sends"):
        open_fibre("igtl://plus/Needle", 3)
    send(served, "NDARRAY", encode_array(CURVATURES), 1)
    with open_fibre("igtl://plus/Needle", 3) as sensor:
        read(sensor)
        with pytest.raises(DeviceFault, match="no new NDARRAY"):
            sensor.read(0.06)
    for number in (1, 0):
        send(served, "NDARRAY", encode_array(CURVATURES), number)
    with open_fibre("igtl://plus/Needle", 3) as sensor:
        read(sensor)
        with pytest.raises(DeviceFault, match=r"Needle: its time went back by 0\.01 s"):
            sensor.read(0.5)


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("--fibre", "igtl://plus/N", "--sensors", "10,35"), "a simulation has its own [fibre]"),
        ((*REAL, "--sensors", "10,35"), "--sensors = 10,35: needs --fibre"),
        ((*REAL, "--images", "igtl://plus/N"), "needs --image-plane"),
    ],
)
def test_an_insertion_refuses_sensors_that_it_cannot_use(
    words: tuple[str, ...], told: str, table_file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["insert", str(table_file), *words]) == 2
    assert told in capsys.readouterr().err
