"""Table sets of 3D tables, through small volumes."""

from pathlib import Path

import numpy as np
import pytest

import needleplan as npl
from needleplan.anatomy import Anatomy, SpaceScenario
from needleplan.errors import ScenarioError, SweepError
from needleplan.planning import SpaceTable, plan_space
from needleplan.sweep import Engine, Sweep, entry_map, make_table_set, quantity_map, wrong_parameters
from needleplan.sweep._store import TableSetStore
from tests.anatomy.volumes import TEXT, box, write

pytestmark = pytest.mark.usefixtures("few_executions")

HERE = Engine(workers=0)
SWEEP = """\
schema = "needleplan.sweep/1"
anatomy = "anatomy.toml"
{more}
[[parameter]]
key = "needle.curvature_radius_mm"
values = [50.0, 70.0]

[[parameter]]
key = "anatomy.file"
name = "volume"
values = ["box.nii.gz", "wall.nii.gz"]
"""


def sweep_of(folder: Path, more: str = "") -> Sweep:
    """Write two volumes, one with a wall in front of the target, and return a sweep over radius and volume."""
    write(folder, box(wall=True))
    (folder / "box.nii.gz").rename(folder / "wall.nii.gz")
    write(folder, box())
    (folder / "sweep.toml").write_text(SWEEP.format(more=more))
    return Sweep.read(folder / "sweep.toml")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("space")
    assert make_table_set(sweep_of(folder), folder / "store", HERE).solved == 4
    return folder


@pytest.mark.slow
def test_tables_are_those_of_plan(folder: Path) -> None:
    table_set = npl.TableSet.open(folder / "store")
    entry = table_set.select(curvature_radius_mm=50.0, volume="box.nii.gz")[0]
    (folder / "own.toml").write_text(TEXT.replace("60.0", "50.0"))
    wanted = plan_space(SpaceScenario.of(Anatomy.read(folder / "own.toml")))
    table = entry.table()
    assert isinstance(table, SpaceTable)
    assert np.array_equal(table.solved.values, wanted.solved.values)
    assert entry.record["success"] > 0.5
    assert not entry.record["impossible"]
    walled = table_set.select(volume="wall.nii.gz")
    assert all(each.record["impossible"] and each.record["success"] < 1e-3 for each in walled)
    found = quantity_map(table_set.select(volume="box.nii.gz"), "curvature_radius_mm", "volume")
    assert found.values.shape == (1, 2)


@pytest.mark.slow
def test_another_folder_with_the_same_volumes_has_the_same_addresses(folder: Path, tmp_path: Path) -> None:
    make_table_set(sweep_of(tmp_path, 'keep = "records"'), tmp_path / "store", HERE)
    addresses = [{point.address for point in TableSetStore.open(each / "store").points} for each in (folder, tmp_path)]
    assert addresses[0] == addresses[1]


@pytest.mark.slow
def test_records_only(tmp_path: Path) -> None:
    sweep = sweep_of(tmp_path, 'keep = "records"')
    assert make_table_set(sweep, tmp_path / "store", HERE).solved == 4
    assert not list((tmp_path / "store").rglob("*.h5"))
    assert make_table_set(sweep, tmp_path / "store", HERE).present == 4
    table_set = npl.TableSet.open(tmp_path / "store")
    assert table_set[0].record["success"] > 0.5
    with pytest.raises(SweepError, match="keeps records only"):
        table_set[0].table()
    assert make_table_set(sweep_of(tmp_path), tmp_path / "store", HERE).solved == 4


def test_studies_of_the_plane_say_so(folder: Path) -> None:
    table_set = npl.TableSet.open(folder / "store")
    with pytest.raises(SweepError, match="is for scenarios in a plane"):
        entry_map(table_set, "volume")
    with pytest.raises(SweepError, match="is for scenarios in a plane"):
        wrong_parameters(table_set, curvature_radius_mm=50.0, volume="box.nii.gz")


def test_mistakes(tmp_path: Path) -> None:
    sweep = sweep_of(tmp_path)
    with pytest.raises(SweepError, match="must be left out beside a scenario"):
        Sweep("four_obstacles", sweep.parameters, anatomy="a.toml")
    with pytest.raises(SweepError, match="give a scenario or an anatomy"):
        Sweep("", sweep.parameters)
    (tmp_path / "sweep.toml").write_text(SWEEP.format(more="").replace("curvature_radius_mm", "curvature_radius"))
    with pytest.raises(SweepError, match='did you mean "curvature_radius_mm"'):
        make_table_set(Sweep.read(tmp_path / "sweep.toml"), tmp_path / "store", HERE)
    (tmp_path / "sweep.toml").write_text(SWEEP.format(more="").replace("wall.nii.gz", "missing.nii.gz"))
    with pytest.raises(ScenarioError, match=r"anatomy\.file = .*: cannot be read: No such file"):
        make_table_set(Sweep.read(tmp_path / "sweep.toml"), tmp_path / "store", HERE)


@pytest.mark.study
def test_a_cluster(tmp_path: Path) -> None:
    assert make_table_set(sweep_of(tmp_path), tmp_path / "store", Engine(workers=2)).solved == 4
