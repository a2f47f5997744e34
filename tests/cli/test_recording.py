"""`needleplan recording` as a user runs it."""

import io
import json
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader

from needleplan.recording import FORCE, Recovery, _recorder, read_records
from needleplan.recording._journal import Counts, Journal
from tests.cli.commands import needleplan, program, refused
from tests.control.scenes import small_table
from tests.recording.samples import SESSION, START_NS, force, write_run


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_run(tmp_path_factory.mktemp("run") / "run.mcap")


def test_info(run: Path) -> None:
    found = json.loads(needleplan("recording", "info", run, "--json").stdout)
    assert found["topics"]["/stage"] == {"messages": 2000, "kind": "needleplan_msgs/msg/Stage"}
    assert (found["digests"], found["files"], found["recovery"]) == ({"table": "sha256:ab"}, ["run.toml"], None)
    told = needleplan("recording", "info", run, "--verbose").stdout
    assert told.startswith(needleplan("recording", "info", run).stdout)
    assert "closed by its recorder" in told
    assert "2,000 messages" in told
    events = needleplan("recording", "info", run, "--events").stdout.splitlines()
    assert [line.split() for line in events] == [["0.000", "s", "start", "operator"], ["1.999", "s", "end", "depth"]]


def test_a_cut_recording_is_refused_and_recovered(run: Path, tmp_path: Path) -> None:
    cut, again = tmp_path / "cut.mcap", tmp_path / "again.mcap"
    cut.write_bytes(run.read_bytes()[:-500])
    refused(needleplan("recording", "info", cut), "was not finished, or is cut", "needleplan recording recover")
    done = program("recording", "recover", cut, "-o", again, "--json")
    found = json.loads(done.stdout)
    assert found["by_topic"]["/stage"] == 2000
    assert done.returncode == 0
    assert found["missing"] == {}
    assert "recovered" in needleplan("recording", "info", again).stdout
    refused(needleplan("recording", "recover", cut, "-o", again), "again.mcap: exists already; --force overwrites it")
    assert needleplan("recording", "recover", cut, "-o", again, "--force").returncode == done.returncode


@pytest.mark.parametrize("place", [0, 1, -1])
def test_what_is_known_to_be_missing_is_told(place: int, tmp_path: Path) -> None:
    content = bytearray(write_run(tmp_path / "long.mcap", seconds=4).read_bytes())
    summary = make_reader(io.BytesIO(content)).get_summary()
    assert summary is not None
    chunk = sorted(summary.chunk_indexes, key=lambda each: each.chunk_start_offset)[place]
    content[chunk.chunk_start_offset + chunk.chunk_length // 2] ^= 1
    damaged = tmp_path / "damaged.mcap"
    damaged.write_bytes(content)
    refused(needleplan("recording", "info", damaged), "checksums do not agree")
    done = needleplan("recording", "recover", damaged, "-o", tmp_path / "again.mcap")
    assert done.returncode == 1
    assert "bytes at 1 places are damaged" in done.stderr
    told = json.loads(needleplan("recording", "info", tmp_path / "again.mcap", "--json").stdout)
    assert 2000 < told["topics"]["/stage"]["messages"] < 4000
    assert int(told["recovery"]["damaged_bytes"]) > 0


def test_export(run: Path, tmp_path: Path) -> None:
    done = needleplan("recording", "export", run, "--to", "csv", "-o", tmp_path / "run.csv")
    assert (done.returncode, done.stdout) == (0, "")
    assert "interpolated from" in done.stderr
    assert len(read_records(tmp_path / "run.csv")[0]) == 396
    refused(needleplan("recording", "export", run, "--to", "csv", "-o", tmp_path / "no" / "x.csv"), "cannot be written")


@pytest.mark.parametrize("to", ["csv", "hdf5"])
def test_an_export_never_replaces_a_recording(to: str, run: Path, tmp_path: Path) -> None:
    before = run.read_bytes()
    other = write_run(tmp_path / "other.mcap")
    (tmp_path / "link").symlink_to(run)
    for target in (run, other, tmp_path / "link"):
        for option in ((), ("--force",)):
            done = needleplan("recording", "export", run, "--to", to, "-o", target, *option)
            refused(done, "is a recording", "never overwritten")
    assert run.read_bytes() == before


@pytest.mark.slow
@pytest.mark.parametrize(
    "command",
    [("insert", "table.h5", "--start=0,39,85", "-o", "run.mcap"), ("simulate", "insertion", "-o", "run.mcap")],
    ids=lambda command: command[0],
)
def test_wrote_names_the_file_that_is_there(
    command: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    small_table().write(tmp_path / "table.h5")
    run, finish = tmp_path / "run.mcap", _recorder.finish

    def another_program_is_faster(*arguments: Any, **options: Any) -> Recovery:
        run.write_bytes(b"precious")
        return finish(*arguments, **options)

    monkeypatch.setattr(_recorder, "finish", another_program_is_faster)
    done = needleplan(*command, cwd=tmp_path)
    assert done.returncode != 0
    assert "wrote run.mcap\n" not in done.stderr
    assert "run.mcap.partial: the recording is incomplete: run.mcap: is there already" in done.stderr
    assert run.read_bytes() == b"precious"
    assert needleplan("recording", "recover", f"{run}.partial", "-o", tmp_path / "new.mcap").returncode == 0


def test_the_number_of_missing_messages_is_true(tmp_path: Path) -> None:
    """After a kill while the disk was full: the recorder counts in place, for which a full disk has room."""
    partial = tmp_path / "run.mcap.partial"
    with partial.open("wb") as stream:
        journal = Journal(stream.fileno(), SESSION)
        number = journal.define("/force", FORCE)
        for sequence in range(1, 101):
            journal.add(number, sequence, SESSION.wall_of(START_NS + sequence), FORCE.encode(force(sequence)))
        journal.flush()
        journal.count(Counts({"/force": 6533}, {}, SESSION.wall_of(START_NS + 32 * 10**9)))
    done = needleplan("recording", "recover", partial, "-o", tmp_path / "run.mcap")
    assert done.returncode == 1
    assert "its recorder counted the messages up to 32.000 s: later ones are missing and not counted" in done.stderr
    assert "6,433 messages of /force are missing; nothing was recovered of the last 32.000 s" in done.stderr
    assert "damaged" not in done.stderr
