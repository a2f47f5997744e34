"""Frames of a serial line, and doubles for compilers without them: Python, the C header and the Rust crate agree."""

import math
import random
import struct
import subprocess
from pathlib import Path

from hypothesis import given
from hypothesis import strategies as st

from needleplan.devices.robot._frames import Unframer, framed
from tests.devices.robot.test_bytes import compiled
from tests.pages import ROOT

BYTES = st.binary(max_size=112) | st.lists(st.sampled_from([0, 1, 255]), max_size=112).map(bytes)
SINGLES = r"""
#include <stdio.h>
#include "needleplan_robot.h"
int main(void) {
    uint8_t field[8];
    while (fread(field, 8, 1, stdin) == 1) {
        float value = npl_single(field);
        fwrite(&value, 4, 1, stdout);
    }
    return 0;
}
"""


@given(st.lists(st.tuples(st.integers(0, 255), BYTES), max_size=3), st.binary(max_size=300), st.integers(1, 50))
def test_frames_come_back_after_noise_in_any_pieces(all_of: list[tuple[int, bytes]], noise: bytes, piece: int) -> None:
    frames = [framed(*each) for each in all_of]
    assert all(0 not in frame[1:-1] and len(frame) == len(each[1]) + 5
               for frame, each in zip(frames, all_of, strict=True))  # fmt: skip
    line, unframer = noise + b"".join(frames), Unframer()
    found = [each for at in range(0, len(line), piece) for each in unframer.take(line[at : at + piece])]
    assert found[len(found) - len(all_of) :] == all_of


def test_what_is_no_frame_is_counted() -> None:
    unframer = Unframer()
    assert list(unframer.take(b"\0\0\0\2\5\0\3\5\5\0" + b"\1" * 500 + b"\0\3\5\xfa\0")) == [(5, b"")]
    assert unframer.damaged == 3


def test_the_c_header_finds_the_same_frames(tmp_path: Path) -> None:
    drawn = random.Random(1)
    line = bytearray()
    for _ in range(3000):
        datagram = bytes(drawn.choices(range(256), [256] + [1] * 255, k=drawn.randrange(113)))
        frame = framed(drawn.randrange(256), datagram)
        cut = drawn.choice([len(frame)] * 4 + [drawn.randrange(len(frame))])
        line += frame[:cut] + drawn.choice([b"", b"", drawn.randbytes(drawn.randrange(200))])
    source = (ROOT / "rust/guard/tests/c/unframe.c").read_text()
    done = subprocess.run([compiled(source, tmp_path)], input=line, capture_output=True, check=True, timeout=60)
    found = [each for each in Unframer().take(line) if each[1]]
    assert 1500 < len(found) < 2900
    assert done.stdout == b"".join(framed(*each) for each in found)


def test_the_c_header_reads_doubles_without_doubles(tmp_path: Path) -> None:
    drawn = random.Random(2)
    doubles = [struct.unpack("<d", drawn.randbytes(8))[0] for _ in range(5000)]
    doubles += [drawn.uniform(-300, 300) for _ in range(5000)]
    doubles += [0.0, -0.0, 1.0, -150.25, math.inf, -math.inf, math.nan, 3.5e38, -1e300, 2.0**-126, 1e-39, 5e-324]
    written = struct.pack(f"<{len(doubles)}d", *doubles)
    done = subprocess.run([compiled(SINGLES, tmp_path)], input=written, capture_output=True, check=True, timeout=60)
    for double, single in zip(doubles, struct.unpack(f"<{len(doubles)}f", done.stdout), strict=True):
        if math.isnan(double):
            assert math.isnan(single)
        elif abs(double) >= 2.0**128:
            assert single == math.copysign(math.inf, double)
        elif abs(double) < 2.0**-126:
            assert single == 0.0
        else:
            assert 0 <= (double - single) * math.copysign(1, double) < 2.0**-23 * abs(double)
