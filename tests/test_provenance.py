"""Files are written whole or not at all."""

import errno
import os
from pathlib import Path

import pytest

from needleplan.artifacts import files as provenance
from needleplan.errors import OutputError


def test_digest_of_text_and_bytes() -> None:
    known = "sha256:ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"
    assert provenance.digest("abc") == provenance.digest(b"abc") == known


def test_new_file_and_replaced_file(tmp_path: Path) -> None:
    path = tmp_path / "file"
    provenance.write_whole(path, b"one", memoryview(b"two"))
    assert path.read_bytes() == b"onetwo"
    provenance.write_whole(path, b"")
    assert path.read_bytes() == b""
    assert list(tmp_path.iterdir()) == [path]


def test_a_link_stays_a_link(tmp_path: Path) -> None:
    (tmp_path / "link").symlink_to(tmp_path / "file")
    provenance.write_whole(tmp_path / "link", b"new")
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "file").read_bytes() == b"new"


def test_a_failed_write_leaves_the_old_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "file"
    path.write_bytes(b"old")

    def full(_descriptor: int, _data: memoryview) -> int:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(provenance.os, "write", full)
    with pytest.raises(OutputError, match="cannot be written: No space left on device"):
        provenance.write_whole(path, b"new")
    monkeypatch.undo()
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]


def test_interrupted_between_write_and_rename(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupt(_descriptor: int) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(provenance.os, "fsync", interrupt)
    with pytest.raises(KeyboardInterrupt):
        provenance.write_whole(tmp_path / "file", b"new")
    assert list(tmp_path.iterdir()) == []


def test_a_device_is_written_to_and_not_replaced() -> None:
    with pytest.raises(OutputError, match="/dev/full: cannot be written: No space left on device"):
        provenance.write_whole("/dev/full", b"new")
    assert Path("/dev/full").is_char_device()


@pytest.mark.parametrize("name", [".", "a/b", "nul\0"])
def test_impossible_names_are_told(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(OutputError, match="cannot be written"):
        provenance.write_whole(name, b"new")
    assert list(tmp_path.iterdir()) == []


def test_an_output_does_not_replace_an_input_or_another_output(tmp_path: Path) -> None:
    (tmp_path / "data.csv").write_text("1")
    (tmp_path / "link.csv").symlink_to(tmp_path / "data.csv")
    with pytest.raises(
        OutputError, match=r"link\.csv: cannot be written: it would replace .*data\.csv, which is an input"
    ):
        provenance.require_different([tmp_path / "data.csv"], [tmp_path / "link.csv"])
    with pytest.raises(OutputError, match="be written twice"):
        provenance.require_different([], [tmp_path / "new", tmp_path / "." / "new"])
    provenance.require_different([tmp_path / "data.csv"], ["/dev/null", "/dev/null", tmp_path / "new"])


def test_a_file_that_appears_while_a_command_runs_is_not_replaced_and_the_result_is_kept(tmp_path: Path) -> None:
    path = tmp_path / "table.h5"
    provenance.expect_new([path])
    path.write_bytes(b"somebody else's")
    with pytest.raises(OutputError, match=r"has appeared .* the result is in table\.\w{8}\.h5"):
        provenance.write_whole(path, b"minutes of work")
    assert path.read_bytes() == b"somebody else's"
    (kept,) = set(tmp_path.iterdir()) - {path}
    assert kept.read_bytes() == b"minutes of work"
    provenance.expect_new([])
    provenance.write_whole(path, b"new")
    assert path.read_bytes() == b"new"


def test_a_file_that_is_expected_to_be_new_is_written_once_and_then_replaced(tmp_path: Path) -> None:
    path = tmp_path / "model.toml"
    provenance.expect_new([path])
    for content in (b"one", b"two"):
        provenance.write_whole(path, content)
        assert path.read_bytes() == content
    assert list(tmp_path.iterdir()) == [path]


def test_a_folder_for_results_is_tried_before_the_work(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("mine")
    provenance.require_folder(tmp_path / "new" / "deep")
    assert not (tmp_path / "new").exists()
    provenance.require_folder(tmp_path)
    assert sorted(each.name for each in tmp_path.iterdir()) == ["file"]
    for place in (tmp_path / "file", tmp_path / "file" / "below"):
        with pytest.raises(OutputError, match=r"cannot be a folder for the results: .*file is a file"):
            provenance.require_folder(place)


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="there is no folder in which nothing can be created")
def test_a_folder_that_takes_no_files_is_noticed_before_the_work() -> None:
    with pytest.raises(OutputError, match="cannot be a folder"):
        provenance.require_folder("/proc/found")
    with pytest.raises(OutputError, match="cannot be written"):
        provenance.require_writable("/proc/found.toml")
