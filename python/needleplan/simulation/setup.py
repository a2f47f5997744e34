"""What the lab twin is built from: all parts of an experiment but its motion."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
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

__all__ = ["BETWEEN", "Setup"]


def _layers_increase(layer: Sequence[Layer | None]) -> Iterator[Mistake]:
    for number, (before, after) in enumerate(pairwise(layer), start=2):
        if before and after and after.from_mm <= before.from_mm:
            rule = f"must be beyond the layer before it, {before.from_mm:g}: layers are in their order"
            yield Mistake(f"layer {number}.from_mm", f"{after.from_mm:g}", rule)


def _robot_holds(robot: Robot) -> Iterator[Mistake]:
    if robot.servo_hz % FORCE_HZ:
        rule = f"must be a multiple of {FORCE_HZ}, the rate of the force sensor"
        yield Mistake("robot.servo_hz", f"{robot.servo_hz}", rule)
    if robot.deepest_mm <= robot.shallowest_mm:
        rule = f"must be above shallowest_mm, {robot.shallowest_mm:g}"
        yield Mistake("robot.deepest_mm", f"{robot.deepest_mm:g}", rule)


def _shaft_reaches(shaft: Shaft, robot: Robot) -> Iterator[Mistake]:
    if robot.deepest_mm > shaft.length_mm:
        rule = f"must be at most the length of the shaft, {shaft.length_mm:g}"
        yield Mistake("robot.deepest_mm", f"{robot.deepest_mm:g}", rule)


def _entry_is_reached(entry: Entry, robot: Robot) -> Iterator[Mistake]:
    if not robot.shallowest_mm <= entry.depth_mm <= robot.deepest_mm:
        rule = f"must be where the robot can be, {robot.shallowest_mm:g} to {robot.deepest_mm:g}"
        yield Mistake("entry.depth_mm", f"{entry.depth_mm:g}", rule)


BETWEEN = (_layers_increase, _robot_holds, _shaft_reaches, _entry_is_reached)
"""Rules between the tables of an experiment, named as in its file."""


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
        mistakes = [
            *_layers_increase(self.layers),
            *_robot_holds(self.robot),
            *_shaft_reaches(self.shaft, self.robot),
            *_entry_is_reached(self.entry, self.robot),
        ]
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
