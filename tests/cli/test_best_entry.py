"""There is one best entry of an anatomy: commands, files, figures, pages and table sets name the same."""

import csv
import json
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from vtkmodules.util.numpy_support import vtk_to_numpy

from needleplan.anatomy import Anatomy, SpaceScenario
from needleplan.cli.table_poses import poses_of
from needleplan.page import SpacePage
from needleplan.planning import EntryMap, draw_entries, entry_map, plan_space
from needleplan.sweep._work import record_of
from tests.anatomy.test_vtp import polydata
from tests.anatomy.volumes import NAMES, TEXT, anatomy, box, write
from tests.cli.commands import needleplan

pytestmark = pytest.mark.usefixtures("few_executions")

QUIET = TEXT.replace("[lattice]", "tip_noise_deg = 2.0\n[lattice]")


def plate() -> np.ndarray:
    """Return a box with a plate above its entry region: the straightest way leads close to the edge of its hole."""
    labels = box()
    labels[:, :, 6:8][labels[:, :, 6:8] == NAMES["body"]] = NAMES["vessel"]
    labels[9:12, 6:14, 6:8] = NAMES["body"]
    return labels


@cache
def entries() -> EntryMap:
    return entry_map(plan_space(SpaceScenario.of(anatomy(plate(), QUIET)), threads=1), threads=1)


@pytest.mark.slow
def test_errors_of_the_entry_decide() -> None:
    found = entries()
    best, exact = found.first(), found.first(exact=True)
    assert best != exact
    assert found.estimate(exact).shown >= found.estimate(best).shown
    assert found.entry(best).expected_success > found.entry(exact).expected_success
    assert best == found.best(1)[0] == found.best(5)[0]
    assert exact == found.best(1, exact=True)[0]
    assert found.table.best_entry().pose == tuple(found.poses[best])
    assert found.table.best_entry(exact=True).pose == tuple(found.poses[exact])


@pytest.mark.slow
def test_all_name_the_same_entry(tmp_path: Path) -> None:
    found = entries()
    best = found.poses[found.first()]
    frame = found.grid.frame
    place = frame.world(best[:3])
    scene, table = write(tmp_path, plate(), QUIET), tmp_path / "table.h5"
    listed = needleplan("entry", scene, "--top", 2, "--json", "-o", tmp_path / "map.csv", "--transform",
                        tmp_path / "best.tfm", "--vtp", tmp_path / "map.vtp")  # fmt: skip
    assert listed.returncode == 0, listed.stderr
    first = json.loads(listed.stdout)["entries"][0]
    planned = json.loads(needleplan("plan", scene, "-o", table, "--json").stdout)["best_entry"]
    of_table = json.loads(needleplan("entry", table, "--top", 2, "--json").stdout)
    # A table holds no volume, so it knows no obstacle by its name.
    every = json.loads(listed.stdout)["entries"]
    assert of_table["entries"] == [{key: each[key] for key in each if key != "obstacles_mm"} for each in every]
    path = json.loads(needleplan("path", table, "--json").stdout)
    row = next(csv.DictReader((tmp_path / "map.csv").read_text().splitlines()))
    data = polydata(tmp_path / "map.vtp")
    executions = np.flatnonzero(vtk_to_numpy(data.GetCellData().GetArray("execution")) == 1)
    record = record_of(found.table, "left", None)
    for named in (
        first["position_mm"], planned["position_mm"], path["start"]["position_mm"], path["poses"][0][:3],
        [float(row[f"{axis}_mm"]) for axis in "ras"],
        data.GetCell(int(executions[0])).GetPoints().GetPoint(0), [record[f"entry_{axis}_mm"] for axis in "ras"],
        frame.world(poses_of(found.table).start(None)[:3]),
    ):  # fmt: skip
        assert list(named) == pytest.approx(list(place), abs=1e-3)
    # The figure has a ring around the best entry; the page begins with it.
    (ring,) = [line for line in draw_entries(found).axes[0].lines if line.get_label() == "best entry"]
    assert (ring.get_xdata()[0], ring.get_ydata()[0]) == (best[1], best[2])
    page = SpacePage(SpaceScenario.of(Anatomy.read(scene)), str(scene))
    try:
        assert page._number({}) == page._maps.listed[0] == found.first()
    finally:
        page.close()


@pytest.mark.slow
def test_the_first_of_a_list_does_not_depend_on_its_length(tmp_path: Path) -> None:
    scene = write(tmp_path, plate(), QUIET)
    one, four = (json.loads(needleplan("entry", scene, "--top", top, "--json").stdout)["entries"] for top in (1, 4))
    assert one == four[:1]
    exact = json.loads(needleplan("entry", scene, "--top", 1, "--exact-entry", "--json").stdout)["entries"][0]
    place = entries().grid.frame.world(entries().poses[entries().first(exact=True), :3])
    assert exact["position_mm"] == pytest.approx(place.tolist())
