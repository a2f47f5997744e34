"""What the lab twin is built from: all parts of an experiment but its motion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

from needleplan.errors import ExperimentError, Mistake
from needleplan.models import Channel, Model
from needleplan.models.friction import LuGre
from needleplan.scenario import Scenario
from needleplan.simulation.choices import FORCE_HZ
from needleplan.simulation.effects import Effects
from needleplan.simulation.modelled import require_simulated
from needleplan.simulation.parts import Entry, Layer, Robot, Shaft, Tissue

__all__ = ["Setup", "disagreements"]


@dataclass(frozen=True)
class Setup:
    """Needle, tissue, robot and effects; the plan's curvature is `plan_curvature_per_mm`, positive to the left.

    Where neither tissue nor layers give a curvature, the needle bends as in the plan, or with a `scenario` whose
    curvature differs from place to place, as in that. `friction` is Model II or III of chapter 3, or None. A `path` is
    a model of the path of a tip, which then says all about it, and `force` one of an axial force, which is added.
    Raises ExperimentError where the parts contradict each other, ModelError for other models.
    """

    plan_curvature_per_mm: float = 0.0
    entry: Entry = Entry()
    tissue: Tissue = Tissue()
    layers: tuple[Layer, ...] = ()
    shaft: Shaft = Shaft()
    robot: Robot = Robot()
    effects: Effects = Effects()
    friction: LuGre | None = None
    scenario: Scenario | None = None
    path: Model | None = None
    force: Model | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "layers", tuple(self.layers))
        for model, channel in ((self.path, Channel.TIP), (self.force, Channel.FORCE)):
            if model is not None:
                require_simulated(model, channel)
        mistakes = disagreements(self.entry, self.layers, self.shaft, self.robot)
        if mistakes:
            raise ExperimentError(mistakes)

    @property
    def all_layers(self) -> tuple[Layer, ...]:
        """The tissue as the first layer, from the surface on, and the others."""
        tissue = self.tissue
        first = Layer(0.0, tissue.curvature_per_mm, tissue.cutting_n, tissue.puncture_n, tissue.stretch_mm)
        return (first, *self.layers)

    def curvatures(self) -> tuple[tuple[float, float | None], ...]:
        """Return where each layer begins (mm) and the curvature in it (1/mm), before any effect; None: by place."""
        usual = self.tissue.curvature_per_mm
        if usual is None and (self.scenario is None or self.scenario.uniform):
            usual = self.plan_curvature_per_mm
        return tuple(
            (each.from_mm, usual if each.curvature_per_mm is None else each.curvature_per_mm)
            for each in self.all_layers
        )


def disagreements(
    entry: Entry | None, layers: Sequence[Layer], shaft: Shaft | None, robot: Robot | None
) -> list[Mistake]:
    """Return the mistakes that lie between parts; those that could not be read are None or left out."""
    mistakes = []
    for number, (before, layer) in enumerate(pairwise(layers), start=2):
        if layer.from_mm <= before.from_mm:
            rule = f"must be beyond the layer before it, {before.from_mm:g}: layers are in their order"
            mistakes.append(Mistake(f"layer {number}.from_mm", f"{layer.from_mm:g}", rule))
    if robot:
        if robot.servo_hz % FORCE_HZ:
            rule = f"must be a multiple of {FORCE_HZ}, the rate of the force sensor"
            mistakes.append(Mistake("robot.servo_hz", f"{robot.servo_hz}", rule))
        if robot.deepest_mm <= robot.shallowest_mm:
            rule = f"must be above shallowest_mm, {robot.shallowest_mm:g}"
            mistakes.append(Mistake("robot.deepest_mm", f"{robot.deepest_mm:g}", rule))
        if shaft and robot.deepest_mm > shaft.length_mm:
            rule = f"must be at most the length of the shaft, {shaft.length_mm:g}"
            mistakes.append(Mistake("robot.deepest_mm", f"{robot.deepest_mm:g}", rule))
        if entry and not robot.shallowest_mm <= entry.depth_mm <= robot.deepest_mm:
            rule = f"must be where the robot can be, {robot.shallowest_mm:g} to {robot.deepest_mm:g}"
            mistakes.append(Mistake("entry.depth_mm", f"{entry.depth_mm:g}", rule))
    return mistakes
