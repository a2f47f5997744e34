"""From a scenario to the compiled lattice."""

from __future__ import annotations

from needleplan import _ppvi
from needleplan.errors import ScenarioError
from needleplan.scenario import Scenario, Transition

__all__ = ["lattice_of"]


def lattice_of(scenario: Scenario) -> _ppvi.Lattice:
    """Build the lattice: geometry tested, events of all arcs known. Raises ScenarioError."""
    objective = scenario.objective
    try:
        return _ppvi.Lattice(
            width_mm=scenario.workspace.width_mm,
            height_mm=scenario.workspace.height_mm,
            spacing_mm=scenario.grid.spacing_mm,
            polygons=[obstacle.polygon_mm for obstacle in scenario.obstacles],
            target_center_mm=scenario.target.center_mm,
            target_radius_mm=scenario.target.radius_mm,
            curvature_radius_mm=scenario.needle.curvature_radius_mm,
            headings=scenario.motion.headings,
            tip_noise=scenario.motion.tip_noise,
            arc_samples=scenario.motion.arc_samples,
            interpolated=scenario.grid.transition is Transition.INTERPOLATED,
            insertion_per_mm=objective.insertion_per_mm,
            rotation=objective.rotation,
            collision=objective.collision,
            exit=objective.exit,
            discount=objective.discount,
            layers=[(layer.from_mm, layer.curvature_radius_mm) for layer in scenario.needle.layers],
            tissues=[(tissue.polygon_mm, tissue.curvature_radius_mm) for tissue in scenario.tissues],
        )
    except (ValueError, MemoryError) as error:
        raise ScenarioError(str(error)) from error
