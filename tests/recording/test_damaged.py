"""Cut, altered and foreign files are refused, or recovered with a count of what is missing; nothing else happens."""

import errno
import io
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.writer import Writer

from needleplan.errors import DataError, InputError, OutputError
from needleplan.recording import FORCE, STAGE, Field, Json, Packed, Recording, recover
from needleplan.recording import _journal as journal
from tests.recording.samples import SESSION, START_NS, force, write_run

FEW = settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    return write_run(tmp_path_factory.mktemp("whole") / "run.mcap", seconds=0.2).read_bytes()


@pytest.fixture(scope="module")
def partial(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """20 chunks of ten messages."""
    path = tmp_path_factory.mktemp("partial") / "run.mcap.partial"
    with path.open("wb") as stream:
        written = journal.Journal(stream.fileno(), SESSION)
        number = written.define("/force", FORCE)
        for sequence in range(1, 201):
            written.add(number, sequence, SESSION.wall_of(START_NS + sequence), FORCE.encode(force(sequence)))
            if sequence % 10 == 0:
                written.flush()
    return path.read_bytes()


def recovered(content: bytes, folder: Path) -> tuple[int, int, dict[str, int]]:
    """Return how many messages of /force are recovered, how many bytes are damaged, and what is missing."""
    source, target = folder / "source", folder / "target.mcap"
    source.write_bytes(content)
    target.unlink(missing_ok=True)
    found = recover(source, target)
    again = Recording.read(target)
    assert again.counts.get("/force", 0) == found.by_topic.get("/force", 0)
    assert [each.values["sequence"] for each in again.messages(["/force"])] == [
        each.sequence for each in again.messages(["/force"])
    ]
    return found.by_topic.get("/force", 0), found.damaged_bytes, dict(found.missing)


@pytest.mark.slow
def test_cut_anywhere_loses_only_the_last_chunk(partial: bytes, tmp_path: Path) -> None:
    assert recovered(partial, tmp_path) == (200, 0, {})
    ends = [each for each in range(0, len(partial), 97) if each > 6500]
    for end in ends:
        count, damaged, missing = recovered(partial[:end], tmp_path)
        assert count % 10 == 0
        assert not missing
        assert damaged < 2000


def test_a_damaged_chunk_is_counted_and_the_others_are_there(partial: bytes, tmp_path: Path) -> None:
    at = len(partial) // 2
    count, damaged, missing = recovered(partial[:at] + bytes([partial[at] ^ 8]) + partial[at + 1 :], tmp_path)
    assert (count, missing) == (190, {"/force": 10})
    assert 1000 < damaged < 2000


@pytest.mark.parametrize("title", ["", "a title " * 2000])
@pytest.mark.parametrize("seconds", [0.02, 0.2])
def test_a_short_finished_recording_is_recovered_wherever_one_byte_is_damaged(
    seconds: float, title: str, tmp_path: Path
) -> None:
    """The session stands in two chunks, so neither the first nor the last one may be damaged beyond recovery."""
    run = write_run(tmp_path / "run.mcap", seconds=seconds, session=replace(SESSION, title=title))
    content, every, lost = run.read_bytes(), Recording.read(run).counts["/stage"], 0
    for at in range(0, len(content), max(len(content) // 60, 1)):
        source, target = tmp_path / "source", tmp_path / "target.mcap"
        source.write_bytes(content[:at] + bytes([content[at] ^ 16]) + content[at + 1 :])
        found = recover(source, target, overwrite=True)
        assert Recording.read(target).session.title == title
        lost = max(lost, every - found.by_topic.get("/stage", 0))
    assert lost <= (every if title else every - 1)  # one chunk; beside a long session it may hold all samples


def test_the_last_count_tells_what_is_missing_at_the_end(partial: bytes, tmp_path: Path) -> None:
    """Also of a topic of which nothing was written; an altered count is not believed."""
    (tmp_path / "partial").write_bytes(partial)
    with (tmp_path / "partial").open("r+b") as stream:
        counts = journal.Counts({"/force": 6633, "/pose": 7}, {"/pose": 2}, SESSION.wall_of(START_NS + 10**9))
        head = partial.index(b"needleplan.counts") - 13
        stream.seek(head)
        stream.write(journal._counts_record(counts))
    content = (tmp_path / "partial").read_bytes()
    assert recovered(content, tmp_path) == (200, 0, {"/force": 6433, "/pose": 5})
    found = recover(tmp_path / "partial", tmp_path / "again.mcap")
    assert (found.counted_s, found.missing_s) == (1.0, pytest.approx(1.0, abs=1e-6))
    assert (found.overflowed, found.closed, found.complete) == ({"/pose": 2}, False, False)
    altered = content.replace(b'"/force": 6633', b'"/force": 6634')
    assert recovered(altered, tmp_path) == (200, 0, {})


def test_a_channel_that_is_repeated_under_another_number_is_not_believed(whole: bytes, tmp_path: Path) -> None:
    """The definitions at the end of a file stand outside of its chunks, where no checksum of their own is."""
    places = [at for at in range(len(whole)) if whole.startswith(b"/force", at)]
    changed = bytearray(whole)
    changed[places[-1] - 8] ^= 0x55  # the number of the channel: two bytes, then two of its schema, four of a length
    assert len(places) == 2  # the chunks are compressed; the counts at the start and the channel at the end are not
    source, target, untouched = tmp_path / "source", tmp_path / "target.mcap", tmp_path / "whole.mcap"
    source.write_bytes(changed)
    untouched.write_bytes(whole)
    found = recover(source, target)
    assert found.by_topic == Recording.read(target).counts == Recording.read(untouched).counts


def test_a_disk_that_is_full_in_the_middle_leaves_no_half_recovery(
    partial: bytes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also where it has room again for the rest."""
    source, target, calls = tmp_path / "source", tmp_path / "target.mcap", 0
    source.write_bytes(partial)
    add = Writer.add_message

    def fails_once(*arguments: Any, **more: Any) -> None:
        nonlocal calls
        calls += 1
        if calls == 100:
            raise OSError(errno.ENOSPC, "No space left on device")
        add(*arguments, **more)

    monkeypatch.setattr(Writer, "add_message", fails_once)
    with pytest.raises(OutputError, match="No space left"):
        recover(source, target)
    assert [each.name for each in tmp_path.iterdir()] == ["source"]


@FEW
@given(data=st.data())
def test_a_flipped_bit_never_alters_what_is_read(whole: bytes, data: st.DataObject, tmp_path: Path) -> None:
    at, bit = data.draw(st.integers(0, len(whole) - 1)), data.draw(st.integers(0, 7))
    path = tmp_path / "flipped.mcap"
    path.write_bytes(whole[:at] + bytes([whole[at] ^ (1 << bit)]) + whole[at + 1 :])
    with pytest.raises(DataError):
        Recording.read(path)


@FEW
@given(data=st.data())
def test_any_damage_is_recovered_or_refused(partial: bytes, data: st.DataObject, tmp_path: Path) -> None:
    content = bytearray(partial)
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, len(content) - 1))
        content[at : at + data.draw(st.integers(0, 300))] = data.draw(st.binary(max_size=300))
    try:
        count, damaged, missing = recovered(bytes(content), tmp_path)
    except DataError:
        return
    assert count <= 200
    assert damaged or count == 200 or missing or count % 10 == 0


@FEW
@given(content=st.binary(max_size=400), begins=st.booleans())
def test_foreign_bytes_are_refused(content: bytes, begins: bool, tmp_path: Path) -> None:
    path = tmp_path / "foreign"
    path.write_bytes(journal.MCAP0_MAGIC * begins + content)
    with pytest.raises(DataError):
        Recording.read(path)
    with pytest.raises(DataError):
        recover(path, tmp_path / "target.mcap")
    assert not (tmp_path / "target.mcap").exists()


def test_another_mcap_file_is_named_as_such(tmp_path: Path) -> None:
    stream = io.BytesIO()
    writer = Writer(stream)
    writer.start("ros2")
    writer.finish()
    path = tmp_path / "foreign.mcap"
    path.write_bytes(stream.getvalue())
    with pytest.raises(DataError, match=r"profile = ros2: .* another program"):
        Recording.read(path)


def test_recovering_does_not_overwrite(whole: bytes, tmp_path: Path) -> None:
    (tmp_path / "run.mcap").write_bytes(whole)
    with pytest.raises(OutputError, match="is there already"):
        recover(tmp_path / "run.mcap", tmp_path / "run.mcap")
    assert recover(tmp_path / "run.mcap", tmp_path / "new.mcap").complete


def test_a_missing_file_is_a_clear_message(tmp_path: Path) -> None:
    for read in (Recording.read, lambda path: recover(path, tmp_path / "target.mcap")):
        with pytest.raises(InputError, match="No such file"):
            read(tmp_path / "nowhere.mcap")


@given(st.binary(max_size=200))
def test_messages_of_any_bytes_are_decoded_or_refused(data: bytes) -> None:
    for kind in (FORCE, STAGE, Json("any")):
        try:
            assert isinstance(kind.decode(data), dict)
        except DataError:
            continue


TEXTS = st.text(st.characters(exclude_characters="\0", codec="utf-8"))
EVERY = Packed(
    "p/msg/Every",
    (
        Field("count", "uint64"),
        Field("x"),
        Field("code", "uint32"),
        Field("choice", "uint8", ("a", "b")),
        Field("flag", "bool"),
        Field("one", "string"),
        Field("two", "string", comment="the last"),
    ),
)


@given(
    st.fixed_dictionaries(
        {
            "count": st.integers(0, 2**64 - 1),
            "x": st.floats(allow_nan=False),
            "code": st.integers(0, 2**32 - 1),
            "choice": st.sampled_from(("a", "b")),
            "flag": st.booleans(),
            "one": TEXTS,
            "two": TEXTS,
        }
    )
)
def test_packed_messages_read_back(value: dict[str, object]) -> None:
    assert EVERY.decode(EVERY.encode(value)) == value
    assert Packed.from_schema(EVERY.name, EVERY.schema) == EVERY


def test_a_kind_in_another_order_is_refused() -> None:
    with pytest.raises(DataError, match="be ordered by size"):
        Packed("p/msg/Wrong", (Field("flag", "bool"), Field("x")))
    with pytest.raises(DataError, match="is not a type"):
        Packed("p/msg/Wrong", (Field("x", "float128"),))
