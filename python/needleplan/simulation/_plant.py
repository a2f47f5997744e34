"""The plant: robot, needle and tissue, simulated by one tick of the servo at a time.

The plant differs from the model of the planner. The planner assumes a known curvature, a tip that rolls with the base,
and tissue at rest. The effects of the plant violate each of these assumptions by a chosen amplitude.
"""

from __future__ import annotations

import math

from needleplan.errors import DeviceFault
from needleplan.models import TipFrame, Torsion
from needleplan.models.effects import bent_needle, breathing, speed_factor, weight_curvature
from needleplan.models.path import TwistedShaft, Vector
from needleplan.models.tissue import NeedlePush
from needleplan.simulation._axis import SimulatedAxis
from needleplan.simulation._curvature import curvature_map
from needleplan.simulation._effects import Stream, random_for
from needleplan.simulation._forces import ShaftForce, TipForce
from needleplan.simulation._modelled import ModelledForce, ModelledPath
from needleplan.simulation._setup import FORCE_HZ, Setup
from needleplan.simulation._tip_path import RandomHeading, TipPath3D

__all__ = ["Plant"]

# speed (mm/s) below which a rate-dependent curvature is constant
_SLOWEST_MM_S = 0.25


class Plant:
    """Robot, needle and tissue. The same setup, seed and commands give bitwise the same motion.

    The attributes hold true values without errors of sensors: `force_n` (axial force at the base), `torque_n_mm`
    (torque at the base), `tip_roll_rad` (roll of the tip) and `path_mm` (path length in the tissue).
    """

    force_n: float
    torque_n_mm: float

    def __init__(self, setup: Setup, seed: int = 0) -> None:
        self.setup = setup
        self.seed = seed
        self.ticks: int = 0
        robot, effects, entry = setup.robot, setup.effects, setup.entry
        self.interval_s: float = 1 / robot.servo_hz
        self.insertion: SimulatedAxis = SimulatedAxis(
            entry.depth_mm, interval_s=self.interval_s, bandwidth_hz=robot.bandwidth_hz,
            acceleration=robot.acceleration_mm_s2, resolution=effects.encoder_step_mm,
        )  # fmt: skip
        self.roll: SimulatedAxis = SimulatedAxis(
            entry.roll_rad, interval_s=self.interval_s, bandwidth_hz=robot.bandwidth_hz,
            acceleration=robot.acceleration_rad_s2, resolution=effects.encoder_step_rad,
        )  # fmt: skip
        scatter = random_for(seed, Stream.CURVATURE).standard_normal()
        self.curvature_factor: float = 1 + effects.curvature_error + effects.curvature_scatter * scatter
        self._layers = setup.curvatures()
        by_place = setup.scenario is not None and any(bend is None for _, bend in self._layers)
        self._places = curvature_map(setup.scenario) if setup.scenario and by_place else None
        heading_noise = RandomHeading(setup.heading_noise_rad_sqrt_mm, random_for(seed, Stream.HEADING))
        self._line = entry.guide_frame()
        entered = entry.tip_frame(random_for(seed, Stream.ENTRY).standard_normal(3).tolist())
        self._model = ModelledPath(setup.path, entered) if setup.path else None
        self._start = self._model.start if self._model else entered
        odd = effects.pre_bend_per_mm or effects.sag_per_mm or self._model
        # Outside of the tissue the needle lies in the guide; a model of the path has its own pose at the entry.
        guide = None if self._model else self._line
        self._path = TipPath3D(self._start, self._bend, heading_noise, self._aside if odd else None, guide)
        self._force_model = ModelledForce(setup.force) if setup.force else None
        self._force_ticks = robot.servo_hz // FORCE_HZ
        self._shaft = ShaftForce(
            setup.friction, robot.deepest_mm, effects.tissue_compliance_mm_n, effects.tissue_relaxation_s
        )
        self._tip = TipForce(setup.all_layers)
        torsion = Torsion(setup.shaft.torsional_stiffness_n_mm2, effects.torsional_friction_n)
        self._twist = TwistedShaft(torsion, setup.shaft.length_mm, entry.roll_rad, effects.torsional_release_mm)
        self._breathes = bool(effects.respiration_along_mm or effects.respiration_across_mm)
        self._reaction = effects.reaction_mm_s2_n
        self._phase = 2 * math.pi * random_for(seed, Stream.RESPIRATION).random()
        self._breath = self._breathing(0.0)
        self.tip_roll_rad: float = entry.roll_rad
        self.force_n = self.torque_n_mm = 0.0
        self._pushed = (0.0, 0.0)
        modulus = setup.tissue.shear_modulus_n_mm2
        self._push = NeedlePush(modulus, setup.shaft.radius_mm) if modulus else None
        self.path_mm: float = entry.depth_mm
        self._entered = False

    @property
    def now_s(self) -> float:
        """Simulated time (s) since the start."""
        return self.ticks * self.interval_s

    def insert(self, depth_mm: float, velocity_mm_s: float) -> None:
        """Begin to move to a depth.

        Parameters
        ----------
        depth_mm : float
            Depth (mm), within the limits of the simulated robot.
        velocity_mm_s : float
            Speed (mm/s), up to the top speed of the simulated robot.

        Raises
        ------
        DeviceFault
            The drive does not accept the values.
        """
        robot = self.setup.robot
        _accept("depth", depth_mm, robot.shallowest_mm, robot.deepest_mm, "mm")
        _accept_speed(velocity_mm_s, robot.top_velocity_mm_s, "mm/s")
        self.insertion.go(depth_mm, velocity_mm_s, self.now_s)

    def rotate(self, roll_rad: float, velocity_rad_s: float) -> None:
        """Begin to rotate the base to a roll angle.

        Parameters
        ----------
        roll_rad : float
            Roll angle (rad), from -1000 to 1000.
        velocity_rad_s : float
            Speed (rad/s), up to the top speed of the simulated robot.

        Raises
        ------
        DeviceFault
            The drive does not accept the values.
        """
        _accept("roll", roll_rad, -1000, 1000, "rad")
        _accept_speed(velocity_rad_s, self.setup.robot.top_velocity_rad_s, "rad/s")
        self.roll.go(roll_rad, velocity_rad_s, self.now_s)

    def stop(self) -> None:
        """Begin to stop both axes."""
        self.insertion.halt(self.now_s)
        self.roll.halt(self.now_s)

    @property
    def moving(self) -> bool:
        """Whether the motion profile of at least one axis has not ended yet."""
        return self.insertion.moving(self.now_s) or self.roll.moving(self.now_s)

    def step(self) -> None:
        """Simulate one tick of the servo: axes, breathing, shaft friction, roll and path of the tip, then the force."""
        insertion, roll, interval = self.insertion, self.roll, self.interval_s
        now = self.ticks * interval
        insertion.step(now, -self.force_n * self._reaction)
        roll.step(now)
        self.ticks += 1
        breath_mm = self._breathing(self.ticks * interval)
        sliding_mm_s = insertion.velocity - (breath_mm[0] - self._breath[0]) / interval
        self._breath = breath_mm
        shaft = self._shaft
        shaft.step(interval, sliding_mm_s, insertion.position - breath_mm[0] - shaft.tissue_mm)
        # The friction has just moved the tissue, so that the path length is computed again.
        self.path_mm = length = insertion.position - breath_mm[0] - shaft.tissue_mm
        tip_rad = self._twist.step(roll.position, max(length, 0.0))
        self.tip_roll_rad = self._model.roll(self.tip_roll_rad, *self._moving_now()) if self._model else tip_rad
        self.torque_n_mm = self._twist.torque_n_mm
        if length > 0 and not self._entered:
            # The path is fixed in the tissue, which is displaced at this moment; the start is shifted back accordingly.
            self._entered = True
            n, shift = self._line.normal, -breath_mm[1]
            self._path.begin(self._start.moved((shift * n[0], shift * n[1], shift * n[2])))
        if self._path.step(length, self.tip_roll_rad):
            self._tip.turn_off(length)
        self._pushed = (self._tip.step(length), shaft.force_n)
        self.force_n = sum(self._pushed)
        if self._force_model:
            if self.ticks % self._force_ticks == 0:
                self._force_model.step(*self._moving_now())
            self.force_n += self._force_model.force_n

    def tip(self) -> TipFrame:
        """Return the frame of the tip (mm) in the frame of the lab: x along the insertion, y to the left, z up."""
        return self.frame_behind(0.0)

    def frame_behind(self, distance_mm: float) -> TipFrame:
        """Return the frame of the needle at a distance (mm) behind the tip."""
        frame = self._path.tip() if distance_mm == 0 else self._path.frame_at(self.path_mm - distance_mm)
        along = self._breath[0] + self._shaft.tissue_mm
        across = self._breath[1] if self._entered else 0.0
        t, n = self._line.tangent, self._line.normal
        if self._model:
            frame = frame.moved(self._model.shift(frame, self.tip_roll_rad, *self._moving_now(), shown=False))
        return frame.moved((along * t[0] + across * n[0], along * t[1] + across * n[1], along * t[2] + across * n[2]))

    def seen_behind(self, distance_mm: float) -> TipFrame:
        """Return the frame of the needle at a distance (mm) behind the tip, as a noise-free tracker shows it.

        This frame differs from the true frame only if the model of the path has effects that only the tracker shows.
        """
        true = self.frame_behind(distance_mm)
        if not self._model:
            return true
        frame = self._path.tip() if distance_mm == 0 else self._path.frame_at(self.path_mm - distance_mm)
        shifts = [self._model.shift(frame, self.tip_roll_rad, *self._moving_now(), shown=one) for one in (True, False)]
        x, y, z = (shown - own for shown, own in zip(*shifts, strict=True))
        return true.moved((x, y, z))

    def curvature_behind(self, distance_mm: float, gauge_mm: float) -> tuple[float, float]:
        """Return the mean curvature (1/mm) over a length of the needle, in the axes of the needle.

        Parameters
        ----------
        distance_mm : float
            Distance of the middle behind the tip.
        gauge_mm : float
            Length over which the curvature is averaged.

        Returns
        -------
        tuple of float
            Curvature toward the bevel, and a quarter turn from it.
        """
        place = self.path_mm - distance_mm
        before, middle, after = (self._path.frame_at(place + part * gauge_mm / 2) for part in (-1, 0, 1))
        turned = [(b - a) / gauge_mm for a, b in zip(before.tangent, after.tangent, strict=True)]
        n, b = (sum(x * y for x, y in zip(turned, axis, strict=True)) for axis in (middle.normal, middle.binormal))
        cos, sin = math.cos(self.tip_roll_rad), math.sin(self.tip_roll_rad)
        return cos * n + sin * b, cos * b - sin * n

    def target_mm(self, rest_mm: Vector) -> Vector:
        """Return the position (mm) of a target that is at `rest_mm` before the insertion.

        With a shear modulus of the tissue, the push of tip and shaft displaces the target in the direction of the tip,
        and the tissue that friction drags carries the target along the entry. Otherwise, the target does not move.
        """
        if self._push is None or self.path_mm <= 0:
            return rest_mm
        tip, entry = self.tip(), self._line.tangent
        apart = [there - here for there, here in zip(rest_mm, tip.position_mm, strict=True)]
        ahead = sum(a * b for a, b in zip(apart, tip.tangent, strict=True))
        aside = math.sqrt(max(sum(each * each for each in apart) - ahead * ahead, 0.0))
        shift = self._push.shift_mm(*self._pushed, self.path_mm, ahead_mm=ahead, aside_mm=aside)
        x, y, z = (
            at + shift * along + self._shaft.tissue_mm * carried
            for at, along, carried in zip(rest_mm, tip.tangent, entry, strict=True)
        )
        return x, y, z

    @property
    def felt_n(self) -> float:
        """Axial force (N) that a noise-free sensor shows: the true force plus the sensor effects of the force model."""
        return self.force_n + (self._force_model.shown_n if self._force_model else 0.0)

    @property
    def breath_mm(self) -> tuple[float, float]:
        """Displacement (mm) of the tissue by respiration, along the direction of the entry and perpendicular to it."""
        return self._breath

    @property
    def exhaled_s(self) -> float:
        """Simulated time (s) at the end of an exhalation."""
        return -(self._phase + math.pi / 2) / (2 * math.pi) * self.setup.effects.respiration_period_s

    @property
    def tissue_mm(self) -> float:
        """Displacement (mm) of the tissue by the friction of the needle."""
        return self._shaft.tissue_mm

    def _bend(self, tip: TipFrame) -> float:
        if self._model:
            return 0.0
        (x, y, z), (tx, ty, tz) = tip.position_mm, self._line.tangent
        x0, y0, z0 = self._path.start.position_mm
        along = (x - x0) * tx + (y - y0) * ty + (z - z0) * tz
        bend = self._layers[0][1]
        for begin, curvature in self._layers[1:]:
            if along < begin:
                break
            bend = curvature
        if bend is None:
            assert self._places is not None
            bend = self._places.at(*tip.position_mm)
        power = self.setup.effects.curvature_speed_power
        if power:
            bend *= speed_factor(max(abs(self.insertion.velocity), _SLOWEST_MM_S), power, power)
        return bend * self.curvature_factor

    def _aside(self, tip: TipFrame, roll_rad: float) -> tuple[float, float]:
        """Return the curvatures (1/mm) along n and b, caused by pre-bend and weight of the needle or by the model."""
        if self._model:
            n, b = self._model.bend(roll_rad, *self._moving_now())
            return n * self.curvature_factor, b * self.curvature_factor
        effects = self.setup.effects
        n, b = bent_needle(roll_rad, effects.pre_bend_per_mm, math.pi / 2)
        fading_mm = effects.sag_fading_mm or self.setup.shaft.length_mm
        sag = weight_curvature(self.path_mm, effects.sag_per_mm, fading_mm)
        return float(n - sag * tip.normal[2]), float(b - sag * tip.binormal[2])

    def _moving_now(self) -> tuple[float, float, float, float]:
        """Return the present input of a model: time (s), path length (mm), velocity (mm/s), roll of the base (rad)."""
        return self.now_s, self.path_mm, self.insertion.velocity, self.roll.position

    def _breathing(self, time_s: float) -> tuple[float, float]:
        if not self._breathes:
            return 0.0, 0.0
        effects = self.setup.effects
        moved, _ = breathing(time_s, 1 / effects.respiration_period_s, self._phase, effects.respiration_rest)
        share = 2 * float(moved)
        return effects.respiration_along_mm * share, effects.respiration_across_mm * share


def _accept(name: str, value: float, lowest: float, highest: float, unit: str) -> None:
    if not lowest <= value <= highest:
        raise DeviceFault(
            f"simulated stage: the {name} of {value:g} {unit} is not from {lowest:g} to {highest:g} {unit}"
        )


def _accept_speed(value: float, highest: float, unit: str) -> None:
    if not 0 < value <= highest:
        raise DeviceFault(
            f"simulated stage: the speed of {value:g} {unit} must be above 0 and at most {highest:g} {unit}"
        )
