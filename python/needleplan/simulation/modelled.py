"""A model from a file as the plant: the path of the tip, or the axial force, as a diagnosis has left it.

What is of the sensor (`Enters.SENSOR`) is not in the plant: the sensors show it.
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
    """Raise ModelError for a model that the lab twin cannot be, or of another channel."""
    usable = isinstance(_plant(model), SteeredModel) if channel is Channel.TIP else channel is Channel.FORCE
    if model.channel is not channel or not usable:
        what = "the path of a tip in space" if channel is Channel.TIP else "the axial force"
        raise ModelError(Mistake("kind", model.name, f"must be of {what}"))


class ModelledForce:
    """An axial force that a model says, one sample of its sensor at a time; positive where it resists insertion.

    `force_n` is that of the plant, `shown_n` what the model says of the sensor besides.
    """

    def __init__(self, model: Model) -> None:
        whole, plant = _whole(model), _plant(model)
        self._models = (plant,) if whole == plant else (plant, whole)
        self._last: tuple[float, float, float, float] | None = None
        self._states: list[Array | None] = [None] * len(self._models)
        self.force_n = self.shown_n = 0.0

    def step(self, time_s: float, depth_mm: float, velocity_mm_s: float, base_rad: float) -> None:
        """Go on to a time that is later than the last one."""
        now = (time_s, depth_mm, velocity_mm_s, base_rad)
        if self._last is not None:
            motion = Motion.sampled(*np.array([self._last, now]).T)
            gone = [simulate(model, motion, state) for model, state in zip(self._models, self._states, strict=True)]
            self._states = [each.states[:, -1] for each in gone]
            self.force_n = float(gone[0].output[-1])
            self.shown_n = float(gone[-1].output[-1]) - self.force_n
        self._last = now


class ModelledPath:
    """A path that a model says: where it begins, how it bends, how the tip follows, and where a tracker shows it.

    `line` is the frame on the surface as the robot has it.
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
        self.start = TipFrame(
            _vector(self._origin + self._axes @ place), *(_vector(self._axes @ each) for each in axes)
        )

    def bend(
        self, roll_rad: float, time_s: float, depth_mm: float, velocity_mm_s: float, base_rad: float
    ) -> tuple[float, float]:
        """Return the curvature (1/mm) along n and b where the tip is rolled by `roll_rad`."""
        n, b = self._plant.bend_per_mm(self._motion(time_s, depth_mm, velocity_mm_s, base_rad), np.array(roll_rad))
        return float(n), float(b)

    def roll(self, roll_rad: float, time_s: float, depth_mm: float, velocity_mm_s: float, base_rad: float) -> float:
        """Return where the tip rolls to from a roll."""
        motion = self._motion(time_s, depth_mm, velocity_mm_s, base_rad)
        return float(self._plant.following(np.array(roll_rad), motion))

    def shift(
        self, frame: TipFrame, roll_rad: float, time_s: float, depth_mm: float, velocity_mm_s: float, base_rad: float,
        *, shown: bool,
    ) -> Vector:  # fmt: skip
        """Return by how much the tip is elsewhere than on its path, as tissue moves; or `shown` there by a tracker."""
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
        return Motion(*(np.array(float(each)) for each in numbers))


def _plant(model: Model) -> Model:
    plant = model.plant if isinstance(model, AugmentedModel) else model
    return plant.whole if isinstance(plant, AugmentedModel) else plant


def _whole(model: Model) -> Model:
    return model.whole if isinstance(model, AugmentedModel) else model


def _vector(array: Array) -> Vector:
    x, y, z = np.asarray(array, float).tolist()
    return x, y, z
