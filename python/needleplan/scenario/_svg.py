"""Drawings in SVG as scenarios: the page is the workspace, the circle named "target" the target, all else obstacles."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from needleplan.errors import Mistake, ScenarioError
from needleplan.scenario._obstacle import Obstacle
from needleplan.scenario._parts import Needle, Target, Workspace
from needleplan.scenario._scenario import Scenario
from needleplan.scenario._svg_shapes import DECIMALS, NUMBER, kind_of, matrix, obstacles_of

__all__ = ["read_drawing", "read_svg"]

# Lengths of units in mm. A pixel is left out: programs do not agree on its length.
_MM = {"mm": 1.0, "cm": 10.0, "in": 25.4, "pt": 25.4 / 72, "pc": 25.4 / 6}

# Largest relative difference of the scales that width and height of a page state.
_SAME_SCALE = 1e-3

# Elements that hold other elements, and elements that are not part of the geometry.
_GROUPS = {"svg", "g", "a"}
_IGNORED = {"defs", "metadata", "title", "desc", "style", "text", "image", "namedview", "script", "symbol"}

_LABEL = "{http://www.inkscape.org/namespaces/inkscape}label"


def read_svg(
    path: str | os.PathLike[str],
    mm_per_unit: float | None,
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
    mm_per_unit : float or None
        Length in mm of a unit of the drawing (of its `viewBox`). None: the drawing states its own width and height in
        mm, cm, in, pt or pc, as drawings of Inkscape do.
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
    workspace, target, obstacles = read_drawing(path, mm_per_unit, margin_mm)
    return Scenario(workspace, target, Needle(curvature_radius_mm), obstacles, title=title)


def read_drawing(
    path: str | os.PathLike[str], mm_per_unit: float | None, margin_mm: float | None = None
) -> tuple[Workspace, Target, tuple[Obstacle, ...]]:
    """Return workspace, target and obstacles of a drawing, as described for `read_svg`. Raises ScenarioError."""
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
    try:
        left, top, width, height = _page(root)
        unit_mm = _mm_per_unit(mm_per_unit, root, width, height)
        # To mm, with y up.
        to_mm = Matrix(unit_mm, 0, 0, -unit_mm, -left * unit_mm, (top + height) * unit_mm)
        target, obstacles = None, []
        for element, name, onto in _elements(root, to_mm):
            shapes = obstacles_of(element, name, onto, margin_mm)
            if name.lower() == "target":
                if target is not None or len(shapes) != 1 or shapes[0].center_mm is None:
                    raise ScenarioError(Mistake("target", "", 'one circle, and nothing else, must be named "target"'))
                target = Target(shapes[0].center_mm, shapes[0].radius_mm or 0.0)
            else:
                obstacles += shapes
        if target is None:
            rule = 'is missing: name a circle "target" (its id, or its label in Inkscape)'
            raise ScenarioError(Mistake("target", "", rule))
        workspace = Workspace(round(width * unit_mm, DECIMALS), round(height * unit_mm, DECIMALS))
    except ScenarioError as error:
        raise ScenarioError(error.mistakes, source) from None
    return workspace, target, tuple(obstacles)


def _mm_per_unit(given: float | None, root: ElementTree.Element, width: float, height: float) -> float:
    """Return the length in mm of a unit of the drawing: `given`, or from the width and height that the page states."""
    if given is not None:
        if isinstance(given, int | float) and 0 < given < math.inf:
            return given
        rule = "must be a positive number: the length in mm of a unit of the drawing"
        raise ScenarioError(Mistake("mm_per_unit", f"{given}", rule))
    stated = []
    for key, units in (("width", width), ("height", height)):
        found = re.fullmatch(rf"({NUMBER.pattern})\s*({'|'.join(_MM)})", root.get(key, "").strip())
        if not found or not float(found[1]) > 0 < units:
            rule = f"is missing: the drawing does not state its {key} in mm, cm, in, pt or pc"
            raise ScenarioError(Mistake("mm_per_unit", "", rule))
        stated.append(float(found[1]) * _MM[found[2]] / units)
    if abs(stated[0] - stated[1]) > _SAME_SCALE * stated[0]:
        rule = "is missing: width and height of the drawing state different scales, {:.6g} and {:.6g} mm"
        raise ScenarioError(Mistake("mm_per_unit", "", rule.format(*stated)))
    return stated[0]


def _page(root: ElementTree.Element) -> tuple[float, float, float, float]:
    """Return left, top, width and height of the page in units of the drawing."""
    box = [float(each) for each in NUMBER.findall(root.get("viewBox", ""))]
    if len(box) != 4:
        sizes = [re.fullmatch(rf"({NUMBER.pattern})(px)?", root.get(key, "").strip()) for key in ("width", "height")]
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
        kind, style = kind_of(element), element.get("style", "")
        if kind in _IGNORED or re.search(r"display\s*:\s*none", style) or element.get("display") == "none":
            continue
        name = element.get(_LABEL) or element.get("id") or ""
        here = matrix(element.get("transform", "")) * onto
        if kind in _GROUPS:
            yield from _elements(element, here)
        else:
            yield element, name, here
