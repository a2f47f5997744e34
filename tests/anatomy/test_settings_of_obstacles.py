"""Spacing that a lattice chooses, thickness and margins around obstacles, and what the lattice changes of the file."""

import numpy as np
import pytest

from needleplan.anatomy import FREE, OBSTACLE, Anatomy, AnatomyFile, LabelVolume, SpaceScenario
from needleplan.errors import ScenarioError
from tests.anatomy.volumes import NAMES, TEXT, box
from tests.blind.voxel_distance import box_distances

_ORGAN = 5


def _text(lattice: str = "", needle: str = "diameter_mm = 0.0", regions: str = "") -> str:
    """Return the text of an anatomy file with these settings of the lattice, the needle and the regions."""
    text = (
        TEXT.split("[lattice]")[0]
        .replace("diameter_mm = 0.0\n", "")
        .replace("[needle]", f"{regions}\n[needle]\n{needle}")
    )
    return f"{text}\n[lattice]\n{lattice}\n" if lattice else text


def _scenario(text: str, labels: np.ndarray | None = None) -> SpaceScenario:
    volume = LabelVolume(box() if labels is None else labels, np.diag([2.0, 2.0, 2.0, 1.0]))
    return SpaceScenario.of(Anatomy(AnatomyFile.from_toml(text), volume, NAMES | {"organ": _ORGAN}))


@pytest.mark.parametrize(
    ("lattice", "spacing_mm", "step_mm"),
    [("", 1.0, 4.0), ("step_mm = 3.0", 1.0, 3.0), ("step_mm = 4.5", 1.5, 4.5), ("spacing_mm = 3.0", 3.0, 3.0)],
)
def test_a_lattice_chooses_the_finest_spacing_that_divides_the_step(
    lattice: str, spacing_mm: float, step_mm: float
) -> None:
    scenario = _scenario(_text(lattice))
    assert scenario.grid.frame.spacing_mm == spacing_mm
    assert scenario.step_mm == step_mm
    assert scenario.advance == round(step_mm / spacing_mm)


def test_too_many_states_make_the_lattice_coarser(monkeypatch: pytest.MonkeyPatch) -> None:
    fine = _scenario(_text()).grid.frame.shape
    for share, spacing_mm in ((0.9, 1.5), (0.2, 2.0), (0.0, 2.0)):
        # A cone of 40 degrees has 197 directions that are 5 degrees apart.
        monkeypatch.setattr("needleplan.anatomy._frame._MOST_STATES", share * 197 * np.prod(fine))
        assert _scenario(_text()).grid.frame.spacing_mm == spacing_mm


def test_the_memory_makes_the_lattice_coarser(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("needleplan.anatomy._frame.largest_bytes", lambda: 30_000_000)
    assert _scenario(_text()).grid.frame.spacing_mm > 1.0


def test_a_gauge_is_a_diameter() -> None:
    by_gauge, by_diameter, line = (
        _scenario(_text("spacing_mm = 2.0", needle))
        for needle in ("gauge = 14", "diameter_mm = 2.108", "diameter_mm = 0.0")
    )
    assert by_gauge.needle.thickness_mm == 2.108
    assert line.needle.thickness_mm == 0.0
    assert (by_gauge.grid.voxels == by_diameter.grid.voxels).all()
    closed = [(each.grid.voxels == OBSTACLE).sum() for each in (by_gauge, line)]
    assert closed[0] > 1.2 * closed[1]


@pytest.mark.slow
def test_each_obstacle_keeps_its_own_margin() -> None:
    labels = box()
    labels[4:6, 14:16, 10:14] = _ORGAN
    regions = "margin_mm = 1.0\n[anatomy.margins_mm]\nvessel = 4.0"
    text = _text("spacing_mm = 2.0", "diameter_mm = 1.0", regions).replace('["vessel"]', '["vessel", "organ"]')
    scenario = _scenario(text, labels)
    grid, frame = scenario.grid, scenario.grid.frame
    for label, growth_mm in ((NAMES["vessel"], 4.5), (_ORGAN, 1.5)):
        centres = 2.0 * np.argwhere(labels == label)
        places = np.argwhere(grid.voxels != OBSTACLE)
        points = frame.world(places * grid.voxel_mm)
        distance = np.min([box_distances(points, each - 1.0, each + 1.0) for each in centres], 0)
        # No point of a voxel that is not closed is nearer than the growth.
        assert distance.min() > growth_mm - 1e-6
    closed = frame.world(np.argwhere(grid.voxels == OBSTACLE) * grid.voxel_mm)
    to_each = [
        np.min([box_distances(closed, each - 1.0, each + 1.0) for each in 2.0 * np.argwhere(labels == label)], 0)
        - growth
        for label, growth in ((NAMES["vessel"], 4.5), (_ORGAN, 1.5))
    ]
    assert np.minimum(*to_each).max() < 2 * np.sqrt(3) * grid.voxel_mm


@pytest.mark.parametrize(
    ("regions", "needle", "message"),
    [
        ("[anatomy.margins_mm]\nbone = 3.0", "", "is no label in obstacles"),
        ("[anatomy.margins_mm]\nvessel = -3.0", "", "at least 0"),
        ("margins_mm = 3.0", "", "must be a table of labels"),
        ("", "gauge = 18\ndiameter_mm = 1.0", "leave out one of them (18 gauge is 1.27 mm)"),
        ("", "gauge = 9", "from 10 to 30"),
    ],
)
def test_wrong_margins_and_gauges_are_refused(regions: str, needle: str, message: str) -> None:
    with pytest.raises(ScenarioError) as caught:
        AnatomyFile.from_toml(_text("", needle, regions))
    assert message in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1


def test_margins_are_written_and_read_back() -> None:
    file = AnatomyFile.from_toml(_text("", "gauge = 20", "[anatomy.margins_mm]\nvessel = 3.0"))
    assert AnatomyFile.from_toml(file.to_toml()) == file
    assert dict(file.anatomy.margins_mm) == {"vessel": 3.0}


def test_the_loss_of_a_lattice_is_that_of_the_file() -> None:
    """Two slits of 2 and 6 mm in a wall of 4 mm: a margin of 1.5 mm closes the first one."""
    labels = box()
    labels[labels == NAMES["vessel"]] = NAMES["body"]
    labels[:, :, 16:18] = NAMES["vessel"]
    labels[5:6, :, 16:18] = NAMES["body"]
    labels[10:13, :, 16:18] = NAMES["body"]
    for margin, closed_mm in ((0.0, 0.0), (1.5, 2.0), (4.0, 6.0)):
        loss = _scenario(_text("spacing_mm = 2.0", "diameter_mm = 0.0", f"margin_mm = {margin}"), labels).grid.loss
        assert loss is not None
        assert loss.obstacle_share == 0.0
        assert loss.closed_passage_mm == pytest.approx(closed_mm, abs=1e-5)
        assert (loss.free_share > 0.05) == (margin > 0)


def test_without_obstacles_nothing_is_lost() -> None:
    labels = box()
    labels[labels == NAMES["vessel"]] = NAMES["body"]
    loss = _scenario(_text("spacing_mm = 2.0"), labels).grid.loss
    assert loss is not None
    assert (loss.obstacle_share, loss.free_share, loss.closed_passage_mm) == (0.0, 0.0, 0.0)


@pytest.mark.parametrize("place", [8, 9, 10])
def test_a_lumen_between_grid_points_has_an_entry(place: int) -> None:
    labels = box()
    labels[labels == NAMES["entry"]] = NAMES["body"]
    labels[4:16, 4:16, 2:5] = NAMES["vessel"]
    labels[place, place, 2:5] = NAMES["entry"]
    scenario = _scenario(_text("spacing_mm = 6.0\nstep_mm = 6.0", "diameter_mm = 0.5"), labels)
    points = scenario.grid.entry_points_mm()
    assert len(points) == 1
    assert scenario.codes(points[0]) == FREE
    voxel = np.rint(scenario.grid.frame.world(points[0]) / 2.0).astype(int)
    assert labels[tuple(voxel)] == NAMES["entry"]
