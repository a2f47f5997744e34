"""The parts of a lab: one frozen dataclass per table of a simulation file, with one rule per field.

Lengths in mm, forces in N, times in s, angles in rad.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

from needleplan.anatomy import SpaceScenario
from needleplan.artifacts import ShortRepr
from needleplan.config import ConfigTable, Integer, Maybe, Number, Violation, ruled
from needleplan.errors import InputError, Mistake, SimulationError
from needleplan.models import Channel, Model, ModelFile, TipFrame
from needleplan.models.deflection import FibreSensors
from needleplan.models.friction import LuGre
from needleplan.models.path import ImagePlane
from needleplan.planning import PlannedNoise
from needleplan.scenario import EntryPose, Scenario, identified
from needleplan.simulation._effects import Effects
from needleplan.simulation._modelled import require_simulated

__all__ = [
    "AVERAGED",
    "BETWEEN",
    "FIBRE_HZ",
    "FORCE_HZ",
    "IMAGE_HZ",
    "TRACKER_HZ",
    "Move",
    "Robot",
    "Setup",
    "Shaft",
    "SimulatedEntry",
    "SimulatedLayer",
    "SimulatedTissue",
]

# Rates (Hz) of the sensors, and number of samples in the moving average of the force sensor (thesis, appendix A).
FORCE_HZ = 200
TRACKER_HZ = 40
FIBRE_HZ = 100
IMAGE_HZ = 20
AVERAGED = 5

_BEND = Number("1/mm", at_least=-1, at_most=1)
_FORCE = Number("N", at_least=0, at_most=100)
_DEPTH = Number("mm", at_least=-100, at_most=1000)


class _NeedleRule:
    """Rule for the name of a model file whose entry pose is used."""

    def read(self, value: object) -> EntryPose | None:
        """Return the entry pose of the model file, or of the value itself. Raises Violation."""
        if value is None or isinstance(value, EntryPose):
            return value
        if not isinstance(value, str):
            raise Violation("must be the name of a model file", value)
        try:
            return identified(ModelFile.read(value), value).entry or EntryPose()
        except InputError as error:
            raise Violation(
                [Mistake(mistake.key, mistake.value or value, mistake.rule) for mistake in error.mistakes]
            ) from None


@dataclass(frozen=True)
class SimulatedEntry(ConfigTable, key="entry", error=SimulationError):
    """Pose of the guide. Its line meets the surface of the tissue at `x_mm`, `y_mm`, `z_mm`.

    `heading_rad` and `guide_elevation_rad` are the direction of the guide, in the plane and out of it. `depth_mm` is
    the depth of the tip relative to the surface (negative outside). `roll_rad` is the roll of the base: at 0 the needle
    bends to the left, at pi to the right. `needle` is the pose of the tip in the tissue relative to the guide, with its
    scatter between insertions; in a file, the name of a model file of `identify`. `elevation_rad` and
    `elevation_sd_rad` are mean and scatter of the direction of the tip relative to the guide, out of the plane.
    """

    x_mm: float = ruled(Number("mm", at_least=-1000, at_most=1000), 0.0)
    y_mm: float = ruled(Number("mm", at_least=-1000, at_most=1000), 0.0)
    heading_rad: float = ruled(Number("rad", at_least=-1.6, at_most=1.6), 0.0)
    depth_mm: float = ruled(Number("mm", at_least=-100, at_most=0), 0.0)
    roll_rad: float = ruled(Number("rad", at_least=-7, at_most=7), 0.0)
    needle: EntryPose | None = ruled(_NeedleRule(), None)
    elevation_rad: float = ruled(Number("rad", at_least=-0.5, at_most=0.5), 0.0)
    elevation_sd_rad: float = ruled(Number("rad", at_least=0, at_most=0.5), 0.0)
    z_mm: float = ruled(Number("mm", at_least=-1000, at_most=1000), 0.0)
    guide_elevation_rad: float = ruled(Number("rad", at_least=-1.4, at_most=1.4), 0.0)

    def guide_frame(self) -> TipFrame:
        """Return the frame of the guide where it meets the surface."""
        return self._frame(self.x_mm, self.y_mm, self.heading_rad, 0.0)

    def tip_frame(self, drawn: Sequence[float]) -> TipFrame:
        """Return the frame of the tip where it enters the tissue. `drawn` holds three standard normal numbers.

        For the bevel side that was not identified, heading and offset of `needle` are mirrored.
        """
        needle = self.needle or EntryPose()
        side = needle.side if math.cos(self.roll_rad) >= 0 else -needle.side
        heading = self.heading_rad + side * needle.heading_rad + needle.heading_sd_rad * drawn[0]
        offset = side * needle.offset_mm + needle.offset_sd_mm * drawn[1]
        elevation = self.elevation_rad + self.elevation_sd_rad * drawn[2]
        x, y = self.x_mm - offset * math.sin(self.heading_rad), self.y_mm + offset * math.cos(self.heading_rad)
        return self._frame(x, y, heading, elevation)

    def _frame(self, x_mm: float, y_mm: float, heading_rad: float, elevation_rad: float) -> TipFrame:
        """Return the frame of a heading and an elevation relative to the guide."""
        frame = TipFrame.planar(x_mm, y_mm, heading_rad)
        if not (self.z_mm or self.guide_elevation_rad):
            return frame.raised(elevation_rad)
        return frame.raised(self.guide_elevation_rad + elevation_rad).moved((0.0, 0.0, self.z_mm))


@dataclass(frozen=True)
class SimulatedTissue(ConfigTable, key="tissue", error=SimulationError):
    """The tissue between the surface and the first layer, with a membrane at the surface.

    The fields have the same meaning as those of SimulatedLayer. Without `curvature_per_mm`, the needle has the
    curvature of the plan. With `shear_modulus_n_mm2`, the push of the needle displaces the target (NeedlePush).
    """

    curvature_per_mm: float | None = ruled(Maybe(_BEND), None)
    cutting_n: float = ruled(_FORCE, 0.0)
    puncture_n: float = ruled(_FORCE, 0.0)
    stretch_mm: float = ruled(Number("mm", above=0, at_most=50), 2.0)
    shear_modulus_n_mm2: float | None = ruled(Maybe(Number("N/mm^2", at_least=1e-5, at_most=100)), None)


@dataclass(frozen=True)
class SimulatedLayer(ConfigTable, key="layer", error=SimulationError):
    """Tissue deeper than `from_mm` along the entry, behind a membrane, with its own curvature and cutting force.

    The force of the membrane rises linearly to `puncture_n` over `stretch_mm` and drops to 0 at the puncture. Without
    `curvature_per_mm`, the needle has the same curvature as in the tissue outside of layers.
    """

    from_mm: float = ruled(Number("mm", at_least=0, at_most=1000))
    curvature_per_mm: float | None = ruled(Maybe(_BEND), None)
    cutting_n: float = ruled(_FORCE, 0.0)
    puncture_n: float = ruled(_FORCE, 0.0)
    stretch_mm: float = ruled(Number("mm", above=0, at_most=50), 2.0)


@dataclass(frozen=True)
class Shaft(ConfigTable, key="shaft", error=SimulationError):
    """Torsional stiffness GJ, length and radius of the shaft. The defaults are those of an 18 gauge cannula."""

    torsional_stiffness_n_mm2: float = ruled(Number("N mm^2", above=0, at_most=1e9), 1.5e4)
    length_mm: float = ruled(Number("mm", at_least=10, at_most=1000), 200.0)
    radius_mm: float = ruled(Number("mm", at_least=0.02, at_most=5), 0.635)


@dataclass(frozen=True)
class Robot(ConfigTable, key="robot", error=SimulationError):
    """Servo and limits of both axes, insertion and roll."""

    servo_hz: int = ruled(Integer(200, 20_000), 1000)
    bandwidth_hz: float = ruled(Number("Hz", at_least=1, at_most=60), 20.0)
    top_velocity_mm_s: float = ruled(Number("mm/s", above=0, at_most=1000), 50.0)
    acceleration_mm_s2: float = ruled(Number("mm/s^2", above=0, at_most=1e5), 100.0)
    shallowest_mm: float = ruled(_DEPTH, -100.0)
    deepest_mm: float = ruled(_DEPTH, 180.0)
    top_velocity_rad_s: float = ruled(Number("rad/s", above=0, at_most=1000), 12.0)
    acceleration_rad_s2: float = ruled(Number("rad/s^2", above=0, at_most=1e5), 60.0)


@dataclass(frozen=True)
class Move(ConfigTable, key="move", error=SimulationError):
    """One move of a program: `insert_to_mm`, `rotate_to_rad` or `dwell_s`. The first two require a speed."""

    insert_to_mm: float | None = ruled(Maybe(_DEPTH), None)
    velocity_mm_s: float | None = ruled(Maybe(Number("mm/s", above=0, at_most=1000)), None)
    rotate_to_rad: float | None = ruled(Maybe(Number("rad", at_least=-1000, at_most=1000)), None)
    velocity_rad_s: float | None = ruled(Maybe(Number("rad/s", above=0, at_most=1000)), None)
    dwell_s: float | None = ruled(Maybe(Number("s", above=0, at_most=3600)), None)

    @property
    def label(self) -> str:
        """Name of this move as a phase in the recording."""
        if self.insert_to_mm is not None:
            return f"to {self.insert_to_mm:g} mm"
        return f"roll to {self.rotate_to_rad:g} rad" if self.rotate_to_rad is not None else "dwell"


def _layers_increase(layer: Sequence[SimulatedLayer | None]) -> Iterator[Mistake]:
    for number, (before, after) in enumerate(pairwise(layer), start=2):
        if before and after and after.from_mm <= before.from_mm:
            rule = f"must be greater than that of the previous layer, {before.from_mm:g}"
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


def _shaft_holds_sensors(shaft: Shaft, fibre: FibreSensors | None) -> Iterator[Mistake]:
    if fibre:
        yield from fibre.require_length(shaft.length_mm)


def _entry_is_reached(entry: SimulatedEntry, robot: Robot) -> Iterator[Mistake]:
    if not robot.shallowest_mm <= entry.depth_mm <= robot.deepest_mm:
        rule = f"must be within the range of the robot, {robot.shallowest_mm:g} to {robot.deepest_mm:g}"
        yield Mistake("entry.depth_mm", f"{entry.depth_mm:g}", rule)


def _tip_crosses_the_image(ultrasound: ImagePlane | None, entry: SimulatedEntry, robot: Robot) -> Iterator[Mistake]:
    if ultrasound:
        yield from ultrasound.require_reached((entry.x_mm, entry.y_mm, entry.z_mm), robot.deepest_mm)


BETWEEN = (
    _layers_increase, _robot_holds, _shaft_reaches, _shaft_holds_sensors, _entry_is_reached, _tip_crosses_the_image,
)  # fmt: skip
"""Rules between the tables of a simulation file. Their parameters have the names of the tables."""


@dataclass(frozen=True)
class Setup(ShortRepr):
    """Needle, tissue, robot and effects of a lab twin.

    A layer without a curvature has the curvature of the tissue. If the tissue has none either, the needle has the
    curvature of the plan: `plan_curvature_per_mm` (positive to the left), or the local curvature of `scenario` if the
    scenario is not uniform.

    - `friction`: Model II or III of chapter 3 of the thesis, or None.
    - `path`: model of the path of the tip, which replaces all curvatures, or None.
    - `force`: model of an axial force, which is added to the other forces, or None.
    - `fibre`: curvature sensors along the needle, or None.
    - `ultrasound`: image plane of an ultrasound probe, or None.
    - `planned_noise`: tip noise of the plan, which acts unless the effects have a heading noise of their own.

    Raises SimulationError if the parts contradict each other, and ModelError if `path` or `force` is not such a model.
    """

    plan_curvature_per_mm: float = 0.0
    entry: SimulatedEntry = SimulatedEntry()
    tissue: SimulatedTissue = SimulatedTissue()
    layers: tuple[SimulatedLayer, ...] = ()
    shaft: Shaft = Shaft()
    robot: Robot = Robot()
    effects: Effects = Effects()
    friction: LuGre | None = None
    scenario: Scenario | SpaceScenario | None = None
    path: Model | None = None
    force: Model | None = None
    planned_noise: PlannedNoise = PlannedNoise()
    fibre: FibreSensors | None = None
    ultrasound: ImagePlane | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "layers", tuple(self.layers))
        for model, channel in ((self.path, Channel.TIP), (self.force, Channel.FORCE)):
            if model is not None:
                require_simulated(model, channel)
        mistakes = [
            *_layers_increase(self.layers),
            *_robot_holds(self.robot),
            *_shaft_reaches(self.shaft, self.robot),
            *_shaft_holds_sensors(self.shaft, self.fibre),
            *_entry_is_reached(self.entry, self.robot),
            *_tip_crosses_the_image(self.ultrasound, self.entry, self.robot),
        ]
        if mistakes:
            raise SimulationError(mistakes)

    @property
    def heading_noise_rad_sqrt_mm(self) -> tuple[float, float]:
        """Standard deviations of the heading after 1 mm of path, in the plane and out of it."""
        own = self.effects.heading_noise_rad_sqrt_mm
        return self.planned_noise if own is None else (own, own)

    @property
    def all_layers(self) -> tuple[SimulatedLayer, ...]:
        """The tissue as the first layer, which begins at the surface, followed by the other layers."""
        tissue = self.tissue
        first = SimulatedLayer(0.0, tissue.curvature_per_mm, tissue.cutting_n, tissue.puncture_n, tissue.stretch_mm)
        return (first, *self.layers)

    def curvatures(self) -> tuple[tuple[float, float | None], ...]:
        """Return for each layer its first depth (mm) and its curvature (1/mm) without effects.

        A curvature of None means that the local curvature of the scenario applies.
        """
        usual = self.tissue.curvature_per_mm
        if usual is None and (self.scenario is None or self.scenario.uniform):
            usual = self.plan_curvature_per_mm
        return tuple(
            (layer.from_mm, usual if layer.curvature_per_mm is None else layer.curvature_per_mm)
            for layer in self.all_layers
        )
