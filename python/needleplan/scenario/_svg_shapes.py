"""Elements of a drawing in SVG as obstacles. svgelements reads paths, shapes and transformations."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree

from needleplan.errors import Mistake, ScenarioError
from needleplan.scenario._obstacle import Obstacle
from needleplan.scenario._shape import Points

if TYPE_CHECKING:
    from shapely.geometry.base import BaseGeometry

__all__ = ["DECIMALS", "NUMBER", "kind_of", "matrix", "obstacles_of"]

# Decimals of coordinates in mm, so that scenario files stay readable.
DECIMALS = 6

# Largest distance (mm) between a curve and the straight pieces that replace it, less the rounding of coordinates.
_FLATNESS_MM = 0.01 - 1e-6

# Largest number of straight pieces of one curve; a polygon with more corners is refused.
_MOST_PIECES = 100_000

# Largest relative difference of the two radii of a circle after transformations.
_ROUND = 1e-6

# Largest absolute number of a drawing; larger ones are mistakes and could overflow.
_LARGEST = 1e12

# Attributes of the supported elements with the length that each has if it is left out. None: the attribute is required.
_LENGTHS: dict[str, dict[str, float | None]] = {
    "circle": {"cx": 0.0, "cy": 0.0, "r": None},
    "ellipse": {"cx": 0.0, "cy": 0.0, "rx": None, "ry": None},
    "rect": {"x": 0.0, "y": 0.0, "width": None, "height": None},
    "polygon": {},
    "path": {},
}

NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")
# A command of a path; "e" belongs to a number.
_COMMAND = re.compile(r"[a-df-zA-DF-Z]")
_TRANSFORM = re.compile(r"\s*(matrix|translate|scale|rotate|skewX|skewY)\s*\(([-+.,\s\deE]*)\)[\s,]*")
# Numbers that every transformation may have.
_TRANSFORM_NUMBERS = {
    "matrix": (6,), "translate": (1, 2), "scale": (1, 2), "rotate": (1, 3), "skewX": (1,), "skewY": (1,)
}  # fmt: skip


def kind_of(element: ElementTree.Element) -> str:
    return element.tag.rpartition("}")[2]


def matrix(text: str) -> Any:
    """Return the matrix of a transform attribute, a `svgelements.Matrix`."""
    from svgelements import Matrix

    _require_sizes(text, "transform")
    kinds = _TRANSFORM.findall(text)
    right = all(len(NUMBER.findall(inside)) in _TRANSFORM_NUMBERS[kind] for kind, inside in kinds)
    if _TRANSFORM.sub("", text).strip() or not right:
        raise ScenarioError(Mistake("transform", text, "must consist of the transformations of SVG 1.1"))
    return Matrix(text)


def obstacles_of(element: ElementTree.Element, name: str, onto: Any, margin_mm: float | None) -> list[Obstacle]:
    """Return the obstacles of one shape."""
    import svgelements

    kind = kind_of(element)
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
            return [
                Obstacle(
                    name=name, center_mm=_rounded(at), radius_mm=round(rx * largest, DECIMALS), margin_mm=margin_mm
                )
            ]
        shape = svgelements.Ellipse(cx=lengths["cx"], cy=lengths["cy"], rx=rx, ry=ry)
    elif kind == "rect":
        rounded = {key: _length(element, key, 0.0, label) for key in ("rx", "ry") if element.get(key)}
        shape = svgelements.Rect(**lengths, **rounded)
    elif kind == "polygon":
        text = element.get("points", "")
        _require_sizes(text, f"{label}.points")
        if NUMBER.sub("", text).strip(" ,\t\r\n") or len(NUMBER.findall(text)) % 2:
            raise ScenarioError(Mistake(f"{label}.points", text[:40], "must be pairs of numbers"))
        shape = svgelements.Polygon(points=text)
    else:
        shape = _path(element.get("d", ""), label)
    rings = [
        tuple(_rounded(at) for at in map(onto.point_in_matrix_space, ring))
        for ring in _rings(shape.segments(transformed=False), _FLATNESS_MM / largest if largest else math.inf)
        if len(ring) > 2
    ]
    if not rings:
        raise ScenarioError(Mistake(label, f"<{kind}>", "must enclose an area"))
    if len(rings) == 1:
        return [Obstacle(rings[0], name, margin_mm=margin_mm)]
    return list(Obstacle.from_shapely(_even_odd(rings, name), name, margin_mm=margin_mm))


def _rounded(at: Any) -> tuple[float, float]:
    return round(float(at.x), DECIMALS), round(float(at.y), DECIMALS)


def _length(element: ElementTree.Element, key: str, default: float | None, label: str) -> float:
    """Return an attribute that is a length in units of the drawing."""
    text = element.get(key, "")
    _require_sizes(text, f"{label}.{key}")
    found = re.fullmatch(rf"\s*({NUMBER.pattern})\s*(px)?\s*", text)
    if not found and (text or default is None):
        rule = "must be a number without unit" if text else "is missing"
        raise ScenarioError(Mistake(f"{label}.{key}", text, rule))
    return float(found[1]) if found else default or 0.0


def _require_sizes(text: str, key: str) -> None:
    if any(abs(float(each)) > _LARGEST for each in NUMBER.findall(text)):
        raise ScenarioError(Mistake(key, text[:40], f"every number must be within +-{_LARGEST:g}"))


def _stretch(onto: Any) -> tuple[float, float]:
    """Return the largest and the smallest factor by which a matrix stretches lengths: its singular values."""
    same = math.hypot(onto.a + onto.d, onto.b - onto.c) / 2
    mirrored = math.hypot(onto.a - onto.d, onto.b + onto.c) / 2
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
