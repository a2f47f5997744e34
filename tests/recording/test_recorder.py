"""The recorder never delays or breaks the loop that feeds it, and loses next to nothing when it is killed."""

import errno
import math
import os
import signal
import subprocess
import sys
import threading
from itertools import pairwise
from pathlib import Path

import pytest

from needleplan.errors import DataError, OutputError
from needleplan.recording import EVENT, FORCE, Recorder, RecorderState, Recording, WhenFull, recover
from needleplan.recording import _journal as journal
from tests.recording.samples import SESSION, START_NS, force, wait_for, write_run

DISK = os.write
KILLED = Path(__file__).with_name("killed.py")


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "run.mcap"


def test_a_run_reads_back(path: Path) -> None:
    recording = Recording.read(write_run(path))
    assert recording.session == SESSION
    assert recording.counts == {"/recorder": 2, "/stage": 2000, "/force": 400, "/tracker": 80, "/events": 2}
    assert (recording.start_ns, recording.duration_s) == (START_NS, pytest.approx(1.999))
    assert recording.recovery is None
    messages = list(recording.messages())
    assert len(messages) == 2484
    assert all(one.time_ns <= two.time_ns for one, two in pairwise(messages))
    found = next(each for each in messages if each.topic == "/force" and each.sequence == 11)
    assert found.values["force_z_n"] == -0.1 * 0.25
    assert (found.values["received_ns"], found.values["sequence"], found.values["health"]) == (
        START_NS + 5 * 10**7,
        50,
        "good",
    )
    tracked = next(recording.messages(["/tracker"])).values
    assert (tracked["notes"], tracked["qw"]) == ("a; b", 1.0)
    assert math.isnan(tracked["device_time_s"])
    assert [each.values["name"] for each in recording.messages(["/events"])] == ["start", "end"]
    assert not path.with_name("run.mcap.partial").exists()


def test_a_slow_disk_does_not_delay_the_loop(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    free = threading.Event()
    recorder = Recorder(path, SESSION, capacity=50)
    channel = recorder.channel("/force", FORCE)

    def slow(descriptor: int, data: memoryview) -> int:
        free.wait(20)
        return DISK(descriptor, data)

    monkeypatch.setattr(journal.os, "write", slow)
    channel.put(START_NS, force(0))
    wait_for(lambda: recorder.status.queued == 0)
    kept = sum(channel.put(START_NS + number, force(number)) for number in range(1, 101))
    assert kept == 50
    assert recorder.status.overflowed == {"/force": 50}
    wait_for(lambda: recorder.status.behind_s > 0.1)
    assert not recorder.status.ok
    free.set()
    status = recorder.close()
    assert (status.state, status.overflowed) == (RecorderState.CLOSED, {"/force": 50})
    recording = Recording.read(path)
    assert recording.counts["/force"] == 51
    last = list(recording.messages(["/recorder"]))[-1].values
    assert (last["state"], last["overflowed"]) == ("closed", {"/force": 50})


def test_a_full_disk_is_a_status_and_recording_goes_on_when_there_is_room(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    full = threading.Event()

    def disk(descriptor: int, data: memoryview) -> int:
        if full.is_set():
            if os.fstat(descriptor).st_size > size:
                raise OSError(errno.ENOSPC, "No space left on device")
            data = data[:40]  # some of the chunk still fits, the rest does not
        return DISK(descriptor, data)

    with Recorder(path, SESSION) as recorder:
        channel = recorder.channel("/force", FORCE)
        channel.put(START_NS, force(0))
        wait_for(lambda: recorder.status.written == 2)
        size = recorder.partial.stat().st_size
        monkeypatch.setattr(journal.os, "write", disk)
        full.set()
        channel.put(START_NS + 1, force(1))
        wait_for(lambda: recorder.status.state is RecorderState.STALLED)
        assert recorder.status.cause == "No space left on device"
        assert recorder.partial.stat().st_size == size
        assert channel.put(START_NS + 2, force(2))
        full.clear()
        wait_for(lambda: recorder.status.state is RecorderState.RECORDING)
    assert Recording.read(path).counts["/force"] == 3


def test_a_disk_that_stays_full_leaves_the_partial_file(path: Path) -> None:
    """With the limit of the operating system on the size of files, which is as real as a full disk."""
    script = f"""
import resource, sys
sys.path[:0] = {sys.path!r}
from needleplan.recording import Recorder, FORCE
from tests.recording.samples import SESSION, force, wait_for
recorder = Recorder(sys.argv[1], SESSION)
channel = recorder.channel("/force", FORCE)
resource.setrlimit(resource.RLIMIT_FSIZE, (50_000, resource.getrlimit(resource.RLIMIT_FSIZE)[1]))
number = 0
while recorder.status.state == "recording":
    number += 1
    channel.put(number, force(number))
    wait_for(lambda: recorder.status.queued < 200 or recorder.status.state != "recording")
status = recorder.close()
print(status.state, status.cause)
print(channel.count, recorder.file)
"""
    done = subprocess.run(
        [sys.executable, "-B", "-c", script, str(path)], capture_output=True, text=True, timeout=60, check=False
    )
    assert done.stdout.startswith("failed File too large"), done.stdout + done.stderr
    partial = path.with_name("run.mcap.partial")
    put, file = done.stdout.splitlines()[1].split()
    assert (Path(file), path.exists()) == (partial, False)
    found = recover(partial, path)
    assert found.by_topic["/force"] > 100
    assert found.missing == {"/force": int(put) - found.by_topic["/force"]}
    assert found.missing["/force"] > 0
    assert found.missing_s == pytest.approx(found.missing["/force"] * 1e-9)
    assert not found.complete
    # The recovered recording holds the counts too: a part that is lost later is still counted.
    cut = path.with_name("cut.mcap")
    cut.write_bytes(path.read_bytes()[: -path.stat().st_size // 2])
    again = recover(cut, path.with_name("again.mcap"))
    assert again.missing["/force"] + again.by_topic.get("/force", 0) == int(put)


@pytest.mark.parametrize("links", [True, False])
def test_a_file_that_appears_during_the_run_is_not_overwritten(
    path: Path, links: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    def unsupported(*_: object) -> None:
        raise OSError(errno.EPERM, "Operation not permitted")

    if not links:  # a file system without hard links
        monkeypatch.setattr(os, "link", unsupported)
    with Recorder(path, SESSION) as recorder:
        recorder.channel("/force", FORCE).put(START_NS, force(1))
        path.write_bytes(b"precious")
    assert recorder.status.state is RecorderState.FAILED
    assert "run.mcap: is there already" in recorder.status.cause
    assert (path.read_bytes(), recorder.file) == (b"precious", recorder.partial)
    assert sorted(each.name for each in path.parent.iterdir()) == ["run.mcap", "run.mcap.partial"]
    assert recover(recorder.partial, path.with_name("other.mcap")).complete


def test_a_recording_is_finished_where_there_are_no_hard_links(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def unsupported(*_: object) -> None:
        raise OSError(errno.EPERM, "Operation not permitted")

    monkeypatch.setattr(os, "link", unsupported)
    assert Recorder(path, SESSION).close().ok
    assert [each.name for each in path.parent.iterdir()] == ["run.mcap"]


def test_a_dead_writer_is_a_status(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    recorder = Recorder(path, SESSION, when_full=WhenFull.WAIT)
    channel = recorder.channel("/force", FORCE)

    def dies(*_: object) -> int:
        raise MemoryError("out of memory")

    monkeypatch.setattr(journal.os, "write", dies)
    channel.put(START_NS, force(0))
    wait_for(lambda: recorder.status.state is RecorderState.FAILED)
    assert "out of memory" in recorder.status.cause
    assert not channel.put(START_NS, force(1))
    assert recorder.close().overflowed == {"/force": 1}
    assert recorder.partial.exists()


def test_what_cannot_be_encoded_is_counted_and_harms_nothing_else(path: Path) -> None:
    with Recorder(path, SESSION) as recorder:
        channel, events = recorder.channel("/force", FORCE), recorder.channel("/events", EVENT)
        channel.put(START_NS, "no sample")
        events.put(START_NS, {"what": object()})
        events.put(10**30, {"name": "late"})
        channel.put(START_NS, force(1))
    assert recorder.status.refused == 3
    assert "/force" in recorder.status.refusal
    assert Recording.read(path).counts["/force"] == 1


def test_killed_it_loses_at_most_50_ms(path: Path) -> None:
    partial = path.with_name("run.mcap.partial")
    with subprocess.Popen(
        [sys.executable, str(KILLED), str(path)], stdout=subprocess.PIPE,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
    ) as process:  # fmt: skip
        assert process.stdout is not None
        lines = [process.stdout.readline() for _ in range(700)]
        os.kill(process.pid, signal.SIGKILL)
        lines += process.stdout.readlines()
    put, put_ns = max(tuple(map(int, line.split())) for line in lines if line.endswith(b"\n"))
    with pytest.raises(DataError, match="was not finished"):
        Recording.read(partial)
    found = recover(partial, path)
    assert found.missing.get("/ticks", 0) <= put - found.by_topic["/ticks"]
    assert found.counted_s is not None
    assert not found.complete
    messages = list(Recording.read(path).messages(["/ticks"]))
    assert [each.values["number"] for each in messages] == list(range(1, len(messages) + 1))
    assert put_ns - messages[-1].time_ns <= 50_000_000, f"{put - len(messages)} messages lost"


@pytest.mark.parametrize("name", ["run.mcap", "run.mcap.partial"])
def test_nothing_is_overwritten(path: Path, name: str) -> None:
    path.with_name(name).write_bytes(b"precious")
    with pytest.raises(OutputError, match="is there already"):
        Recorder(path)
    assert path.with_name(name).read_bytes() == b"precious"


def test_a_folder_that_is_not_there_is_refused_before_anything_moves(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match="no such folder"):
        Recorder(tmp_path / "nowhere" / "run.mcap")


def test_a_topic_stands_once(path: Path) -> None:
    with Recorder(path, SESSION) as recorder:
        recorder.channel("/force", FORCE)
        for topic in ("/force", "/recorder", "/session", "force"):
            with pytest.raises(OutputError, match="must begin with /"):
                recorder.channel(topic, FORCE)
