"""The scenario of the next plan, as a diagnosis of a tip's path has changed it."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

from needleplan.diagnosis import Diagnosis
from needleplan.errors import Mistake, ModelError
from needleplan.models import Channel
from needleplan.scenario import Scenario
from needleplan.workflow.diagnosis.remedy import Remedy, along_mm, remedy

__all__ = ["remedy_lines", "require_path", "write_scenario"]

_LEAST_RAD = 1e-4


def require_path(channel: Channel) -> None:
    """Raise ModelError for a model from which no plan follows."""
    if channel is not Channel.TIP:
        rule = "goes with a model of the path of a tip in space: no plan follows from others"
        raise ModelError(Mistake("--scenario", "", rule))


def write_scenario(found: Diagnosis, scenario: Scenario, folder: str, velocity_mm_s: float) -> tuple[str, Remedy]:
    """Write `scenario.toml` into the folder; return its name and what else is to be done.

    From `Diagnosis.model`, so that only what was named is in it. Raises ModelError, ScenarioError and OutputError.
    """
    require_path(found.given.channel)
    what = remedy(found.model, scenario, velocity_mm_s=velocity_mm_s, places=along_mm(found.checked.training))
    place = Path(folder) / "scenario.toml"
    what.scenario.write(place)
    return str(place), what


def remedy_lines(what: Remedy) -> Iterator[str]:
    """Yield what the robot is to be told besides, in words."""
    layers = len(what.scenario.needle.layers)
    yield f"  plan: radius {what.scenario.needle.curvature_radius_mm:.4g} mm" + f", layers behind it: {layers}" * bool(
        layers
    )
    if abs(what.heading_rad) > _LEAST_RAD:
        yield f"  robot: the path goes in {math.degrees(what.heading_rad):+.2f} deg beside its heading (+ left)"
    for option, value in what.options().items():
        yield f"  robot: insert {option} {value}"
    left, right = what.bends.roll_rad(1, 0.0), what.bends.roll_rad(-1, 0.0)
    if max(abs(left), abs(right - math.pi)) > _LEAST_RAD:
        yield f"  robot: at the entry it bends left at a roll of {left:.4f} rad, right at {right:.4f} rad"
