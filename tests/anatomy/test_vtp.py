"""VTP files, read back by VTK."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from vtkmodules.util.numpy_support import vtk_to_numpy
from vtkmodules.vtkIOXML import vtkXMLPolyDataReader

from needleplan.anatomy import TARGET
from needleplan.planning import EntryMap, Success, entries_vtp, rank_entries, vtp_bytes
from needleplan.reports.insertion import insertion_vtp
from tests.anatomy.volumes import anatomy, box, write
from tests.cli.commands import needleplan
from tests.control.space_scenes import box_table, inserted

pytestmark = pytest.mark.usefixtures("few_executions")


def polydata(path: Path, content: bytes | None = None) -> Any:
    if content is not None:
        path.write_bytes(content)
    reader = vtkXMLPolyDataReader()
    reader.SetFileName(str(path))
    reader.Update()
    return reader.GetOutput()


def line(data: Any, number: int) -> np.ndarray:
    return vtk_to_numpy(data.GetCell(number).GetPoints().GetData())


@pytest.fixture(scope="module")
def entries() -> EntryMap:
    return rank_entries(anatomy(box()), threads=1)


def test_exports_carry_the_estimate_where_the_table_is_3_points_off(entries: EntryMap) -> None:
    table = np.array([0.9, 0.9, 0.9, 0.9])
    known = dict(enumerate([0.865, 0.875, 0.94, 0.9]))
    altered = replace(entries, success=table)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(EntryMap, "known_success", lambda _, number: Success(known[number]))
        assert altered.exported_success().tolist() == [0.865, 0.9, 0.94, 0.9]


def test_entries_paths_and_executions_read_back(entries: EntryMap, tmp_path: Path) -> None:
    best = entries.best(2)
    data = polydata(tmp_path / "entries.vtp", entries_vtp(entries, best, runs=7))
    count = len(entries.poses)
    assert (data.GetNumberOfVerts(), data.GetNumberOfLines()) == (count, len(best) + 7)
    names = ("success", "success_by_the_table", "success_runs", "rank", "execution", "reached")
    cells = {name: vtk_to_numpy(data.GetCellData().GetArray(name)) for name in names}
    assert np.array_equal(cells["success_by_the_table"][:count], entries.success)
    assert np.array_equal(cells["success"][:count], entries.exported_success())
    first, second = (entries.estimate(number).value for number in best)
    assert cells["success"][count:].tolist() == [first, second, *[first] * 7]
    assert (cells["success_runs"][count:] == 100).all()
    assert np.isnan(cells["rank"][:count]).all()
    assert cells["rank"][count:].tolist() == [1, 2, *[1] * 7]
    assert cells["execution"][count:].tolist() == [0, 0, 1, 2, 3, 4, 5, 6, 7]
    assert np.allclose(line(data, count), entries.path_mm(best[0]))
    places = np.array([data.GetCell(number).GetPoints().GetPoint(0) for number in range(count)])
    assert np.allclose(places, entries.grid.frame.world(entries.poses[:, :3]))
    starts = np.array([line(data, count + number)[0] for number in range(2, 9)])
    assert np.allclose(starts, entries.path_mm(best[0])[0])
    assert data.GetFieldData().GetAbstractArray("SPACE").GetValue(0) == "RAS"


@pytest.mark.slow
def test_an_insertion_has_both_paths_and_the_radius_of_equal_volume(tmp_path: Path) -> None:
    table = box_table()
    scenario, report = table.scenario, inserted(table)[0]
    data = polydata(tmp_path / "run.vtp", insertion_vtp(table, report))
    assert (data.GetNumberOfVerts(), data.GetNumberOfLines()) == (1, 2)
    assert np.allclose(data.GetPoint(0), scenario.grid.frame.world(scenario.target_mm))
    radius = vtk_to_numpy(data.GetCellData().GetArray("target_radius_of_equal_volume_mm"))[0]
    volume = (scenario.grid.voxels == TARGET).sum() * scenario.grid.voxel_mm**3
    assert 4 / 3 * np.pi * radius**3 == pytest.approx(volume)
    assert np.allclose(line(data, 2), scenario.grid.frame.world(report.executed_mm))


def test_without_lines_and_without_points(tmp_path: Path) -> None:
    only_points = polydata(tmp_path / "points.vtp", vtp_bytes([], [[1.0, 2.0, 3.0]], {}, {"success": [0.5]}))
    assert only_points.GetPoint(0) == (1.0, 2.0, 3.0)
    only_line = polydata(tmp_path / "line.vtp", vtp_bytes([[[0, 0, 0], [1, 0, 0]]], np.empty((0, 3)), {"a": [4]}, {}))
    assert only_line.GetNumberOfLines() == 1
    assert vtk_to_numpy(only_line.GetCellData().GetArray("a")).tolist() == [4.0]


def test_the_commands_write_them(tmp_path: Path) -> None:
    scene = write(tmp_path, box())
    assert needleplan("entry", scene, "--vtp", tmp_path / "map.vtp").returncode == 0
    assert polydata(tmp_path / "map.vtp").GetNumberOfLines() > 5
    assert needleplan("entry", scene, "--vtp", tmp_path / "map.txt").returncode == 2
