"""`needleplan recording` as a user runs it."""

from __future__ import annotations

import io
import json
from pathlib import Path

import pytest
from mcap.reader import make_reader

from needleplan.recording import read_records
from tests.cli.commands import needleplan, program, refused
from tests.recording.samples import write_run


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
    assert done.returncode == int(found["damaged_bytes"] > 0)
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
        for force in ((), ("--force",)):
            done = needleplan("recording", "export", run, "--to", to, "-o", target, *force)
            refused(done, "is a recording", "never overwritten")
    assert run.read_bytes() == before
