"""A commented scenario file as a template for new scenarios."""

from __future__ import annotations

import os
from dataclasses import replace

from needleplan.config import raw_of, toml_text
from needleplan.errors import ScenarioError
from needleplan.scenario._parts import Needle
from needleplan.scenario._scenario import ORDER, Scenario
from needleplan.scenario._svg import read_drawing

__all__ = ["template"]


def template(
    name: str | os.PathLike[str] = "four_obstacles",
    *,
    svg: str | os.PathLike[str] | None = None,
    mm_per_unit: float | None = None,
) -> str:
    """Return the text of a scenario file in which every value has a comment, as a template for new scenarios.

    `needleplan new` writes this text; `Scenario.from_toml` reads it back as the same scenario.

    Parameters
    ----------
    name : str or path
        A scenario file, or the name of a shipped scenario.
    svg : str or path, optional
        A drawing that gives workspace, target and obstacles, as for `read_svg`. `name` then gives all else, without its
        layers and tissues. Default: no drawing.
    mm_per_unit : float, optional
        Length in mm of a unit of the drawing. Default: the drawing states its own width and height, in mm for instance.

    Returns
    -------
    str
        TOML. Settings that have no value in the scenario, such as a time limit, are left out.

    Raises
    ------
    ScenarioError
        If there is no such file or shipped scenario, or a file or the drawing has mistakes.

    Examples
    --------
    >>> from needleplan.scenario import Scenario, template
    >>> text = template("four_obstacles")
    >>> print(next(line for line in text.splitlines() if line.startswith("headings")))
    headings = 60  # headings of a full turn; without step_mm a step turns by one
    >>> Scenario.from_toml(text) == Scenario.read("four_obstacles")
    True
    """
    scenario, origin = Scenario.read(name), os.fspath(name)
    if svg is not None:
        workspace, target, obstacles = read_drawing(svg, mm_per_unit)
        needle, solver = Needle(scenario.needle.curvature_radius_mm), replace(scenario.solver, partitions=None)
        origin = f"{os.fspath(svg)} and {origin}"
        try:
            scenario = replace(scenario, workspace=workspace, target=target, obstacles=obstacles, needle=needle,
                               tissues=(), solver=solver)  # fmt: skip
        except ScenarioError as error:
            raise ScenarioError(error.mistakes, os.fspath(svg)) from None
    raw = raw_of(scenario, commented=True)
    header = f"""\
A scenario for needleplan, made from {origin}. Plan it: needleplan plan FILE.toml -o TABLE.h5
Lengths are in mm. x is along the insertion, y lateral. Costs share one unit; only their ratios matter.
All keys and their ranges: docs/reference/scenario.md"""
    return toml_text({key: raw[key] for key in ORDER if key in raw}, header)
