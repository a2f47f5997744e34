import hashlib
import math
import shutil
import struct
import subprocess
import zlib
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from needleplan.devices.robot import RobotMachine, SteadyDrive
from needleplan.devices.robot.messages import (
    OLDEST_VERSION,
    VERSION,
    Answer,
    Fault,
    Head,
    Hello,
    MotionLimits,
    NotAuthentic,
    OtherVersion,
    Result,
    RobotCommand,
    RobotKind,
    RobotMessage,
    RobotState,
    RobotStatus,
    Seal,
    decode,
    encode,
)
from needleplan.errors import ProtocolError
from tests.pages import ROOT

U16, U32, U64 = (st.integers(0, 2**bits - 1) for bits in (16, 32, 64))
REAL = st.floats(allow_nan=False)
HEADS = st.builds(Head, U32, U32, U64, U64, U32, U32)
OLD_HEADS = st.builds(Head, U32, U32, U64, U64, U32, U32, st.just(OLDEST_VERSION))
KINDS = st.sampled_from([kind for kind in RobotKind if kind < 0x80 and kind is not RobotKind.HELLO])
COMMANDS = st.builds(RobotCommand, HEADS, KINDS, U64, REAL, REAL, U32)
HELLOS = st.builds(Hello, HEADS, st.builds(MotionLimits, REAL, REAL, REAL, REAL, REAL, U32), U32)
ANSWERS = st.builds(Answer, HEADS, st.integers(0, 255), st.sampled_from(Result), st.sampled_from(RobotState), U64)
FIELDS = (REAL, REAL, REAL, REAL, U32.map(Fault), st.sampled_from(RobotState), st.booleans(), U16, U32)
STATUSES = st.builds(RobotStatus, HEADS, *FIELDS, st.booleans(), st.booleans())
OLD_STATUSES = st.builds(RobotStatus, OLD_HEADS, *FIELDS)
SINGLE = st.floats(allow_nan=False, width=32)
COMPACT = st.builds(RobotStatus, HEADS, *[SINGLE] * 4, *FIELDS[4:], st.booleans(), st.booleans(), st.just(True))
MESSAGES = HELLOS | COMMANDS | ANSWERS | STATUSES | OLD_STATUSES | COMPACT
COMMAND = RobotCommand(
    Head(0x01020304, 5, 6_000_000_007, 8, 9, 10),
    RobotKind.INSERT,
    11_000_000_012,
    target=20.5,
    speed=5.25,
    silence_us=30_000,
)
LIMITS = (-10.0, 120.0, 8.0, 7.0, 6.0)
HELLO = Hello(Head(7, 1, 2, number=1), MotionLimits(*LIMITS, 500_000), 30_000)
HEADER = ROOT / "docs/reference/needleplan_robot.h"


SEAL = Seal(bytes(range(32)), 5)


def sealed(begin: bytes) -> bytes:
    return begin + struct.pack("<I", zlib.crc32(begin))


def test_the_bytes_of_the_reference() -> None:
    begin = bytes.fromhex(
        "4e504c52 03 03 4800 04030201 05000000 07bca06501000000 0800000000000000 09000000 0a000000"
        "0caea68f02000000 0000000000803440 0000000000001540 30750000"
    )
    assert encode(COMMAND) == sealed(begin)
    answer = Answer(Head(1, 2, 3, 4, 5, 6), RobotKind.STOP, Result.BUSY, RobotState.FAULT)
    assert encode(answer)[40:52] == bytes.fromhex("0000000000000000 05 03 0100")
    assert encode(HELLO)[40:92] == struct.pack("<5d3I", *LIMITS, 30_000, 500_000, 0)
    assert [len(encode(each)) for each in (COMMAND, answer, HELLO)] == [72, 56, 96]


@given(MESSAGES)
def test_messages_come_back(message: RobotMessage) -> None:
    assert decode(encode(message)) == message


@given(st.binary(max_size=200) | st.binary(max_size=200).map(lambda rest: sealed(b"NPLR" + rest)))
@example(b"")
@example(sealed(b"NPLR\x02\x03"))
@example(sealed(b"NPLR\x02\x77" + bytes(60)))
def test_any_datagram_is_a_message_or_a_protocol_error(datagram: bytes) -> None:
    try:
        message = decode(datagram)
    except ProtocolError:
        return
    assert encode(message) == datagram
    assert decode(encode(message, SEAL)) == message


@given(MESSAGES, st.data())
def test_any_changed_bit_is_noticed(message: RobotMessage, data: st.DataObject) -> None:
    raw = bytearray(encode(message))
    bit = data.draw(st.integers(0, 8 * len(raw) - 1))
    raw[bit // 8] ^= 1 << bit % 8
    with pytest.raises(ProtocolError):
        decode(bytes(raw))


@given(MESSAGES)
def test_a_tag_is_that_of_one_key_and_one_nonce(message: RobotMessage) -> None:
    raw = encode(message, SEAL)
    assert decode(raw, SEAL) == message
    for other in (Seal(SEAL.key, 6), Seal(bytes(32), SEAL.nonce)):
        with pytest.raises(NotAuthentic):
            decode(raw, other)
    with pytest.raises(NotAuthentic):
        decode(encode(message), SEAL)


def test_the_tag_is_half_of_an_hmac_sha256_of_nonce_and_datagram() -> None:
    """As an independent implementation computes it: SHA-256 of the padded key, twice (RFC 2104)."""
    raw, pad = encode(COMMAND, SEAL), SEAL.key.ljust(64, b"\0")
    inner = hashlib.sha256(bytes(each ^ 0x36 for each in pad) + struct.pack("<Q", 5) + raw[:-20]).digest()
    outer = hashlib.sha256(bytes(each ^ 0x5C for each in pad) + inner).digest()
    assert raw[-20:-4] == outer[:16]
    assert struct.unpack_from("<H", raw, 6)[0] == len(raw) == 88


def test_a_short_key_is_refused() -> None:
    with pytest.raises(ProtocolError, match="at least 16 bytes"):
        Seal(b"secret")


@given(MESSAGES, st.integers(0, 87))
def test_any_cut_datagram_is_noticed(message: RobotMessage, length: int) -> None:
    raw = encode(message)
    if length < len(raw):
        with pytest.raises(ProtocolError):
            decode(raw[:length])


@given(STATUSES | OLD_STATUSES, st.integers(8, 255), st.integers(4, 255))
def test_values_that_mean_nothing_are_noticed(status: RobotStatus, flags: int, state: int) -> None:
    raw = bytearray(encode(status)[:-4])
    for offset, value in ((77, flags), (76, state), *([(77, 2)] if status.homed is None else [])):
        wrong = bytearray(raw)
        wrong[offset] = value
        with pytest.raises(ProtocolError):
            decode(sealed(bytes(wrong)))


def test_the_bits_of_a_status() -> None:
    status = RobotStatus(Head(1, 2, 3), 1.0, 0.0, 0.0, 0.0, Fault(0), RobotState.ENABLED, False, 0, 0, True, False)
    assert encode(status)[77] == 2
    assert encode(replace(status, moving=True, homed=False, standing=True))[77] == 5
    assert encode(replace(status, head=replace(status.head, version=OLDEST_VERSION)))[77] == 0


def test_the_older_version_has_no_home() -> None:
    command = RobotCommand(Head(1, 2, 3, version=OLDEST_VERSION), RobotKind.HOME)
    with pytest.raises(ProtocolError, match="HOME is not a kind of datagram of version 2"):
        decode(encode(command))


def test_another_version_is_named_whatever_its_length() -> None:
    for length in (0, 3, 500):
        with pytest.raises(OtherVersion, match="speaks version 9"):
            decode(sealed(b"NPLR\x09\x01" + bytes(length)))


def test_what_does_not_fit_is_not_sent() -> None:
    with pytest.raises(ProtocolError, match="HELLO cannot be sent"):
        encode(Hello(Head(2**32, 0, 0)))
    status = RobotStatus(Head(1, 2, 3), 1e39, 0.0, 0.0, 0.0, Fault(0), RobotState.ENABLED, False, compact=True)
    with pytest.raises(ProtocolError, match="COMPACT cannot be sent"):
        encode(status)


@settings(max_examples=50)
@given(st.lists(st.tuples(MESSAGES.map(encode) | st.binary(max_size=100), st.integers(0, 10**8)), max_size=40))
def test_no_datagram_stops_the_machine_or_moves_what_is_not_enabled(story: list[tuple[bytes, int]]) -> None:
    """Random datagrams seldom hit the one session: what moves must have been greeted and enabled in order."""
    machine, now_ns = RobotMachine(SteadyDrive()), 0
    for datagram, passed_ns in story:
        now_ns += passed_ns
        answer = machine.receive(datagram, ("a", 1), now_ns)
        if answer:
            assert isinstance(decode(answer), Answer)
        sent = machine.tick(now_ns)
        if sent is not None:
            status = decode(sent[0])
            assert isinstance(status, RobotStatus)
            assert status.state is RobotState.ENABLED or not status.moving


PROGRAM = r"""
#include <stdio.h>
#include <stddef.h>
#include "needleplan_robot.h"

int main(void) {
    uint8_t buffer[256];
    npl_command command = {0};
    npl_begin(&command.head, NPL_INSERT, sizeof command);
    command.head.session = 0x01020304; command.head.sequence = 5; command.head.sent_ns = 6000000007ull;
    command.head.echo_ns = 8; command.head.held_us = 9; command.head.number = 10;
    command.deadline_ns = 11000000012ull; command.target = 20.5; command.speed = 5.25; command.silence_us = 30000;
    npl_seal(&command, sizeof command);
    fwrite(&command, sizeof command, 1, stdout);

    npl_hello hello = {0};
    npl_begin(&hello.head, NPL_HELLO, sizeof hello);
    hello.head.session = 7; hello.head.sequence = 1; hello.head.sent_ns = 2; hello.head.number = 1;
    hello.least_mm = -10; hello.most_mm = 120; hello.speed_mm_s = 8; hello.roll_rad = 7; hello.rotation_rad_s = 6;
    hello.silence_us = 30000; hello.valid_us = 500000;
    npl_seal(&hello, sizeof hello);
    fwrite(&hello, sizeof hello, 1, stdout);

    uint8_t tagged[NPL_MOST], tag[NPL_TAG];
    for (int at = 0; at < NPL_TAG; ++at) tag[at] = (uint8_t)at;
    fwrite(tagged, npl_seal_tagged(&command, sizeof command, tag, tagged), 1, stdout);

    size_t length = fread(buffer, 1, sizeof buffer, stdin);
    npl_status status;
    if (npl_check(buffer, length, NPL_STATUS, sizeof status)) return 1;
    memcpy(&status, buffer, sizeof status);
    buffer[50] ^= 1;
    if (!npl_check(buffer, length, NPL_STATUS, sizeof status)) return 2;
    fprintf(stderr, "%u %u %llu %.17g %.17g %.17g %.17g %u %u %u %u %u", status.head.session, status.head.sequence,
            (unsigned long long)status.head.sent_ns, status.depth_mm, status.velocity_mm_s, status.roll_rad,
            status.velocity_rad_s, status.faults, status.state, status.flags, status.overruns, status.missed);
    return 0;
}
"""
SIZES = r"""
#include <stdio.h>
#include <stddef.h>
#include "needleplan_robot.h"
#define P(t, f) printf("%zu ", offsetof(t, f))
int main(void) {
    printf("%zu %zu %zu %zu ", sizeof(npl_head), sizeof(npl_command), sizeof(npl_answer), sizeof(npl_status));
    printf("%zu ", sizeof(npl_hello));
    P(npl_hello, least_mm); P(npl_hello, silence_us); P(npl_hello, valid_us); P(npl_hello, crc); P(npl_answer, nonce);
    P(npl_head, size); P(npl_head, session); P(npl_head, sent_ns); P(npl_head, held_us); P(npl_head, number);
    P(npl_command, deadline_ns); P(npl_command, silence_us); P(npl_command, crc);
    P(npl_answer, asked); P(npl_answer, state); P(npl_answer, result); P(npl_answer, crc);
    P(npl_status, depth_mm); P(npl_status, faults); P(npl_status, state); P(npl_status, flags);
    P(npl_status, overruns); P(npl_status, missed); P(npl_status, crc);
    printf("%zu ", sizeof(npl_compact));
    P(npl_compact, depth_mm); P(npl_compact, velocity_rad_s); P(npl_compact, faults); P(npl_compact, state);
    P(npl_compact, flags); P(npl_compact, overruns); P(npl_compact, missed); P(npl_compact, crc);
    return 0;
}
"""


def compiled(source: str, folder: Path) -> str:
    if shutil.which("gcc") is None:
        pytest.skip("no C compiler here")
    (folder / "program.c").write_text(source)
    command = ["gcc", "-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", f"-I{HEADER.parent}", "program.c"]
    subprocess.run(command, cwd=folder, check=True, timeout=60)
    return str(folder / "a.out")


def test_the_c_header_makes_a_command_that_is_ours_and_reads_our_status(tmp_path: Path) -> None:
    status = RobotStatus(
        Head(7, 8, 9_000_000_001), 12.345678901234567, -5.5, math.pi, 0.25, Fault.WATCHDOG | Fault.LIMIT,
        RobotState.FAULT, True, 513, 70_000, True, False,
    )  # fmt: skip
    done = subprocess.run([compiled(PROGRAM, tmp_path)], input=encode(status), capture_output=True, timeout=60)
    assert done.returncode == 0
    plain, hello, tagged = done.stdout[:72], done.stdout[72:168], done.stdout[168:]
    assert plain == encode(COMMAND)
    assert decode(plain) == COMMAND
    assert hello == encode(HELLO)
    assert decode(tagged) == COMMAND
    assert tagged[68:84] == bytes(range(16))
    assert done.stderr.decode() == "7 8 9000000001 12.345678901234567 -5.5 3.1415926535897931 0.25 17 3 3 513 70000"


def test_sizes_and_offsets_of_the_c_header_are_those_of_the_reference(tmp_path: Path) -> None:
    done = subprocess.run([compiled(SIZES, tmp_path)], capture_output=True, text=True, check=True, timeout=60)
    expected = "40 72 56 88  96 40 80 84 92 40  6 8 16 32 36  40 64 68  48 49 50 52  40 72 76 77 78 80 84"
    expected += " 72  40 52 56 60 61 62 64 68"
    assert done.stdout.split() == expected.split()


def test_the_c_header_has_the_codes_of_every_enumeration() -> None:
    text = HEADER.read_text()
    named = {
        **{f"NPL_{kind.name}": int(kind) for kind in RobotKind},
        **{f"NPL_RESULT_{result.name}": int(result) for result in Result},
        **{f"NPL_STATE_{state.name}": int(state) for state in RobotState},
        **{f"NPL_FAULT_{fault.name}": int(fault) for fault in Fault},
        "NPL_VERSION": VERSION,
    }
    for name, value in named.items():
        assert any(line.split()[:2] == [name, "="] and int(line.split()[2].rstrip(","), 0) == value
                   for line in text.splitlines() if "=" in line), name  # fmt: skip
