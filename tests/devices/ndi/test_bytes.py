import math

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from needleplan.devices.ndi.commands import ReplyReader, decode_command, encode_command, encode_text
from needleplan.devices.ndi.frames import (
    Frames,
    NdiVisibility,
    ToolFrame,
    crc16,
    encode_bx,
    encode_tx,
    parse_bx,
    parse_tx,
)
from needleplan.errors import ProtocolError

KNOWN = (
    "INIT:E3A5 OKAYA896 RESETBE6F VER:065EE GETINFO:Features.Firmware.Version0492 TSTART:5423 TSTOP:2C14 PHSR:0020FF "
    "PHSR:02E17E PHSR:0321BF COMM:500000048 COMM:000000084 BX:0001C26D BX:080100EC TX:0001031A TX:0801C19B APIREV:443E "
    "ERROR016BC2 ERROR046802"
)


def slow_crc16(data: bytes) -> int:
    """Bit by bit, as the polynomial is written: x^16 + x^15 + x^2 + 1, each byte with its lowest bit first."""
    register = 0
    for bit in (byte >> index & 1 for byte in data for index in range(8)):
        carry = (register >> 15 & 1) ^ bit
        register = register << 1 & 0xFFFF ^ (0x8005 if carry else 0)
    return int(f"{register:016b}"[::-1], 2)


def test_the_crc_of_the_catalogue() -> None:
    assert crc16(b"123456789") == 0xBB3D


@pytest.mark.parametrize("text", KNOWN.split())
def test_the_crcs_that_devices_were_seen_to_send(text: str) -> None:
    assert encode_text(text[:-4]) == text.encode() + b"\r"


@given(st.binary(max_size=100))
def test_the_table_is_the_polynomial(data: bytes) -> None:
    assert crc16(data) == slow_crc16(data)


@given(st.from_regex(r"[A-Z]{1,8}", fullmatch=True), st.from_regex(r"[0-9A-Z]{0,8}", fullmatch=True))
def test_commands_come_back(name: str, arguments: str) -> None:
    assert decode_command(encode_command(name, arguments)[:-1]) == (name, arguments)
    assert decode_command(f"{name} {arguments}".encode()) == (name, arguments)


@given(st.binary(max_size=40))
def test_any_line_is_a_command_or_a_protocol_error(line: bytes) -> None:
    try:
        name, _ = decode_command(line)
    except ProtocolError:
        return
    assert name.upper() == name


def test_a_reply_to_tx_written_by_hand() -> None:
    text = "020A+07071+00000-07071+00000+001234-056789+000001+001230000003100000ABC\n0BMISSING0000003100000ABC\n0000"
    frames = parse_tx(text)
    first, second = frames.tools
    assert first.quaternion == pytest.approx((0.7071, 0, -0.7071, 0))
    assert first.position_mm == pytest.approx((12.34, -567.89, 0.01))
    assert (first.error_mm, first.port_status, first.frame) == (pytest.approx(0.0123), 0x31, 0xABC)
    assert (second.handle, second.visibility, second.frame) == (0x0B, NdiVisibility.MISSING, 0xABC)
    assert encode_tx(frames) == text


def test_a_reply_to_bx_written_by_hand() -> None:
    body = bytes.fromhex(
        "02 0A 01 0000803F 00000000 00000000 00000000 00002041 0000A0C1 00000000 CDCCCC3D 31000000 BC0A0000"
        "0B 02 31000000 BC0A0000 0800"
    )
    header = b"\xc4\xa5" + bytes([len(body), 0])
    message = header + crc16(header).to_bytes(2, "little") + body + crc16(body).to_bytes(2, "little")
    frames = parse_bx(message)
    assert frames.tools[0].position_mm == (10, -20, 0)
    assert frames.tools[0].error_mm == pytest.approx(0.1)
    assert (frames.tools[1].visibility, frames.tools[1].frame, frames.system_status) == (
        NdiVisibility.MISSING,
        0xABC,
        8,
    )
    assert encode_bx(frames)[:-2] == message[:-2]
    assert crc16(message[:-2]) == crc16(body)


BYTE, WORD = st.integers(0, 255), st.integers(0, 2**32 - 1)
NUMBER = st.floats(-900, 900).map(lambda each: round(each, 2))
PART = st.floats(-1, 1).map(lambda each: round(each, 4))
TOOLS = st.one_of(
    st.builds(ToolFrame, BYTE, st.just(NdiVisibility.VALID), st.tuples(PART, PART, PART, PART),
              st.tuples(NUMBER, NUMBER, NUMBER), PART.map(abs), WORD, WORD),
    st.builds(ToolFrame, BYTE, st.just(NdiVisibility.MISSING), port_status=WORD, frame=WORD),
    st.builds(ToolFrame, BYTE, st.just(NdiVisibility.DISABLED)),
)  # fmt: skip
FRAMES = st.builds(Frames, st.lists(TOOLS, max_size=5).map(tuple), st.integers(0, 0xFFFF))


def close(one: Frames, other: Frames, tolerance: float) -> bool:
    def numbers(frames: Frames) -> list[float]:
        return [x for tool in frames.tools if tool.visibility is NdiVisibility.VALID
                for x in (*tool.quaternion, *tool.position_mm, tool.error_mm)]  # fmt: skip

    def rest(frames: Frames) -> list[tuple[object, ...]]:
        return [(tool.handle, tool.visibility, tool.port_status, tool.frame) for tool in frames.tools]

    same = rest(one) == rest(other) and one.system_status == other.system_status
    return same and all(
        math.isclose(a, b, abs_tol=tolerance) for a, b in zip(numbers(one), numbers(other), strict=True)
    )


@given(FRAMES)
def test_frames_come_back(frames: Frames) -> None:
    assert close(parse_tx(encode_tx(frames)), frames, 1e-9)
    assert close(parse_bx(encode_bx(frames)), frames, 1e-4)


@given(st.text(max_size=200))
@example("01")
@example("010AMISSING\n000")
@example("FF")
def test_any_text_is_frames_or_a_protocol_error(text: str) -> None:
    try:
        frames = parse_tx(text)
    except ProtocolError:
        return
    assert encode_tx(frames)[:2] == text[:2].upper()


@given(st.binary(max_size=200), st.booleans())
def test_any_bytes_are_frames_or_a_protocol_error(body: bytes, sealed: bool) -> None:
    header = b"\xc4\xa5" + len(body).to_bytes(2, "little")
    crcs = [crc16(each).to_bytes(2, "little") for each in (header, body)]
    try:
        frames = parse_bx(header + crcs[0] + body + crcs[1] if sealed else body)
    except ProtocolError:
        return
    assert len(frames.tools) == body[0]


REPLIES = st.one_of(st.sampled_from([b"OKAYA896\r", b"RESETBE6F\r"]), FRAMES.map(encode_bx),
                    FRAMES.map(lambda each: encode_text(encode_tx(each))))  # fmt: skip


@given(st.lists(REPLIES, max_size=6), st.lists(st.integers(1, 40), min_size=1, max_size=50))
def test_replies_are_whole_however_they_are_cut(replies: list[bytes], cuts: list[int]) -> None:
    stream, reader, found = b"".join(replies), ReplyReader(), []
    position, index = 0, 0
    while position < len(stream):
        step = cuts[index % len(cuts)]
        reader.feed(stream[position : position + step])
        position, index = position + step, index + 1
        found += list(iter(reader.next, None))
    whole = [each if isinstance(each, bytes) else encode_text(each) for each in found]
    assert whole == replies
    assert (reader.damaged, reader.pending) == (0, 0)


@given(st.binary(max_size=300), REPLIES)
@example(b"\xc4\xa5\xff\xff" + crc16(b"\xc4\xa5\xff\xff").to_bytes(2, "little"), b"OKAYA896\r")
@example(b"\xc4", b"OKAYA896\r")
def test_a_reply_behind_any_noise_is_found(noise: bytes, reply: bytes) -> None:
    """At the latest when the pieces of a reply that never ends have been given up."""
    reader = ReplyReader()
    reader.feed(noise)
    list(iter(reader.next, None))
    reader.clear()
    reader.feed(reply)
    found = list(iter(reader.next, None))
    assert [each if isinstance(each, bytes) else encode_text(each) for each in found] == [reply]


@given(FRAMES, st.data())
def test_a_reply_behind_the_first_part_of_another_is_found(frames: Frames, data: st.DataObject) -> None:
    first, second = encode_bx(frames), encode_bx(Frames(frames.tools, 1))
    reader = ReplyReader()
    reader.feed(first[: data.draw(st.integers(0, len(first) - 1))])
    assert reader.next() is None
    reader.feed(second)
    reader.feed(b"OKAYA896\r" * 40)
    assert second in list(iter(reader.next, None))


def test_text_without_end_does_not_pile_up() -> None:
    reader = ReplyReader()
    for _ in range(100):
        reader.feed(b"A" * 1000)
        assert reader.next() is None
    assert reader.pending <= 17_000
