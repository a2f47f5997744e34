"""No command overwrites a file that it reads, also if only another file names it, and not with `--force` either."""

from pathlib import Path

import pytest

from needleplan.artifacts import may_replace, move_into_place, recorded_reads, require_unread, was_read, write_whole
from needleplan.errors import OutputError
from needleplan.recording._export_target import NewFolder
from tests.anatomy.volumes import TEXT, box, write
from tests.cli.commands import needleplan, refused

# A file of another name, and its content.
LINK = "link.csv"


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    return write(tmp_path, box())


def _contents(folder: Path) -> dict[Path, bytes]:
    return {each: each.read_bytes() for each in folder.rglob("*") if each.is_file()}


@pytest.mark.parametrize(
    ("command", "option", "output"),
    [
        ("entry", "--success", "box.nii.gz"), ("entry", "-o", "labels.ctbl"), ("entry", "-o", LINK),
        ("plan", "-o", "table.h5"), ("plan", "--figure", "labels.png"), ("view", "--export", "labels.html"),
    ],
)  # fmt: skip
def test_files_that_an_anatomy_names_are_kept(
    scene: Path, command: str, option: str, output: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = scene.parent
    if output == LINK:
        (folder / output).symlink_to("labels.ctbl")
    elif output != "box.nii.gz":  # a colour table with the ending of the output
        (folder / "labels.ctbl").rename(folder / output)
        scene.write_text(TEXT.replace("labels.ctbl", output))
    before = _contents(folder)

    def solve(*_: object, **__: object) -> None:
        pytest.fail("solves before it refuses")

    monkeypatch.setattr("needleplan.planning._space_problem.space_of", solve)
    done = needleplan(command, scene, option, folder / output, "--force")
    refused(done, f"{output}: cannot be written: it would replace a file that this command has read")
    assert _contents(folder) == before


@pytest.mark.parametrize(
    ("command", "option", "endings"), [("plan", "-o", ".h5 or .hdf5"), ("view", "--export", ".html or .htm")]
)
@pytest.mark.parametrize("file", ["anatomy.toml", "four_obstacles"])
def test_tables_and_pages_have_their_endings(scene: Path, command: str, option: str, endings: str, file: str) -> None:
    output = scene.parent / "out.nii.gz"
    done = needleplan(command, file, option, output, "--force", cwd=scene.parent)
    refused(done, f"must end in {endings}")
    assert not output.exists()


def test_what_was_read_is_kept_beside_the_result(tmp_path: Path) -> None:
    """The last guard is where files are renamed: the result is not lost either."""
    file, other = tmp_path / "input.txt", tmp_path / "other.txt"
    file.write_text("precious")
    other.write_text("old")
    with recorded_reads():
        assert file.read_text() == "precious"
        assert was_read(file)
        assert not was_read(other)
        require_unread([other, None, tmp_path / "new.txt"])
        with pytest.raises(OutputError, match="is a file that this command has read, and was not overwritten"):
            write_whole(file, b"result")
        with pytest.raises(FileExistsError):
            move_into_place(other, file, replace=True)
        write_whole(other, b"new")
    (kept,) = tmp_path.glob("input.*.txt")
    assert (file.read_text(), kept.read_text(), other.read_text()) == ("precious", "result", "new")
    write_whole(file, b"outside of a command")
    assert not was_read(file)


def test_a_file_that_the_command_is_to_change_is_replaced(tmp_path: Path) -> None:
    file = tmp_path / "library.toml"
    file.write_text("old")
    with recorded_reads():
        file.read_text()
        may_replace(file)
        write_whole(file, b"new")
    assert file.read_text() == "new"


def test_an_export_into_the_folder_of_its_recording_keeps_the_recording(tmp_path: Path) -> None:
    """A rosbag in the folder `run` has a file `run.mcap`."""
    file = tmp_path / "run" / "run.mcap"
    file.parent.mkdir()
    file.write_text("precious")

    def export() -> None:
        with NewFolder(file.parent, overwrite=True) as made:
            (made / "run.mcap").write_bytes(file.read_bytes())
            (made / "metadata.yaml").write_text("new")

    with recorded_reads(), pytest.raises(OutputError, match="would replace a file that this command has read"):
        export()
    assert file.read_text() == "precious"
    assert [each.name for each in tmp_path.rglob("*")] == ["run", "run.mcap"]
