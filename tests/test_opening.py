"""`npl.open` reads every kind of file by its content, and refuses other files with one message."""

import json
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import needleplan as npl
from needleplan.anatomy import Anatomy, SpaceScenario
from needleplan.artifacts import FORMATS, FileKind, file_format
from needleplan.devices.cia402.setup import DrivesSetup
from needleplan.errors import DataError, ScenarioError
from needleplan.estimation.registration import Registration
from needleplan.identification.force_library import ForceLibrary
from needleplan.models import Bicycle, ModelFile
from needleplan.page import DiagnosisFile
from needleplan.planning import SpaceTable, plan_space
from needleplan.recording import EVENT, Recorder, Recording, write_records
from needleplan.signals import Record
from needleplan.simulation import Simulation
from needleplan.sweep import Engine, Sweep, TableSet, make_table_set
from tests.anatomy.volumes import TEXT, box, write
from tests.devices.cia402.bench import setup_file
from tests.sweep.sweeps import write_sweep

pytestmark = pytest.mark.usefixtures("few_executions")

SHIPPED = Path(npl.__path__[0])
DOCUMENT: dict[str, Any] = {
    "schema": FORMATS[FileKind.DIAGNOSIS], "digest": "sha256:0", "channel": "force", "unit": "N", "model": "lugre",
    "verdict": "nothing", "because": "", "hypotheses": [], "effects": [], "noise": {}, "where": [], "smallest": [],
    "settings": [], "trials": [{"trial": "1", "role": "train", "samples": 2, "digest": "sha256:1"}],
}  # fmt: skip
OBJECTS = {
    FileKind.SCENARIO: npl.Scenario, FileKind.ANATOMY: Anatomy, FileKind.TABLE: npl.PolicyTable,
    FileKind.TABLE_SET: TableSet, FileKind.SWEEP: Sweep,
    FileKind.RECORDING: Recording, FileKind.DATA: list, FileKind.MODEL: ModelFile, FileKind.FORCE_LIBRARY: ForceLibrary,
    FileKind.DIAGNOSIS: DiagnosisFile, FileKind.REGISTRATION: Registration, FileKind.SIMULATION: Simulation,
    FileKind.DRIVES: DrivesSetup,
}  # fmt: skip


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory, table: npl.PolicyTable) -> dict[FileKind, Path]:
    """Return a file of each kind, written by its own writer where it has one."""
    folder = tmp_path_factory.mktemp("files")
    found = {kind: folder / kind.name.lower() for kind in FileKind}
    table.scenario.write(found[FileKind.SCENARIO])
    found[FileKind.ANATOMY] = write(folder, box())
    table.write(found[FileKind.TABLE])
    found[FileKind.SWEEP] = write_sweep(folder, [40.0])
    make_table_set(Sweep.read(found[FileKind.SWEEP]), found[FileKind.TABLE_SET], Engine(workers=0))
    with Recorder(found[FileKind.RECORDING]) as recorder:
        recorder.channel("/event", EVENT).put(recorder.session.monotonic_ns, {"name": "begin", "cause": "test"})
    time = np.arange(3.0)
    write_records([Record({"time_s": time, "depth_mm": time}, trial="1")], folder / "data.csv")
    (folder / "data.csv").rename(found[FileKind.DATA])
    ModelFile(Bicycle(curvature_per_mm=0.01)).write(found[FileKind.MODEL])
    shutil.copy(SHIPPED / "force_libraries" / "published.toml", found[FileKind.FORCE_LIBRARY])
    found[FileKind.DIAGNOSIS].write_text(json.dumps(DOCUMENT))
    Registration().write(found[FileKind.REGISTRATION])
    shutil.copy(SHIPPED / "simulations" / "friction.toml", found[FileKind.SIMULATION])
    found[FileKind.DRIVES] = setup_file(folder)
    return found


@pytest.mark.parametrize("kind", FileKind)
def test_every_kind_is_told_by_its_content_and_opens(files: dict[FileKind, Path], kind: FileKind) -> None:
    told = file_format(files[kind])
    assert (told.kind, told.schema) == (kind, FORMATS.get(kind, ""))
    assert isinstance(npl.open(files[kind]), OBJECTS[kind])
    assert isinstance(npl.open(str(files[kind])), OBJECTS[kind])


def test_folders_and_their_lists_open_as_the_same(files: dict[FileKind, Path], tmp_path: Path) -> None:
    table_set = files[FileKind.TABLE_SET]
    assert len(npl.open(table_set / "tables.jsonl")) == len(npl.open(table_set)) == 2
    (tmp_path / "diagnosis.json").write_text(json.dumps(DOCUMENT))
    assert npl.open(tmp_path).document == npl.open(tmp_path / "diagnosis.json").document == DOCUMENT


def test_files_with_former_names_and_formats_open(files: dict[FileKind, Path], tmp_path: Path) -> None:
    library = tmp_path / "library.toml"
    text = files[FileKind.FORCE_LIBRARY].read_text()
    library.write_text(text.replace("needleplan.force-library/1", "needleplan.atlas/1"))
    assert npl.open(library) == npl.open(files[FileKind.FORCE_LIBRARY])
    simulation = tmp_path / "simulation.toml"
    text = files[FileKind.SIMULATION].read_text()
    simulation.write_text(text.replace("needleplan.simulation/1", "needleplan.experiment/1"))
    assert npl.open(simulation).moves == npl.open(files[FileKind.SIMULATION]).moves
    store = Path(shutil.copytree(files[FileKind.TABLE_SET], tmp_path / "store"))
    former = (store / "tables.jsonl").rename(store / "atlas.jsonl")
    assert len(npl.open(former)) == len(npl.open(store)) == 2
    assert make_table_set(Sweep.read(files[FileKind.SWEEP]), store, Engine(workers=0)).present == 2
    assert former.exists()
    assert not (store / "tables.jsonl").exists()


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"", "is no file that needleplan opens. It opens: scenario, anatomy, policy table,"),
        (b"\x00\x01\x02", "is no file that needleplan opens"),
        (b"a,b\n1,2\n", "is no file that needleplan opens"),
        (b'{"schema": "other/1"}', "is no file that needleplan opens"),
        (b'schema = "needleplan.scenaro/1"', 'names the format "needleplan.scenaro/1", which this needleplan does not'),
        (b"needleplan.table/0 10 bytes sha256:00\n", "plan its scenario or anatomy again with `needleplan plan`"),
        (b"needleplan.space-table/1 10 bytes sha256:00\n", "plan its scenario or anatomy again with `needleplan plan`"),
        (b"needleplan.table/9 10 bytes sha256:00\n", "it was written by a newer needleplan: install that version"),
        (b'{"schema": "needleplan.diagnosis/1"}', "diagnose the recordings again with `needleplan diagnose`"),
        (b'schema = "needleplan.model/9"', "it was written by a newer needleplan: install that version"),
        (b'schema = "needleplan.model/1"\nkind = [', "is not TOML"),
        (b'title = "x"\n[workspace]\nwidth_mm = 1\n', 'schema: must be "needleplan.scenario/1"'),
        (b'schema = "anatomy"\n[anatomy]\nfile = 1\n', 'must be "needleplan.anatomy/1"'),
        (b"\x89MCAP0\r\n", "recording"),
    ],
)
def test_other_files_are_refused_with_what_to_do(tmp_path: Path, content: bytes, says: str) -> None:
    file = tmp_path / "file"
    file.write_bytes(content)
    with pytest.raises(npl.InputError, match=re.escape(says)) as refused:
        npl.open(file)
    assert str(file) in str(refused.value)


@pytest.mark.parametrize("path", [3, None, b"x", ["a"], np.zeros(1000)])
def test_what_is_no_path_is_refused(path: Any) -> None:
    with pytest.raises(npl.InputError, match=r"path = .{1,90}: must be the path of a file or a folder"):
        npl.open(path)


READERS: dict[str, Callable[[Any], object]] = {
    "Anatomy": Anatomy.read,
    "ModelFile": ModelFile.read,
    "PolicyTable": npl.PolicyTable.read,
    "Recording": Recording.read,
    "Scenario": npl.Scenario.read,
    "SpaceTable": SpaceTable.read,
    "read_records": npl.recording.read_records,
    "recover": lambda path: npl.recording.recover(path, "new.mcap"),
}


@pytest.mark.parametrize("path", [3, None, b"x", [5], ""])
@pytest.mark.parametrize("reader", READERS)
def test_every_reader_refuses_what_is_no_path(reader: str, path: Any) -> None:
    with pytest.raises(npl.InputError, match=r"path = .{1,90}: must be the path of a (\w+ )?file"):
        READERS[reader](path)


@pytest.mark.parametrize("records", [3, None, [3], "abc"])
def test_only_records_are_written(records: Any, tmp_path: Path) -> None:
    with pytest.raises(npl.InputError, match="must be a list of needleplan"):
        write_records(records, tmp_path / "data.csv")


def test_shipped_names_open_and_missing_files_are_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "phantom").mkdir()
    assert npl.open("phantom") == npl.Scenario.read("phantom")
    with pytest.raises(npl.InputError, match="four_obstacle: no such file"):
        npl.open("four_obstacle")
    with pytest.raises(npl.InputError, match="is no folder that needleplan opens"):
        npl.open(tmp_path)


def test_plan_takes_an_anatomy_in_every_form(
    files: dict[FileKind, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    anatomy = Anatomy.read(files[FileKind.ANATOMY])
    expected = plan_space(SpaceScenario.of(anatomy)).digest
    monkeypatch.chdir(files[FileKind.ANATOMY].parent)
    unnamed = tmp_path / "anatomy.txt"  # the content counts, not the name
    write(tmp_path, box()).rename(unnamed)
    for given in (anatomy, anatomy.file, SpaceScenario.of(anatomy), files[FileKind.ANATOMY], str(unnamed)):
        assert npl.plan(given).digest == expected


def test_plan_reports_progress_in_3d(files: dict[FileKind, Path]) -> None:
    fractions: list[float] = []
    npl.plan(files[FileKind.ANATOMY], lambda fraction, *_: fractions.append(fraction))
    assert fractions[-1] == 1.0
    with pytest.raises(npl.InputError, match="progress = 3"):
        npl.plan(files[FileKind.ANATOMY], progress=3)  # type: ignore[call-overload]


@pytest.mark.parametrize("kind", [kind for kind in FileKind if kind not in (FileKind.SCENARIO, FileKind.ANATOMY)])
def test_plan_names_the_kind_of_other_files(files: dict[FileKind, Path], kind: FileKind) -> None:
    with pytest.raises(ScenarioError, match=f"cannot be planned: its kind is {kind};") as no:
        npl.plan(files[kind])
    assert len(no.value.mistakes) == 1


@pytest.mark.parametrize("given", [3, None, b"x", np.zeros(1000), object()])
def test_plan_refuses_other_objects(given: Any) -> None:
    with pytest.raises(ScenarioError, match=r"scenario = .{1,90}: must be a scenario, an anatomy") as no:
        npl.plan(given)
    assert len(str(no.value)) < 250


def test_readers_name_the_kind_of_a_file_of_another_kind(files: dict[FileKind, Path]) -> None:
    with pytest.raises(ScenarioError, match="the kind of this file is anatomy") as no:
        npl.Scenario.read(files[FileKind.ANATOMY])
    assert len(no.value.mistakes) == 1
    with pytest.raises(DataError, match="the kind of this file is scenario"):
        Registration.read(files[FileKind.SCENARIO])


def test_a_schema_after_the_first_table_is_not_that_of_the_file(tmp_path: Path) -> None:
    file = tmp_path / "anatomy.toml"
    file.write_text(TEXT.split("\n", 1)[1] + 'schema = "needleplan.model/1"\n')
    assert file_format(file).kind is FileKind.ANATOMY
