"""Drawings in SVG as scenarios: the page is the workspace, the circle named "target" the target, all else obstacles."""

from __future__ import annotations

import cmath
import math
import os
import re
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING
from xml.etree import ElementTree

from needleplan.errors import Mistake, ScenarioError
from needleplan.scenario._obstacle import Obstacle
from needleplan.scenario._parts import Needle, Target, Workspace
from needleplan.scenario._polygon import Points
from needleplan.scenario._scenario import Scenario

if TYPE_CHECKING:
    from shapely.geometry.base import BaseGeometry

__all__ = ["read_svg"]

# Straight pieces of a curve of a path, and of a quarter of an ellipse.
_PIECES = 24

# Largest relative difference of the two radii of a circle after transformations.
_ROUND = 1e-6

# Elements that hold other elements, and elements that are not part of the geometry.
_GROUPS = {"svg", "g", "a"}
_IGNORED = {"defs", "metadata", "title", "desc", "style", "text", "image", "namedview", "script", "symbol"}

_LABEL = "{http://www.inkscape.org/namespaces/inkscape}label"
_NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")
# Numbers that every command of a path takes.
_ARGUMENTS = {"m": 2, "l": 2, "h": 1, "v": 1, "c": 6, "s": 4, "q": 4, "t": 2, "a": 7, "z": 0}

# An affine map z -> a z + b conj(z) + c of the plane.
_Map = tuple[complex, complex, complex]
_IDENTITY: _Map = (1 + 0j, 0j, 0j)


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
    and paths are obstacles with the names of the shapes. Curves become straight pieces.

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
        If the file is not such a drawing, or if the scenario violates a rule.

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
        to_mm: _Map = (0j, complex(mm_per_unit), complex(-left, top + height) * mm_per_unit)
        target, obstacles = None, []
        for element, name, onto in _elements(root, to_mm):
            shapes = _shapes(element, name, onto, margin_mm)
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


def _elements(parent: ElementTree.Element, onto: _Map) -> Iterator[tuple[ElementTree.Element, str, _Map]]:
    """Yield every visible shape with its name and the map from its coordinates to mm."""
    for element in parent:
        if not isinstance(element.tag, str):
            continue
        kind = _kind(element)
        if (
            kind in _IGNORED
            or re.search(r"display\s*:\s*none", element.get("style", ""))
            or (element.get("display") == "none")
        ):
            continue
        here = _after(onto, _transform(element.get("transform", "")))
        if kind in _GROUPS:
            yield from _elements(element, here)
        else:
            yield element, element.get(_LABEL) or element.get("id") or "", here


def _kind(element: ElementTree.Element) -> str:
    return element.tag.rpartition("}")[2]


def _shapes(element: ElementTree.Element, name: str, onto: _Map, margin_mm: float | None) -> list[Obstacle]:
    """Return the obstacles of one shape."""
    kind = _kind(element)

    def number(key: str, default: float | None = None) -> float:
        text = element.get(key, "")
        found = re.fullmatch(rf"\s*({_NUMBER.pattern})\s*(px)?\s*", text)
        if not found and (text or default is None):
            rule = "must be a number without unit" if text else "is missing"
            raise ScenarioError(Mistake(f"{name or kind}.{key}", text, rule))
        return float(found[1]) if found else float(default or 0)

    if kind in ("circle", "ellipse"):
        center = complex(number("cx", 0), number("cy", 0))
        rx, ry = (number("r"),) * 2 if kind == "circle" else (number("rx"), number("ry"))
        if abs(rx - ry) <= _ROUND * rx and min(abs(onto[0]), abs(onto[1])) <= _ROUND * abs(onto[0] + onto[1]):
            at = _apply(onto, center)
            radius = rx * (abs(onto[0]) + abs(onto[1]))
            return [Obstacle(name=name, center_mm=(at.real, at.imag), radius_mm=radius, margin_mm=margin_mm)]
        turns = [2 * math.pi * k / (4 * _PIECES) for k in range(4 * _PIECES)]
        rings = [[center + complex(rx * math.cos(turn), ry * math.sin(turn)) for turn in turns]]
    elif kind == "rect":
        corner, width, height = complex(number("x", 0), number("y", 0)), number("width"), number("height")
        rings = [[corner, corner + width, corner + width + 1j * height, corner + 1j * height]]
    elif kind == "polygon":
        flat = [float(each) for each in _NUMBER.findall(element.get("points", ""))]
        rings = [[complex(x, y) for x, y in zip(flat[::2], flat[1::2], strict=False)]]
    elif kind == "path":
        rings = list(_rings(element.get("d", ""), name))
    else:
        rule = "is not supported; convert it to a path, rectangle, circle, ellipse or polygon"
        raise ScenarioError(Mistake(f"{name or kind}", f"<{kind}>", rule))
    placed = [
        tuple((at.real, at.imag) for at in (_apply(onto, each) for each in ring)) for ring in rings if len(ring) > 2
    ]
    if not placed:
        raise ScenarioError(Mistake(f"{name or kind}", f"<{kind}>", "must enclose an area"))
    if len(placed) == 1:
        return [Obstacle(placed[0], name, margin_mm=margin_mm)]
    return list(Obstacle.from_shapely(_even_odd(placed, name), name, margin_mm=margin_mm))


def _even_odd(rings: list[Points], name: str) -> BaseGeometry:
    """Return the region inside an odd number of rings; every ring must be a simple polygon."""
    from shapely import Polygon

    region = Polygon()
    for ring in rings:
        region = region.symmetric_difference(Polygon(Obstacle(ring, name).polygon_mm))
    return region


def _transform(text: str) -> _Map:
    """Return the map of a transform attribute."""
    result = _IDENTITY
    for kind, inside in re.findall(r"(\w+)\s*\(([^)]*)\)", text):
        v = [float(each) for each in _NUMBER.findall(inside)]
        if kind == "translate":
            step: _Map = (1 + 0j, 0j, complex(v[0], v[1] if len(v) > 1 else 0))
        elif kind == "scale":
            sx, sy = v[0], v[-1]
            step = (complex((sx + sy) / 2), complex((sx - sy) / 2), 0j)
        elif kind == "rotate":
            turn = cmath.exp(1j * math.radians(v[0]))
            about = complex(v[1], v[2]) if len(v) == 3 else 0j
            step = (turn, 0j, about - turn * about)
        elif kind in ("matrix", "skewX", "skewY"):
            tangent = math.tan(math.radians(v[0])) if kind != "matrix" else 0.0
            skew = [1, 0, tangent, 1, 0, 0] if kind == "skewX" else [1, tangent, 0, 1, 0, 0]
            a, b, c, d, e, f = v if kind == "matrix" else skew
            step = (complex(a + d, b - c) / 2, complex(a - d, b + c) / 2, complex(e, f))
        else:
            raise ScenarioError(Mistake("transform", text, "must consist of the transformations of SVG 1.1"))
        result = _after(result, step)
    return result


def _after(outer: _Map, inner: _Map) -> _Map:
    """Return the map that applies `inner` and then `outer`."""
    (a, b, c), (p, q, r) = outer, inner
    return (a * p + b * q.conjugate(), a * q + b * p.conjugate(), a * r + b * r.conjugate() + c)


def _apply(onto: _Map, at: complex) -> complex:
    return onto[0] * at + onto[1] * at.conjugate() + onto[2]


def _rings(text: str, name: str) -> Iterator[list[complex]]:
    """Yield the closed rings of the data of a path; curves become straight pieces."""
    ring: list[complex] = []
    at = start = 0j
    handle: complex | None = None  # last control point of a curve, which S and T reflect
    for letter, v in _commands(text, name):
        kind, base = letter.lower(), at if letter.islower() else 0j
        if kind in "mz":
            if ring:
                yield ring
            if kind == "m":
                at = start = base + complex(v[0], v[1])
            ring, at, handle = [], start, None
            ring = [start] if kind == "m" else []
            continue
        ring = ring or [at]
        points = [base + complex(x, y) for x, y in zip(v[::2], v[1::2], strict=False)]
        if kind == "h":
            points = [complex(v[0] + base.real, at.imag)]
        elif kind == "v":
            points = [complex(at.real, v[0] + base.imag)]
        if kind in "st":
            points.insert(0, at if handle is None else 2 * at - handle)
        handle = points[-2] if kind in "csqt" else None
        if kind == "a":
            end = base + complex(v[5], v[6])
            ring += _arc(at, complex(v[0], v[1]), math.radians(v[2]), (bool(v[3]), bool(v[4])), end)
            at = end
            continue
        ring += _bezier([at, *points]) if kind in "csqt" else points
        at = points[-1]
    if ring:
        yield ring


def _commands(text: str, name: str) -> Iterator[tuple[str, list[float]]]:
    """Yield every command of a path with its numbers; repeated numbers repeat the command."""
    for letter, inside in re.findall(r"([a-zA-Z])([^a-zA-Z]*(?:[eE][-+]?\d[^a-zA-Z]*)*)", text):
        count = _ARGUMENTS.get(letter.lower())
        numbers = _numbers(inside, letter)
        if count is None or (len(numbers) % count if count else numbers) or (count and not numbers):
            raise ScenarioError(Mistake(f"{name or 'path'}.d", text[:40], f'"{letter}" does not have its numbers'))
        if not count:
            yield letter, []
        for first in range(0, len(numbers), count or 1):
            # Further points of a move are lines.
            again = letter if first == 0 or letter.lower() != "m" else ("l" if letter == "m" else "L")
            yield again, numbers[first : first + count]


def _numbers(inside: str, letter: str) -> list[float]:
    """Return the numbers of a command. The flags of arcs may be written without separators."""
    if letter.lower() != "a":
        return [float(each) for each in _NUMBER.findall(inside)]
    found: list[float] = []
    position = 0
    while True:
        pattern = re.compile(r"[\s,]*([01])") if len(found) % 7 in (3, 4) else re.compile(rf"[\s,]*({_NUMBER.pattern})")
        match = pattern.match(inside, position)
        if not match:
            return found
        found.append(float(match[1]))
        position = match.end()


def _bezier(controls: list[complex]) -> list[complex]:
    """Return points of a Bezier curve after its start."""
    points = []
    for k in range(1, _PIECES + 1):
        level, t = controls, k / _PIECES
        while len(level) > 1:
            level = [a + t * (b - a) for a, b in pairwise(level)]
        points.append(level[0])
    return points


def _arc(start: complex, radii: complex, turn: float, flags: tuple[bool, bool], end: complex) -> list[complex]:
    """Return points of an elliptical arc after its start (SVG 1.1, appendix F.6.5)."""
    rx, ry = abs(radii.real), abs(radii.imag)
    if start == end or not rx or not ry:
        return [end]
    spin = cmath.exp(1j * turn)
    half = (start - end) / 2 / spin
    unit = complex(half.real / rx, half.imag / ry)
    scale = max(1.0, abs(unit))  # radii that are too small grow
    rx, ry, unit = rx * scale, ry * scale, unit / scale
    away = math.sqrt(max(0.0, 1 / abs(unit) ** 2 - 1)) * (1 if flags[0] != flags[1] else -1)
    middle = complex(unit.imag, -unit.real) * away
    first, last = unit - middle, -unit - middle
    sweep = cmath.phase(last / first)
    sweep += 2 * math.pi if flags[1] and sweep < 0 else -2 * math.pi if not flags[1] and sweep > 0 else 0.0
    center = (start + end) / 2 + complex(middle.real * rx, middle.imag * ry) * spin
    points = []
    for k in range(1, 2 * _PIECES + 1):
        on = first * cmath.exp(1j * sweep * k / (2 * _PIECES))
        points.append(center + complex(on.real * rx, on.imag * ry) * spin)
    return [*points[:-1], end]
