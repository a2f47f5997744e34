"""Scenarios from drawings in SVG."""

import cmath
import math
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
import shapely

from needleplan.errors import ScenarioError
from needleplan.scenario import Scenario, read_svg

TARGET = '<circle id="target" cx="100" cy="30" r="2"/>'


def drawn(folder: Path, *shapes: str, page: str = 'viewBox="0 0 120 80"', mm_per_unit: float | None = 1.0) -> Scenario:
    path = folder / "scene.svg"
    path.write_text(f'<svg xmlns="http://www.w3.org/2000/svg" {page}>{"".join(shapes)}</svg>')
    return read_svg(path, mm_per_unit, 40.0)


def test_page_target_and_units(tmp_path: Path) -> None:
    scenario = drawn(tmp_path, TARGET, page='viewBox="-10 5 130 85"', mm_per_unit=0.5)
    assert (scenario.workspace.width_mm, scenario.workspace.height_mm) == (65, 42.5)
    assert scenario.target.center_mm == (55, 30)
    assert scenario.target.radius_mm == 1
    assert scenario.needle.curvature_radius_mm == 40
    assert drawn(tmp_path, TARGET, page='width="120" height="80px"').workspace.width_mm == 120


OVAL = shapely.affinity.scale(shapely.Point(20, 60).buffer(1), 6, 3)


@pytest.mark.parametrize(
    ("shape", "expected"),
    [
        ('<rect x="10" y="20" width="8" height="5"/>', shapely.box(10, 55, 18, 60)),
        ('<rect x="10" y="20" width="12" height="8" rx="3"/>', shapely.box(13, 55, 19, 57).buffer(3)),
        ('<polygon points="10,20 18,20 14 26"/>', shapely.Polygon([(10, 60), (18, 60), (14, 54)])),
        ('<path d="M10 20h8v5h-8z"/>', shapely.box(10, 55, 18, 60)),
        ('<path d="m10,20 8,0 0,5 -8,0"/>', shapely.box(10, 55, 18, 60)),
        ('<path d="M10-20L18-20 18-25H10z" transform="translate(0 40)"/>', shapely.box(10, 60, 18, 65)),
        (
            '<g transform="translate(10,20)"><rect width="8" height="5" transform="scale(2 1)"/></g>',
            shapely.box(10, 55, 26, 60),
        ),
        ('<rect width="8" height="4" transform="rotate(90 10 20)"/>', shapely.box(26, 62, 30, 70)),
        ('<rect width="8" height="4" transform="matrix(0 1 -1 0 30 10)"/>', shapely.box(26, 62, 30, 70)),
        ('<circle cx="20" cy="20" r="6"/>', shapely.Point(20, 60).buffer(6)),
        ('<ellipse cx="20" cy="20" rx="6" ry="3"/>', OVAL),
        ('<circle cx="10" cy="20" r="3" transform="scale(2 1)"/>', OVAL),
        ('<path d="M14 20 A6 6 0 1 1 26 20 a6,6 0 11-12,0z"/>', shapely.Point(20, 60).buffer(6)),
        ('<path d="M10 20 Q20 0 30 20 T50 20 L50 40 L10 40z"/>', None),
        ('<path d="M10 20 C10 10 30 10 30 20 S50 30 50 20 L50 40 L10 40z"/>', None),
        ('<path d="M10 10h20v20h-20z M15 15h10v10h-10z"/>', shapely.box(10, 50, 30, 70) - shapely.box(15, 55, 25, 65)),
    ],
)  # fmt: skip
def test_shapes_become_obstacles(tmp_path: Path, shape: str, expected: shapely.Polygon | None) -> None:
    scenario = drawn(tmp_path, TARGET, shape.replace("<rect", '<rect id="it"').replace("<path", '<path id="it"'))
    (obstacle,) = scenario.obstacles
    if "rect" in shape or "path" in shape:
        assert obstacle.name == "it"
    if expected is None:  # the waves add as much as they take
        assert obstacle.region().area == pytest.approx(800, rel=0.01)
    else:
        assert obstacle.region().symmetric_difference(expected).area < 0.01 * expected.area


@pytest.mark.parametrize("mm_per_unit", [0.1, 1.0, 20.0])
@pytest.mark.parametrize("turned", ["", 'transform="rotate(20) skewX(30) scale(2 1)"'])
@pytest.mark.parametrize(
    ("curve", "at"),
    [
        ("Q 9 9 20 5", lambda t: (1 - t) ** 2 * (2 + 3j) + 2 * t * (1 - t) * (9 + 9j) + t**2 * (20 + 5j)),
        (
            "C 1 9 12 12 20 5",
            lambda t: (
                (1 - t) ** 3 * (2 + 3j)
                + 3 * t * (1 - t) ** 2 * (1 + 9j)
                + 3 * t**2 * (1 - t) * (12 + 12j)
                + t**3 * (20 + 5j)
            ),
        ),
        ("A 8 8 0 0 0 10 11", lambda t: 10 + 3j + 8 * cmath.exp(1j * math.pi * (1 - t / 2))),
    ],
)
def test_pieces_of_curves_are_within_the_stated_tolerance(
    tmp_path: Path, mm_per_unit: float, turned: str, curve: str, at: Callable[[float], complex]
) -> None:
    end = at(1)
    shape = f'<path d="M2 3 {curve} L {end.real} -90 L 2 -90z" {turned}/>'
    (obstacle,) = drawn(tmp_path, TARGET.replace("100", "-90"), shape, page='viewBox="-100 0 120 80"',
                        mm_per_unit=mm_per_unit).obstacles  # fmt: skip
    boundary = obstacle.region().boundary
    turn, skew = math.radians(20), math.tan(math.radians(30))
    for k in range(501):
        z = at(k / 500)
        if turned:
            x, y = 2 * z.real + skew * z.imag, z.imag
            z = complex(x, y) * cmath.exp(1j * turn)
        point = shapely.Point((z.real + 100) * mm_per_unit, (80 - z.imag) * mm_per_unit)
        assert boundary.distance(point) <= 0.01
    # The tolerance is used: no curve has many more pieces than it needs.
    assert len(obstacle.polygon_mm or ()) < 12 + 60 * math.sqrt(mm_per_unit)


def test_a_circle_stays_a_circle_under_rotation_and_scale(tmp_path: Path) -> None:
    shape = '<circle cx="10" cy="0" r="3" transform="translate(30 40) rotate(-90) scale(2)"/>'
    (obstacle,) = drawn(tmp_path, TARGET, shape).obstacles
    assert obstacle.center_mm == pytest.approx((30, 60))
    assert obstacle.radius_mm == pytest.approx(6)


def test_the_page_may_state_its_own_size(tmp_path: Path) -> None:
    page = 'width="297pt" height="4.125in" viewBox="0 0 594 594"'
    scenario = drawn(tmp_path, TARGET.replace('r="2"', 'r="5"'), page=page, mm_per_unit=None)
    assert scenario.workspace.width_mm == pytest.approx(104.775)
    assert scenario.target.center_mm == pytest.approx((100 * 104.775 / 594, 564 * 104.775 / 594))
    for page in ('width="120" height="80" viewBox="0 0 120 80"', 'width="0mm" height="80mm" viewBox="0 0 120 80"'):
        with pytest.raises(ScenarioError, match="mm_per_unit: is missing: the drawing does not state its width"):
            drawn(tmp_path, TARGET, page=page, mm_per_unit=None)


def test_what_is_not_drawn_is_no_obstacle(tmp_path: Path) -> None:
    hidden = (
        '<defs><rect width="9" height="9"/></defs><rect width="9" height="9" style="display:none"/><text>vessel</text>'
    )
    assert drawn(tmp_path, TARGET, hidden, "<!-- a note -->").obstacles == ()


@pytest.mark.parametrize(
    ("shapes", "message"),
    [
        ("", "target: is missing: name a circle"),
        (TARGET + TARGET, 'one circle, and nothing else, must be named "target"'),
        ('<rect id="target" width="9" height="9"/>', 'one circle, and nothing else, must be named "target"'),
        (TARGET + '<use id="rib"/>', "rib = <use>: is not supported"),
        (TARGET + '<rect id="rib" width="9"/>', "rib.height: is missing"),
        (TARGET + '<rect id="rib" width="9mm" height="9"/>', "rib.width = 9mm: must be a number without unit"),
        (TARGET + '<path id="rib" d="M1 1 L2"/>', 'rib.d = .*: "L" does not have its numbers'),
        (TARGET + '<path id="rib" d="M1 1 L2 2"/>', "rib = <path>: must enclose an area"),
        (TARGET + '<path id="rib" d="M10 10L14 14L14 10L10 14z"/>', "crosses itself"),
        (TARGET + '<path id="rib" d="M1 1 L20 2 L2 30 V z"/>', "every command must have its numbers"),
        (
            TARGET + '<path id="rib" d="M1 1 L20 2 % L2 30z"/>',
            'rib.d = .*: "% L2 30z" is no command or number of a path',
        ),
        (TARGET + '<path id="rib" d="L20 2 L2 30z"/>', 'rib.d = .*: must begin with "M"'),
        (TARGET + '<path id="rib" d="M1 1 L2e13 2 L2 30z"/>', "rib.d = .*: every number must be within"),
        (TARGET + '<polygon id="rib" points="10,20 18,20 14"/>', "rib.points = .*: must be pairs of numbers"),
        (TARGET + '<rect width="9" height="9" transform="bend(3)"/>', "transformations of SVG 1.1"),
        (TARGET + '<rect width="9" height="9" transform="scale(1) matrix(1 2)"/>', "transformations of SVG 1.1"),
        (TARGET + '<rect width="9" height="9" transform="translate(3mm)"/>', "transformations of SVG 1.1"),
        (TARGET + '<circle cx="100" cy="30" r="5"/>', "must not lie in or on an obstacle"),
    ],
)
def test_mistakes_are_named(tmp_path: Path, shapes: str, message: str) -> None:
    with pytest.raises(ScenarioError, match=message):
        drawn(tmp_path, shapes)


def test_without_svgelements_the_message_names_the_extra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "svgelements", None)
    with pytest.raises(ScenarioError, match=r"pip install needleplan\[svg\]"):
        drawn(tmp_path, TARGET)


def test_files_and_units_that_cannot_be_read(tmp_path: Path) -> None:
    with pytest.raises(ScenarioError, match="No such file"):
        read_svg(tmp_path / "none.svg", 1.0, 40.0)
    (tmp_path / "scene.svg").write_text("<svg")
    with pytest.raises(ScenarioError, match="is not an SVG file"):
        read_svg(tmp_path / "scene.svg", 1.0, 40.0)
    with pytest.raises(ScenarioError, match="viewBox: is missing"):
        drawn(tmp_path, TARGET, page='width="12cm" height="8cm"')
    for wrong in (0.0, -1.0, math.nan, math.inf, "1"):
        with pytest.raises(ScenarioError, match="mm_per_unit"):
            drawn(tmp_path, TARGET, mm_per_unit=wrong)  # type: ignore[arg-type]
