"""The scenario of the next plan, as a diagnosis of a tip's path has changed it."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

from needleplan.artifacts import write_whole
from needleplan.diagnosis import Diagnosis, Verdict
from needleplan.errors import Mistake, ModelError
from needleplan.models import Channel
from needleplan.reports.diagnosis.remedy import Remedy, along_mm, remedy
from needleplan.scenario import Scenario

__all__ = ["remedy_lines", "require_path", "write_scenario"]

_LEAST_RAD = 1e-4


def require_path(channel: Channel) -> None:
    """Raise ModelError for a model from which no plan follows."""
    if channel is not Channel.TIP:
        rule = "goes with a model of the path of a tip in space: no plan follows from others"
        raise ModelError(Mistake("--scenario", "", rule))


def write_scenario(found: Diagnosis, scenario: Scenario, folder: str, velocity_mm_s: float) -> tuple[str, Remedy]:
    """Write `scenario.toml` into the folder; return its name and what else is to be done.

    From `Diagnosis.model`, so that only what was named is in it: without a name it is the calibrated base.
    The file begins by saying which. Raises ModelError, ScenarioError and OutputError.
    """
    require_path(found.given.channel)
    what = remedy(found.model, scenario, velocity_mm_s=velocity_mm_s, places=along_mm(found.checked.training))
    place = Path(folder) / "scenario.toml"
    write_whole(place, f"# {_said(found)} Diagnosis {found.digest}.\n{what.scenario.to_toml()}".encode())
    return str(place), what


def _said(found: Diagnosis) -> str:
    """Return what of the diagnosis is in the scenario."""
    if found.verdict is Verdict.NAMED:
        return f"The curvature with what was named: {', '.join(found.names)}."
    return f"Calibrated only: the curvature of these recordings, without any effect (verdict: {found.verdict})."


def remedy_lines(found: Diagnosis, what: Remedy) -> Iterator[str]:
    """Yield what is in the scenario, and what the robot is to be told besides, in words."""
    yield f"  plan: {_said(found)}"
    layers = len(what.scenario.needle.layers)
    yield f"  plan: radius {what.scenario.needle.curvature_radius_mm:.4g} mm" + f", layers behind it: {layers}" * bool(
        layers
    )
    if abs(what.heading_rad) > _LEAST_RAD:
        yield f"  robot: the path goes in {math.degrees(what.heading_rad):+.2f} deg beside its heading (+ left)"
    for option, value in what.options().items():
        yield f"  robot: insert {option} {value}"
    left, right = what.bends.roll_rad(1, 0.0), what.bends.roll_rad(-1, 0.0) - math.pi
    # One angle by which both are turned is an option; what is left is not.
    if max(abs(left - what.turned_rad), abs(right - what.turned_rad)) > _LEAST_RAD:
        yield f"  robot: at the entry it bends left at a roll of {left:.4f} rad, right at {right + math.pi:.4f} rad"
