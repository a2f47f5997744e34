"""Columns in blocks, bounded recoveries, and recordings of runs that are killed at once."""

import struct
import time
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zstandard

from needleplan.cli import main
from needleplan.errors import DataError
from needleplan.recording import (
    EVENT,
    Field,
    Packed,
    Recorder,
    Recording,
    Session,
    WhenFull,
    _recorder,
    _recording,
    recover,
)
from needleplan.recording.mcap_bytes import MCAP0_MAGIC, Damage, chunks

EVERY = Packed(
    "needleplan_msgs/msg/Every",
    (Field("i", "int64"), Field("q", "uint64"), Field("d"), Field("s", "int32"), Field("u", "uint32"),
     Field("health", "uint8", ("good", "suspect", "missing")), Field("b", "uint8"), Field("moving", "bool"),
     Field("notes", "string"), Field("more", "string")),
)  # fmt: skip


def values(number: int, largest: int) -> dict[str, Any]:
    return {
        "i": -number, "q": largest - number, "d": 0.5 * number, "s": -number, "u": number, "b": number % 256,
        "health": ("good", "suspect")[number % 2], "moving": number % 3 == 0,
        "notes": "" if number % 7 else f"{number} \u00b5m", "more": "x" * (number % 3),
    }  # fmt: skip


def recorded(path: Path, numbers: list[int], largest: int = 2**40) -> Recording:
    """Record a message for each number, whose time it is, among other messages."""
    with Recorder(path, Session("columns"), when_full=WhenFull.WAIT) as recorder:
        channel, event = recorder.channel("/every", EVERY), recorder.channel("/event", EVENT)
        for number in numbers:
            time_ns = recorder.session.monotonic_ns + 1000 * number
            assert channel.put(time_ns, values(number, largest))
            assert event.put(time_ns, {"name": "x", "cause": "", "text": ""})
    return Recording.read(path)


@pytest.mark.parametrize("largest", [2**40, 2**64 - 1])
def test_columns_in_blocks_are_those_of_the_messages(
    largest: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(_recording, "_BLOCK_MESSAGES", 100)
    numbers = [*range(700), 300, 250, *range(700, 1000)]  # not in the order of their times, and two twice
    recording = recorded(tmp_path / "run.mcap", numbers, largest)
    columns, messages = recording.columns("/every"), list(recording.messages(["/every"]))
    assert list(columns) == ["time_s", *messages[0].values]
    expected = np.array([each.time_ns - recording.start_ns for each in messages]) * 1e-9
    assert np.array_equal(columns.pop("time_s"), expected)
    for name, column in columns.items():
        plain = np.array([each.values[name] for each in messages])
        assert column.dtype.kind == plain.dtype.kind
        assert np.array_equal(column, plain), name


def test_what_a_block_cannot_hold_is_damaged() -> None:
    data = EVERY.encode(values(1, 5))
    for wrong, why in (
        (data[:20], "cut off"), (b"\0\0" + data[2:], "little-endian"), (data[:-1], "cut off"),
        (data[: EVERY._numbers.size - 3] + b"\x03" + data[EVERY._numbers.size - 2 :], "health is 3"),
    ):  # fmt: skip
        with pytest.raises(DataError, match=why):
            EVERY.decode_block([data, wrong])


def test_a_recording_that_changes_after_it_was_opened_is_refused(tmp_path: Path) -> None:
    recording = recorded(tmp_path / "run.mcap", list(range(300)))
    raw = bytearray(recording.path.read_bytes())
    raw[len(raw) // 4 : len(raw) // 2] = bytes(len(raw) // 2 - len(raw) // 4)
    recording.path.write_bytes(raw)
    with pytest.raises(DataError, match="is damaged"):
        recording.columns("/every")


def bomb(content: bytes) -> bytes:
    """Return a chunk that expands to `content`."""
    stored = zstandard.ZstdCompressor(level=19).compress(content)
    body = struct.pack("<QQQII", 0, 0, len(content), zlib.crc32(content), 4) + b"zstd"
    body += struct.pack("<Q", len(stored)) + stored
    return struct.pack("<BQ", 0x06, len(body)) + body


@pytest.mark.parametrize("record", [b"\0" * 9, struct.pack("<BQ", 0x05, 22) + bytes(22)])
def test_a_small_file_of_bombs_is_read_in_bounded_time(record: bytes) -> None:
    """320 kB that expand to gigabytes: what is unpacked is bounded by the size of the file."""
    chunk = bomb(record * (2**24 // len(record)))
    data = MCAP0_MAGIC + chunk * (320_000 // len(chunk))
    damage = Damage()
    sizes = [len(content) for content in chunks(data, damage)]
    assert sum(sizes) <= 2**22 + 64 * len(data)
    assert damage.damaged_bytes > len(data) / 2


def test_a_file_of_bombs_is_no_recording(tmp_path: Path) -> None:
    file = tmp_path / "bomb.mcap"
    chunk = bomb(bytes(2**24))
    file.write_bytes(MCAP0_MAGIC + chunk * (320_000 // len(chunk)))
    began_s = time.process_time()
    with pytest.raises(DataError, match="not a recording"):
        recover(file, tmp_path / "new.mcap")
    assert time.process_time() - began_s < 5.0  # without a bound: 20 s


def test_a_run_that_is_killed_at_once_can_be_recovered(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(_recorder, "_PERIOD_S", 3600.0)  # the writer thread does not come to write
    recorder = Recorder(tmp_path / "run.mcap", Session("killed"))
    copy = tmp_path / "copy.mcap.partial"
    copy.write_bytes(recorder.partial.read_bytes())
    recorder.close()
    assert main(["recording", "recover", str(copy), "-o", str(tmp_path / "again.mcap")]) == 0
    assert "was not closed" in capsys.readouterr().err
    assert Recording.read(tmp_path / "again.mcap").session.title == "killed"


def test_damaged_bytes_without_a_missing_message_are_told_and_are_no_failure(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = recorded(tmp_path / "run.mcap", list(range(300))).path
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(path.read_bytes()[:-300])
    assert main(["recording", "recover", str(cut), "-o", str(tmp_path / "again.mcap")]) == 0
    told = capsys.readouterr().err
    assert "bytes at 1 places are damaged" in told
    assert "missing" not in told.replace("how many are missing", "").replace("later ones are missing", "")
    assert Recording.read(tmp_path / "again.mcap").counts["/every"] == 300
