from __future__ import annotations

import math
import struct
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from needleplan.devices.igtl.contents import (
    IgtlStatus,
    Point,
    Sensor,
    StatusCode,
    Unit,
    decode_points,
    decode_reply,
    decode_start,
    encode_points,
    encode_polyline,
    encode_sensor,
    encode_start,
    encode_status,
    encode_string,
)
from needleplan.devices.igtl.messages import IgtlMessage, MessageReader, crc64, encode_message, stamp_of
from needleplan.devices.igtl.poses import (
    IgtlPose,
    IgtlTool,
    ToolKind,
    decode_position,
    decode_qtdata,
    decode_tdata,
    decode_transform,
    encode_position,
    encode_qtdata,
    encode_tdata,
    encode_transform,
)
from needleplan.errors import InputError, ProtocolError
from tests.devices.igtl.decoding import decode_polyline, decode_sensor, decode_status, decode_string

singles = st.floats(-1e4, 1e4, width=32)
places = st.tuples(singles, singles, singles)
quaternions = (
    st.tuples(*[st.floats(-1, 1)] * 4)
    .filter(lambda q: math.hypot(*q) > 0.1)
    .map(lambda q: tuple(each / math.hypot(*q) for each in q))
)
poses = st.builds(IgtlPose, places, quaternions)
names = st.text(st.characters(min_codepoint=0x20, max_codepoint=0x7E), max_size=20)
NOISE = st.lists(st.integers(4, 255), max_size=70).map(bytes)  # nothing that a header could begin with
tools = st.builds(IgtlTool, names, poses, st.sampled_from(ToolKind))
texts = st.text(st.characters(exclude_characters="\0", exclude_categories=("Cs",)), max_size=30)
messages = st.builds(
    IgtlMessage,
    st.from_regex(r"[A-Z][A-Z0-9_]{0,11}", fullmatch=True),
    names,
    st.binary(max_size=300),
    st.integers(0, (1 << 64) - 1),
    st.just(2),
    st.integers(0, (1 << 32) - 1),
    st.dictionaries(texts, texts, max_size=4),
)


def slow_crc64(data: bytes) -> int:
    """Bit by bit, as the polynomial is written."""
    register = 0
    for bit in (byte >> index & 1 for byte in data for index in range(7, -1, -1)):
        carry = register >> 63 ^ bit
        register = (register << 1) % (1 << 64) ^ (0x42F0E1EBA9EA3693 if carry else 0)
    return register


def same(first: IgtlPose, second: IgtlPose) -> None:
    assert first.position_mm == pytest.approx(second.position_mm, rel=1e-6, abs=1e-6)
    assert abs(math.fsum(map(float.__mul__, first.quaternion, second.quaternion))) == pytest.approx(1, abs=1e-6)


def all_of(data: bytes, pieces: int = 1 << 16, **options: Any) -> tuple[list[IgtlMessage], MessageReader]:
    reader, found = MessageReader(**options), []
    for at in range(0, len(data), pieces):
        reader.feed(data[at : at + pieces])
        while (message := reader.next()) is not None:
            found.append(message)
    return found, reader


def test_the_crc_of_the_catalogue() -> None:
    assert crc64(b"123456789") == 0x6C40DF5F0B497347
    assert crc64(b"") == 0


@given(st.binary(max_size=1200))
def test_the_tables_are_the_polynomial(data: bytes) -> None:
    assert crc64(data) == slow_crc64(data)


def test_a_transform_written_by_hand() -> None:
    body = struct.pack(">12f", 0, 1, 0, -1, 0, 0, 0, 0, 1, 10.5, -20, 30)
    header = b"\0\1TRANSFORM\0\0\0" + b"Needle".ljust(20, b"\0") + bytes.fromhex("65530000 80000000 0000000000000030")
    data = header + crc64(body).to_bytes(8) + body
    ((message,), _) = all_of(data)
    assert (message.kind, message.device, message.time_s) == ("TRANSFORM", "Needle", 0x65530000 + 0.5)
    pose = decode_transform(message.content)
    assert pose.position_mm == (10.5, -20, 30)
    # A quarter of a turn about z.
    assert pose.quaternion == pytest.approx((math.sqrt(0.5), 0, 0, math.sqrt(0.5)))
    assert encode_message(message) == data


@given(messages)
def test_messages_come_back(message: IgtlMessage) -> None:
    assert all_of(encode_message(message))[0] == [message]


@given(st.lists(messages, min_size=1, max_size=4), st.integers(1, 80), NOISE)
def test_messages_come_back_in_pieces_and_behind_noise(sent: list[IgtlMessage], pieces: int, noise: bytes) -> None:
    data = b"".join(map(encode_message, sent))
    assert all_of(data, pieces)[0] == sent
    found, reader = all_of(noise + data, pieces)
    assert found == sent
    assert reader.damaged_bytes == len(noise)


@given(st.lists(messages, min_size=3, max_size=3), st.data())
def test_the_messages_around_a_damaged_one_are_found(sent: list[IgtlMessage], data: st.DataObject) -> None:
    first, second, third = map(encode_message, sent)
    at = data.draw(st.integers(58, len(second) - 1))
    bit = data.draw(st.sampled_from([1, 2, 4, 8, 16, 32, 64, 128]))
    damaged = second[:at] + bytes([second[at] ^ bit]) + second[at + 1 :]
    found, reader = all_of(first + damaged + third)
    assert found[0] == sent[0]
    assert found[-1] == sent[2] or reader.pending
    assert reader.damaged >= 1


@given(st.binary(max_size=600))
def test_any_bytes_are_read_without_an_error(data: bytes) -> None:
    found, reader = all_of(data)
    assert not found
    assert reader.pending + reader.damaged_bytes == len(data) or reader.skipped


@given(st.sampled_from(["TRANSFORM", "POSITION", "TDATA", "QTDATA", "STATUS", "STRING", "POINT", "POLYDATA", "SENSOR"]),
       st.binary(max_size=200))  # fmt: skip
def test_any_content_is_understood_or_a_protocol_error(kind: str, content: bytes) -> None:
    decode: dict[str, Any] = {
        "TRANSFORM": decode_transform, "POSITION": decode_position, "TDATA": decode_tdata, "QTDATA": decode_qtdata,
        "STATUS": decode_status, "STRING": decode_string, "POINT": decode_points, "POLYDATA": decode_polyline,
        "SENSOR": decode_sensor,
    }  # fmt: skip
    try:
        understood = decode[kind](content)
    except ProtocolError as error:
        assert kind in str(error)
    else:
        assert understood is not None


def test_a_length_that_nobody_has_is_neither_waited_for_nor_allocated() -> None:
    good = encode_message(IgtlMessage("TRANSFORM", "N", encode_transform(IgtlPose((1.0, 2.0, 3.0)))))
    absurd = good[:42] + b"\x7f" + b"\xff" * 7 + good[50:]
    for kind in (b"TRANSFORM\0\0\0", b"IMAGE\0\0\0\0\0\0\0"):
        found, reader = all_of(absurd[:2] + kind + absurd[14:] + good)
        assert len(found) == reader.damaged == 1
        assert reader.pending == 0


def test_what_is_not_wanted_is_passed_over_as_it_comes() -> None:
    image = encode_message(IgtlMessage("IMAGE", "Ultrasound", bytes(300_000)))
    good = IgtlMessage("TRANSFORM", "N", encode_transform(IgtlPose((1.0, 2.0, 3.0))))
    reader, most = MessageReader({"TRANSFORM"}), 0
    data = image + encode_message(good) + image
    found = []
    for at in range(0, len(data), 1000):
        reader.feed(data[at : at + 1000])
        found += [each for each in iter(reader.next, None) if each]
        most = max(most, reader.pending)
    assert found == [good]
    assert reader.skipped == 2
    assert most < 2000


@pytest.mark.parametrize("lengths", [(11, 0, 0), (12, 9, 0), (12, 0, 9), (13, 0, 0), (0xFFFF, 0xFFFF, 0xFFFFFFFF)])
def test_an_extended_header_that_lies_is_damage(lengths: tuple[int, int, int]) -> None:
    body = struct.pack(">HHII", *lengths, 0)
    header = struct.pack(">H12s20sQQQ", 2, b"STATUS", b"", 0, len(body), crc64(body))
    found, reader = all_of(header + body)
    assert not found
    assert reader.damaged == 1


def test_metadata_that_lie_are_damage() -> None:
    body = struct.pack(">HHIIHHHI", 12, 10, 1, 0, 1, 4, 3, 5) + b"x"
    header = struct.pack(">H12s20sQQQ", 2, b"STATUS", b"", 0, len(body), crc64(body))
    assert not all_of(header + body)[0]
    body = struct.pack(">HHIIH", 12, 2, 0, 0, 7)
    header = struct.pack(">H12s20sQQQ", 2, b"STATUS", b"", 0, len(body), crc64(body))
    assert not all_of(header + body)[0]


@given(poses)
def test_poses_come_back(pose: IgtlPose) -> None:
    for encode, decode, length in (
        (encode_transform, decode_transform, 48), (encode_position, decode_position, 28),
    ):  # fmt: skip
        data = encode(pose)
        assert len(data) == length
        same(decode(data), pose)
        assert decode(data).distortion < 1e-5


@given(st.lists(tools, max_size=4))
def test_tools_come_back(sent: list[IgtlTool]) -> None:
    for encode, decode, length in ((encode_tdata, decode_tdata, 70), (encode_qtdata, decode_qtdata, 50)):
        data = encode(sent)
        assert len(data) == length * len(sent)
        back = decode(data)
        assert [(each.name, each.kind) for each in back] == [(each.name, each.kind) for each in sent]
        for got, expected in zip(back, sent, strict=True):
            same(got.pose, expected.pose)


def test_shorter_positions() -> None:
    pose = IgtlPose((1.0, 2.0, 3.0), (0.8, 0.0, -0.6, 0.0))
    same(decode_position(encode_position(pose)[:24]), pose)
    assert not decode_position(encode_position(pose)[:12]).oriented


@pytest.mark.parametrize(
    "numbers",
    [(0,) * 12, (1, 0, 0, 0, 1, 0, 0, 0, -1, 0, 0, 0), (math.nan, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0), (1e30,) * 12],
)
def test_what_is_no_rotation_is_not_taken_for_one(numbers: tuple[float, ...]) -> None:
    assert math.isnan(decode_transform(struct.pack(">12f", *numbers)).distortion)


def test_a_rotation_that_is_a_little_off_says_how_much() -> None:
    scaled = [1.05 * each for each in (1, 0, 0, 0, 1, 0, 0, 0, 1)]
    pose = decode_transform(struct.pack(">12f", *scaled, 0, 0, 0))
    assert pose.distortion == pytest.approx(1.05**2 - 1, rel=1e-5)
    assert math.hypot(*pose.quaternion) == pytest.approx(1)
    assert decode_position(struct.pack(">7f", 0, 0, 0, 0, 0, 0, 1.2)).distortion == pytest.approx(0.2)


@given(st.builds(IgtlStatus, st.sampled_from(StatusCode), names, texts, st.integers(-(1 << 63), (1 << 63) - 1)))
def test_a_status_comes_back(status: IgtlStatus) -> None:
    assert decode_status(encode_status(status)) == status


@given(texts)
def test_a_string_comes_back(text: str) -> None:
    assert decode_string(encode_string(text)) == text


@given(st.lists(st.builds(Point, names, places, names, st.tuples(*[st.integers(0, 255)] * 4), singles, names)))
def test_points_come_back(points: list[Point]) -> None:
    assert list(decode_points(encode_points(points))) == points


@given(st.lists(places))
def test_a_line_comes_back(points: list[tuple[float, float, float]]) -> None:
    assert list(decode_polyline(encode_polyline(points))) == (points if len(points) > 1 else [])


@given(st.lists(st.floats(allow_nan=False), max_size=255), st.sampled_from(Unit))
def test_readings_come_back(values: list[float], unit: Unit) -> None:
    assert decode_sensor(encode_sensor(Sensor(tuple(values), unit))) == Sensor(tuple(values), unit)


def test_the_unit_of_the_example_in_the_specification() -> None:
    """Newton metre, bit for bit, with the exponents that the example forgets."""
    assert f"{Unit.NEWTON:064b}" == "0000" + "001011" + "0001" + "0" * 50
    assert f"{Unit.NEWTON_METRE:064b}" == "0000" + "001011" + "0001" + "000001" + "0001" + "0" * 40
    assert f"{Unit.NEWTON_MILLIMETRE:064b}"[:4] == f"{Unit.MILLIMETRE:064b}"[:4] == "1011"


def test_queries_come_back() -> None:
    assert decode_start(encode_start(50, "Camera")) == (50, "Camera")
    assert [decode_reply(each) for each in (b"", b"\0", b"\1")] == [True, True, False]
    with pytest.raises(ProtocolError):
        decode_reply(b"\0\0")


@pytest.mark.parametrize(
    ("make", "rule"),
    [
        (lambda: encode_message(IgtlMessage("TRANSFORM", "x" * 21)), "at most 20 bytes"),
        (lambda: encode_message(IgtlMessage("TRANSFORMTRANSFORM", "x")), "at most 12 bytes"),
        (lambda: encode_message(IgtlMessage("STRING", "x", metadata={"a": "b"})), "must be 2 for metadata"),
        (lambda: encode_string("x" * 70_000), "at most 65535"),
        (lambda: encode_sensor(Sensor((0.0,) * 256)), "at most 255"),
        (lambda: encode_start(-1), "must be from 0"),
    ],
)
def test_what_has_no_place_in_a_message_is_refused(make: Any, rule: str) -> None:
    with pytest.raises(InputError, match=rule):
        make()


def test_times_keep_their_microseconds() -> None:
    message = IgtlMessage("STATUS", "", timestamp=stamp_of(1_700_000_000.000_025))
    assert message.time_s == pytest.approx(1_700_000_000.000_025, abs=1e-6)
    assert IgtlMessage("STATUS", "").time_s is None


def test_a_header_of_version_3_with_a_longer_extended_header_is_read() -> None:
    extended = struct.pack(">HHII", 16, 2 + 2 * 8, 15, 77) + b"NEW!"
    index = struct.pack(">HHHIHHI", 2, 4, 3, 2, 3, 106, 6)
    body = extended + struct.pack(">HH", 3, 2) + b"hi" + index + b"unitmm" + b"who" + "Zoë??".encode()[:6]
    head = struct.pack(">H12s20sQQQ", 3, b"STRING", b"Console", 5 << 32, len(body), crc64(body))
    reader = MessageReader()
    reader.feed(head + body)
    message = reader.next()
    assert message is not None
    assert (message.version, message.message_id, message.time_s) == (3, 77, 5.0)
    assert decode_string(message.content) == "hi"
    assert message.metadata == {"unit": "mm", "who": "Zoë??"}
