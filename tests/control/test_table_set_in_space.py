"""Replanning with a table set in 3D: which stored tables hold for a plan, in which frame, and in a replay."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pytest

import needleplan as npl
from needleplan.anatomy import Anatomy, SpaceScenario
from needleplan.cli import main
from needleplan.control import (
    Insertion,
    RunEventName,
    RunRecorder,
    RunSetup,
    TableSetReplanner,
    ThreadReplanner,
    replay,
)
from needleplan.errors import TableError
from needleplan.planning import SpacePose, SpaceTable, plan_space
from needleplan.recording import Recording
from needleplan.sweep import CurvatureLookup, Engine, Sweep, make_table_set
from tests.anatomy.volumes import TEXT, anatomy, box, write
from tests.control.space_scenes import FAST, WIDE, space_station
from tests.control.test_space_insertion import NOISY

pytestmark = pytest.mark.usefixtures("few_executions")

RADII = [36.0, 43.0, 52.0]
BENT = TEXT.replace("[lattice]", "straight_steps = false\n[lattice]")
SWEEP = """\
schema = "needleplan.sweep/1"
anatomy = "anatomy.toml"
[[parameter]]
key = "needle.curvature_radius_mm"
values = {radii}
"""


def stored(
    folder: Path, *, wall: bool = False, text: str = BENT, keep: str = "tables", radii: Sequence[float] = RADII[-1:]
) -> Path:
    """Make a table set over the radius of the needle through a box, and return its folder."""
    write(folder, box(wall), text)
    (folder / "sweep.toml").write_text(f'keep = "{keep}"\n{SWEEP.format(radii=list(radii))}')
    make_table_set(Sweep.read(folder / "sweep.toml"), folder / "store", Engine(workers=0))
    return folder / "store"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("box")
    stored(folder, radii=RADII)
    return folder


@pytest.fixture(scope="module")
def table(folder: Path) -> SpaceTable:
    return plan_space(SpaceScenario.of(Anatomy.read(folder / "anatomy.toml")), threads=1)


@pytest.mark.slow
def test_a_stored_table_answers_in_the_frame_of_the_plan(folder: Path, table: SpaceTable) -> None:
    lookup = CurvatureLookup(npl.TableSet.open(folder / "store"), table.scenario)
    nearest = lookup.nearest_first(table.scenario)
    assert [entry.values["curvature_radius_mm"] for entry in nearest] == [52.0, 43.0, 36.0]
    own, moved = nearest[-1].table(), lookup.read(nearest[-1])
    assert isinstance(own, SpaceTable)
    assert isinstance(moved, SpaceTable)
    assert moved.scenario.grid.frame is table.scenario.grid.frame
    assert moved.scenario.needle.curvature_radius_mm == 36.0
    best, frame = own.best_entry().pose, own.scenario.grid.frame
    place = moved.scenario.grid.frame.local(frame.world(best.position_mm))
    assert place.tolist() != list(best.position_mm)  # a needle that bends more has a wider lattice
    there, here = moved.lookup(SpacePose(*place.tolist(), *best.tangent)), own.lookup(best)
    assert there == pytest.approx(here, rel=1e-6)
    with pytest.raises(TableError, match="must be a plan of the whole lattice"):
        moved.moved_to(table.scenario)
    finer = plan_space(SpaceScenario.of(anatomy(box(), BENT.replace("spacing_mm = 4.0", "spacing_mm = 2.0"))))
    with pytest.raises(TableError, match="other axes or another spacing"):
        own.moved_to(finer.scenario)


@pytest.mark.parametrize(
    ("wall", "text", "keep"),
    [
        (True, BENT, "tables"),  # another volume
        (False, TEXT, "tables"),  # with straight steps
        (False, BENT.replace("rolls = 4", "rolls = 6"), "tables"),
        (False, BENT.replace('"entry"', '"body"'), "tables"),
        (False, BENT, "records"),
    ],
)
def test_tables_that_differ_in_more_than_the_curvature_are_not_taken(
    wall: bool, text: str, keep: str, table: SpaceTable, tmp_path: Path
) -> None:
    table_set = npl.TableSet.open(stored(tmp_path, wall=wall, text=text, keep=keep))
    assert len(CurvatureLookup(table_set, table.scenario)) == 0


def test_tissues_must_scale_alike(tmp_path: Path) -> None:
    tissue = '[[anatomy.curvature]]\nlabel = "body"\nradius_mm = {}\n[needle]'
    table_set = npl.TableSet.open(stored(tmp_path, text=BENT.replace("[needle]", tissue.format(26.0))))
    plan = SpaceScenario.of(anatomy(box(), BENT.replace("[needle]", tissue.format(30.0))))
    (entry,) = CurvatureLookup(table_set, plan).nearest_first(plan)  # 60 / 30 = 52 / 26
    assert entry.values["curvature_radius_mm"] == 52.0


@pytest.mark.study
def test_an_insertion_follows_a_stored_table_first_and_its_replay_too(
    folder: Path, table: SpaceTable, tmp_path: Path
) -> None:
    quiet = replace(NOISY, heading_noise_rad_sqrt_mm=0.001, curvature_error=0.5, torsional_friction_n=0.0)
    table_set = npl.TableSet.open(folder / "store")
    lookup = CurvatureLookup(table_set, table.scenario)
    replanner = TableSetReplanner(lookup, table, ThreadReplanner(wait=True), wait=True)
    station = space_station(table, quiet, 1)
    options = replace(FAST, torsion=station.torsion)
    setup = RunSetup(options, WIDE, station.registration, accepted="a fast lab")
    with RunRecorder(tmp_path / "run.mcap", table, setup, station.clock) as recorder:
        insertion = Insertion(
            table, station, options, registration=station.registration, tip_settings=setup.tip_settings, limits=WIDE,
            accepted_limits=setup.accepted, listeners=[recorder], replanner=replanner,
        )  # fmt: skip
        with insertion:
            report = insertion.run()
    swapped = [event for event in report.events if event.name is RunEventName.TABLE_SWAPPED]
    assert [event.cause for event in swapped[:2]] == ["table set", "replan"]
    assert "a radius of 43 mm" in swapped[0].text
    assert report.steps[swapped[0].step].table_digest == swapped[0].digest
    again = replay(Recording.read(tmp_path / "run.mcap"), table, table_set)
    assert again.differences == ()
    assert again.report.steps == report.steps


def test_the_command_names_what_does_not_fit(
    table: SpaceTable, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    table.write(tmp_path / "table.h5")
    store = stored(tmp_path, wall=True)
    assert main(["insert", str(tmp_path / "table.h5"), "--robot", "sim://", "--table-set", str(store)]) == 2
    assert "has no table that differs from" in capsys.readouterr().err
