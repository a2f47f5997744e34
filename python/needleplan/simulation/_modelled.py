"""Models from files as parts of the plant: a model of the path of the tip, or a model of the axial force.

Effects that act on a sensor (`Enters.SENSOR`) do not change the plant, only the values that the sensors show.
"""

from __future__ import annotations

import numpy as np

from needleplan.errors import Mistake, ModelError
from needleplan.models import Channel, Model, SteeredModel, TipFrame, simulate
from needleplan.models.effects import AugmentedModel
from needleplan.models.path import Vector
from needleplan.signals import Array, Motion

__all__ = ["ModelledForce", "ModelledPath", "require_simulated"]


def require_simulated(model: Model, channel: Channel) -> None:
    """Raise ModelError if the lab twin cannot simulate a model, or if the model does not predict `channel`."""
    usable = isinstance(_plant(model), SteeredModel) if channel is Channel.TIP else channel is Channel.FORCE
    if model.channel is not channel or not usable:
        what = "the path of a tip in 3D" if channel is Channel.TIP else "the axial force"
        raise ModelError(Mistake("kind", model.name, f"must be a model of {what}"))


class ModelledForce:
    """Axial force (N) of a model, simulated by one sensor interval at a time; positive if it resists insertion.

    `force_n` is the force of the plant. `shown_n` is the additional force that only the sensor shows.
    """

    def __init__(self, model: Model) -> None:
        whole, plant = _whole(model), _plant(model)
        self._models = (plant,) if whole == plant else (plant, whole)
        self._last: tuple[float, float, float, float] | None = None
        self._states: list[Array | None] = [None] * len(self._models)
        self.force_n = self.shown_n = 0.0

    def step(self, time_s: float, depth_mm: float, velocity_mm_s: float, base_rad: float) -> None:
        """Simulate the force up to a later time `time_s`, at which the needle has these values."""
        now = (time_s, depth_mm, velocity_mm_s, base_rad)
        if self._last is not None:
            motion = Motion.sampled(*np.array([self._last, now]).T)
            gone = [simulate(model, motion, state) for model, state in zip(self._models, self._states, strict=True)]
            self._states = [each.states[:, -1] for each in gone]
            self.force_n = float(gone[0].output[-1])
            self.shown_n = float(gone[-1].output[-1]) - self.force_n
        self._last = now


class ModelledPath:
    """Path of the tip by a model: its start, its curvature, the roll of the tip, and its displacement by moving tissue.

    `line` is the pose of the needle where it enters the surface, in the frame of the robot.
    """

    def __init__(self, model: Model, line: TipFrame) -> None:
        plant = _plant(model)
        assert isinstance(plant, SteeredModel)
        self._plant, self._whole = plant, _whole(model)
        self._axes = np.array([line.tangent, line.normal, line.binormal]).T
        self._origin = np.array(line.position_mm)
        place, slopes = plant.entry(self._motion(0.0, 0.0, 0.0, 0.0))
        tangent = np.array([1.0, *slopes]) / np.sqrt(1 + slopes @ slopes)
        normal = np.array([-tangent[1], tangent[0], 0.0]) / np.hypot(tangent[0], tangent[1])
        axes = (tangent, normal, np.cross(tangent, normal))
        self.start: TipFrame = TipFrame(
            _vector(self._origin + self._axes @ place), *(_vector(self._axes @ axis) for axis in axes)
        )

    def bend(
        self, roll_rad: float, time_s: float, depth_mm: float, velocity_mm_s: float, base_rad: float
    ) -> tuple[float, float]:
        """Return the curvatures (1/mm) along the normal and the binormal of the tip frame, for a roll of the tip."""
        n, b = self._plant.bend_per_mm(self._motion(time_s, depth_mm, velocity_mm_s, base_rad), np.array(roll_rad))
        return float(n), float(b)

    def roll(self, roll_rad: float, time_s: float, depth_mm: float, velocity_mm_s: float, base_rad: float) -> float:
        """Return the next roll of the tip (rad)."""
        motion = self._motion(time_s, depth_mm, velocity_mm_s, base_rad)
        return float(self._plant.following(np.array(roll_rad), motion))

    def shift(
        self, frame: TipFrame, roll_rad: float, time_s: float, depth_mm: float, velocity_mm_s: float, base_rad: float,
        *, shown: bool,
    ) -> Vector:  # fmt: skip
        """Return the displacement (mm) of the tip from the path, caused by moving tissue.

        If `shown`, the displacement includes the effects that only the tracker shows.
        """
        back = self._axes.T
        state = np.concatenate([
            back @ (np.array(frame.position_mm) - self._origin), back @ np.array(frame.tangent),
            back @ np.array(frame.normal), [roll_rad],
        ])  # fmt: skip
        motion = self._motion(time_s, depth_mm, velocity_mm_s, base_rad)
        model = self._whole if shown else self._plant
        return _vector(self._axes @ (model.output(state, motion) - state[:3]))

    @staticmethod
    def _motion(time_s: float, depth_mm: float, velocity_mm_s: float, base_rad: float) -> Motion:
        numbers = (time_s, depth_mm, velocity_mm_s, np.sign(velocity_mm_s), base_rad)
        return Motion(*(np.array(float(number)) for number in numbers))


def _plant(model: Model) -> Model:
    plant = model.plant if isinstance(model, AugmentedModel) else model
    return plant.whole if isinstance(plant, AugmentedModel) else plant


def _whole(model: Model) -> Model:
    return model.whole if isinstance(model, AugmentedModel) else model


def _vector(array: Array) -> Vector:
    x, y, z = np.asarray(array, float).tolist()
    return x, y, z
