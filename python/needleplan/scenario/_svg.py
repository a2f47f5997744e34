"""Drawings in SVG as scenarios: the page is the workspace, the circle named "target" the target, all else obstacles."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree

from needleplan.errors import Mistake, ScenarioError
from needleplan.scenario._obstacle import Obstacle
from needleplan.scenario._parts import Needle, Target, Workspace
from needleplan.scenario._polygon import Points
from needleplan.scenario._scenario import Scenario

if TYPE_CHECKING:
    from shapely.geometry.base import BaseGeometry

__all__ = ["read_svg"]

# Largest distance (mm) between a curve of the drawing and the straight pieces that replace the curve.
_FLATNESS_MM = 0.01

# Largest number of straight pieces of one curve; a polygon with more corners is refused.
_MOST_PIECES = 100_000

# Largest relative difference of the two radii of a circle after transformations.
_ROUND = 1e-6

# Largest absolute number of a drawing; larger ones are mistakes and could overflow.
_LARGEST = 1e12

# Elements that hold other elements, and elements that are not part of the geometry.
_GROUPS = {"svg", "g", "a"}
_IGNORED = {"defs", "metadata", "title", "desc", "style", "text", "image", "namedview", "script", "symbol"}

# Attributes of the supported elements with the length that each has if it is left out. None: the attribute is required.
_LENGTHS: dict[str, dict[str, float | None]] = {
    "circle": {"cx": 0.0, "cy": 0.0, "r": None},
    "ellipse": {"cx": 0.0, "cy": 0.0, "rx": None, "ry": None},
    "rect": {"x": 0.0, "y": 0.0, "width": None, "height": None},
    "polygon": {},
    "path": {},
}

_LABEL = "{http://www.inkscape.org/namespaces/inkscape}label"
_NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")
# A command of a path; "e" belongs to a number.
_COMMAND = re.compile(r"[a-df-zA-DF-Z]")
_TRANSFORM = re.compile(r"\s*(matrix|translate|scale|rotate|skewX|skewY)\s*\(([-+.,\s\deE]*)\)[\s,]*")
# Numbers that every transformation may have.
_TRANSFORM_NUMBERS = {
    "matrix": (6,), "translate": (1, 2), "scale": (1, 2), "rotate": (1, 3), "skewX": (1,), "skewY": (1,)
}  # fmt: skip


def read_svg(
    path: str | os.PathLike[str],
    mm_per_unit: float,
    curvature_radius_mm: float,
    *,
    margin_mm: float | None = None,
    title: str = "",
) -> Scenario:
    """Read the workspace, the target and the obstacles of a scenario from a drawing in SVG.

    The page (`viewBox`) is the workspace; its lower left corner is (0, 0), and y points up. The circle named "target"
    by its id, or by its label in Inkscape, is the target. All other visible circles, ellipses, rectangles, polygons
    and paths are obstacles with the names of the shapes. Circles stay circles; other curves become straight pieces that
    are at most 0.01 mm from the curve. Needs svgelements: ``pip install needleplan[svg]``.

    Parameters
    ----------
    path : str or path
        The SVG file.
    mm_per_unit : float
        Length in mm of a unit of the drawing (of its `viewBox`).
    curvature_radius_mm : float
        Radius of the needle's arc in mm.
    margin_mm : float, optional
        Margin of all obstacles in mm. Default: no margin.
    title : str, optional
        Title of the scenario.

    Returns
    -------
    Scenario
        The scenario, with the default motion, grid, objective and solver.

    Raises
    ------
    ScenarioError
        If the file is not such a drawing, the scenario violates a rule, or svgelements is not installed.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> from needleplan.scenario import read_svg
    >>> text = '''<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 120 80">
    ...   <path id="vessel" d="M 30 80 v -30 q 10 -10 15 0 v 30 z"/>
    ...   <circle id="target" cx="100" cy="30" r="2"/></svg>'''
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     _ = (Path(folder) / "scene.svg").write_text(text)
    ...     read_svg(Path(folder) / "scene.svg", 1.0, 40.0)
    <Scenario: 120 x 80 mm, 1 obstacle, 1,176,120 states>
    """
    source = os.fspath(path)
    try:
        from svgelements import Matrix
    except ImportError:
        rule = "drawings need svgelements: install it with `pip install needleplan[svg]`"
        raise ScenarioError(rule, source) from None
    try:
        root = ElementTree.fromstring(Path(path).read_bytes())
    except OSError as error:
        raise ScenarioError(f"cannot be read: {error.strerror}", source) from None
    except ElementTree.ParseError as error:
        raise ScenarioError(f"is not an SVG file: {error}", source) from None
    if not (isinstance(mm_per_unit, int | float) and 0 < mm_per_unit < math.inf):
        rule = "must be a positive number: the length in mm of a unit of the drawing"
        raise ScenarioError(Mistake("mm_per_unit", f"{mm_per_unit}", rule))
    try:
        left, top, width, height = _page(root)
        # To mm, with y up.
        to_mm = Matrix(mm_per_unit, 0, 0, -mm_per_unit, -left * mm_per_unit, (top + height) * mm_per_unit)
        target, obstacles = None, []
        for element, name, onto in _elements(root, to_mm):
            shapes = _obstacles(element, name, onto, margin_mm)
            if name.lower() == "target":
                if target is not None or len(shapes) != 1 or shapes[0].center_mm is None:
                    raise ScenarioError(Mistake("target", "", 'one circle, and nothing else, must be named "target"'))
                target = Target(shapes[0].center_mm, shapes[0].radius_mm or 0.0)
            else:
                obstacles += shapes
        if target is None:
            rule = 'is missing: name a circle "target" (its id, or its label in Inkscape)'
            raise ScenarioError(Mistake("target", "", rule))
    except ScenarioError as error:
        raise ScenarioError(error.mistakes, source) from None
    workspace = Workspace(width * mm_per_unit, height * mm_per_unit)
    return Scenario(workspace, target, Needle(curvature_radius_mm), tuple(obstacles), title=title)


def _page(root: ElementTree.Element) -> tuple[float, float, float, float]:
    """Return left, top, width and height of the page in units of the drawing."""
    box = [float(each) for each in _NUMBER.findall(root.get("viewBox", ""))]
    if len(box) != 4:
        sizes = [re.fullmatch(rf"({_NUMBER.pattern})(px)?", root.get(key, "").strip()) for key in ("width", "height")]
        if None in sizes:
            raise ScenarioError(Mistake("viewBox", "", "is missing: it is the workspace, in units of the drawing"))
        box = [0.0, 0.0, *(float(size[1]) for size in sizes if size)]
    return box[0], box[1], box[2], box[3]


# The document is walked here and not by svgelements, which leaves out what it cannot read without a word. An obstacle
# must not be left out.
def _elements(parent: ElementTree.Element, onto: Any) -> Iterator[tuple[ElementTree.Element, str, Any]]:
    """Yield every visible shape with its name and the matrix from its coordinates to mm."""
    for element in parent:
        if not isinstance(element.tag, str):
            continue
        kind, style = _kind(element), element.get("style", "")
        if kind in _IGNORED or re.search(r"display\s*:\s*none", style) or element.get("display") == "none":
            continue
        name = element.get(_LABEL) or element.get("id") or ""
        here = _matrix(element.get("transform", "")) * onto
        if kind in _GROUPS:
            yield from _elements(element, here)
        else:
            yield element, name, here


def _kind(element: ElementTree.Element) -> str:
    return element.tag.rpartition("}")[2]


def _matrix(text: str) -> Any:
    """Return the matrix of a transform attribute, a `svgelements.Matrix`."""
    from svgelements import Matrix

    _require_sizes(text, "transform")
    kinds = _TRANSFORM.findall(text)
    right = all(len(_NUMBER.findall(inside)) in _TRANSFORM_NUMBERS[kind] for kind, inside in kinds)
    if _TRANSFORM.sub("", text).strip() or not right:
        raise ScenarioError(Mistake("transform", text, "must consist of the transformations of SVG 1.1"))
    return Matrix(text)


def _obstacles(element: ElementTree.Element, name: str, onto: Any, margin_mm: float | None) -> list[Obstacle]:
    """Return the obstacles of one shape."""
    import svgelements

    kind = _kind(element)
    label = name or kind
    if kind not in _LENGTHS:
        rule = "is not supported; convert it to a path, rectangle, circle, ellipse or polygon"
        raise ScenarioError(Mistake(label, f"<{kind}>", rule))
    lengths = {key: _length(element, key, default, label) for key, default in _LENGTHS[kind].items()}
    largest, smallest = _stretch(onto)
    shape: Any
    if kind in ("circle", "ellipse"):
        rx, ry = lengths.get("rx", lengths.get("r", 0.0)), lengths.get("ry", lengths.get("r", 0.0))
        if abs(rx - ry) <= _ROUND * rx and largest - smallest <= _ROUND * largest:
            at = onto.point_in_matrix_space((lengths["cx"], lengths["cy"]))
            return [Obstacle(name=name, center_mm=(at.x, at.y), radius_mm=rx * largest, margin_mm=margin_mm)]
        shape = svgelements.Ellipse(cx=lengths["cx"], cy=lengths["cy"], rx=rx, ry=ry)
    elif kind == "rect":
        rounded = {key: _length(element, key, 0.0, label) for key in ("rx", "ry") if element.get(key)}
        shape = svgelements.Rect(**lengths, **rounded)
    elif kind == "polygon":
        text = element.get("points", "")
        _require_sizes(text, f"{label}.points")
        if _NUMBER.sub("", text).strip(" ,\t\r\n") or len(_NUMBER.findall(text)) % 2:
            raise ScenarioError(Mistake(f"{label}.points", text[:40], "must be pairs of numbers"))
        shape = svgelements.Polygon(points=text)
    else:
        shape = _path(element.get("d", ""), label)
    rings = [
        tuple((float(at.x), float(at.y)) for at in map(onto.point_in_matrix_space, ring))
        for ring in _rings(shape.segments(transformed=False), _FLATNESS_MM / largest if largest else math.inf)
        if len(ring) > 2
    ]
    if not rings:
        raise ScenarioError(Mistake(label, f"<{kind}>", "must enclose an area"))
    if len(rings) == 1:
        return [Obstacle(rings[0], name, margin_mm=margin_mm)]
    return list(Obstacle.from_shapely(_even_odd(rings, name), name, margin_mm=margin_mm))


def _length(element: ElementTree.Element, key: str, default: float | None, label: str) -> float:
    """Return an attribute that is a length in units of the drawing."""
    text = element.get(key, "")
    _require_sizes(text, f"{label}.{key}")
    found = re.fullmatch(rf"\s*({_NUMBER.pattern})\s*(px)?\s*", text)
    if not found and (text or default is None):
        rule = "must be a number without unit" if text else "is missing"
        raise ScenarioError(Mistake(f"{label}.{key}", text, rule))
    return float(found[1]) if found else default or 0.0


def _require_sizes(text: str, key: str) -> None:
    if any(abs(float(each)) > _LARGEST for each in _NUMBER.findall(text)):
        raise ScenarioError(Mistake(key, text[:40], f"every number must be within +-{_LARGEST:g}"))


def _stretch(matrix: Any) -> tuple[float, float]:
    """Return the largest and the smallest factor by which a matrix stretches lengths: its singular values."""
    same = math.hypot(matrix.a + matrix.d, matrix.b - matrix.c) / 2
    mirrored = math.hypot(matrix.a - matrix.d, matrix.b + matrix.c) / 2
    return same + mirrored, abs(same - mirrored)


def _path(text: str, label: str) -> Any:
    """Return the data of a path as a `svgelements.Path`."""
    from svgelements import Path, SVGLexicalParser

    _require_sizes(text, f"{label}.d")
    if text.strip() and text.lstrip()[0] not in "mM":
        raise ScenarioError(Mistake(f"{label}.d", text[:40], 'must begin with "M"'))
    path, lexer = Path(), SVGLexicalParser()
    try:
        lexer.parse(path, text)
    except (ValueError, TypeError, ArithmeticError):  # so svgelements reports numbers that are missing
        letter = (_COMMAND.findall(text[: lexer.pos]) or [""])[-1]
        raise ScenarioError(Mistake(f"{label}.d", text[:40], f'"{letter}" does not have its numbers')) from None
    if lexer.pos < lexer.limit:
        rule = f'"{text[lexer.pos : lexer.pos + 10]}" is no command or number of a path'
        raise ScenarioError(Mistake(f"{label}.d", text[:40], rule))
    if len(path) < len(_COMMAND.findall(text)):
        raise ScenarioError(Mistake(f"{label}.d", text[:40], "every command must have its numbers"))
    return path


def _rings(segments: Any, flatness: float) -> Iterator[list[tuple[float, float]]]:
    """Yield the corners of every closed ring, at most `flatness` from the curves, in units of the drawing."""
    ring: list[tuple[float, float]] = []
    for segment in segments:
        kind = type(segment).__name__
        if kind in ("Move", "Close"):
            if ring:
                yield ring
            ring = [tuple(segment.end)] if kind == "Move" else []
            continue
        pieces = _pieces(segment, kind, flatness)
        ring = ring or [tuple(segment.start)]
        ring += [tuple(segment.point(k / pieces)) for k in range(1, pieces)]
        ring.append(tuple(segment.end))
    if ring:
        yield ring


def _pieces(segment: Any, kind: str, flatness: float) -> int:
    """Return how many straight pieces of equal parameter length stay within `flatness` of a segment."""
    # A piece of parameter length h is at most h^2 / 8 times the largest second derivative from the curve.
    if kind == "Line":
        return 1
    if kind == "Arc":
        second = segment.sweep**2 * max(segment.rx, segment.ry)
    elif kind == "QuadraticBezier":
        second = 2 * _bend(segment.start, segment.control, segment.end)
    else:
        controls = (segment.start, segment.control1, segment.control2, segment.end)
        bend = (_bend(*controls[:3]), _bend(*controls[1:]))
        second = 6 * max(bend)
    return math.ceil(max(1.0, min(math.sqrt(second / (8 * flatness)), _MOST_PIECES)))


def _bend(before: Any, at: Any, after: Any) -> float:
    """Return the length of the second difference of three points."""
    return math.hypot(before.x - 2 * at.x + after.x, before.y - 2 * at.y + after.y)


def _even_odd(rings: list[Points], name: str) -> BaseGeometry:
    """Return the region inside an odd number of rings; every ring must be a simple polygon."""
    from shapely import Polygon

    region = Polygon()
    for ring in rings:
        region = region.symmetric_difference(Polygon(Obstacle(ring, name).polygon_mm))
    return region
