"""The tip filter: an extended Kalman filter along the path of the needle.

The state is the path at the coil: position, direction and curvature. It advances with the inserted length, bends
according to the roll that is stored for this part of the channel, and is corrected by the poses of the coil. The tip is
predicted from the coil to the end of the channel along arcs; the standard deviations grow, because this part of the
path was not measured. A late pose corrects the path at the position that the coil had when the pose was measured.
The path and its noise are equations (1) to (6) of docs/explanation/tip-estimation.md.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from typing import Self

import numpy as np
from filterpy.kalman import update as kalman_update
from scipy.special import chdtri

from needleplan.devices import FibreSample, Health, ImageSample, PoseSample, StageSample
from needleplan.errors import DataError, Mistake
from needleplan.estimation.registration._registration import Registration
from needleplan.estimation.tip._estimate import PoseUse, TipEstimate, TipSettings, TipStatus
from needleplan.estimation.tip._images import ImageFixes
from needleplan.estimation.tip._path import (
    CHANGE,
    ELEVATION,
    FACTOR,
    HEADING,
    ROLL,
    SIZE,
    CutChannel,
    StageTrack,
    begun,
    mean_gained,
    tangent,
    wandered,
)
from needleplan.estimation.tip._predictor import PathPredictor, Planned
from needleplan.estimation.tip._windows import FibreWindows
from needleplan.models.deflection import FibreSensors
from needleplan.models.path import ImagePlane
from needleplan.scenario import PlaneCurvatureMap, Scenario
from needleplan.signals import Array

__all__ = ["TipFilter"]

# Nanoseconds per second.
_NANO = 1_000_000_000

# Distance (mm) between stored states of the path behind the coil.
_SPACING_MM = 0.25

# Distance (mm) behind the deepest position of the coil within which a pose still corrects the state.
_SAME_PLACE_MM = 0.05

# Measurement matrix: position plus drift, heading, elevation.
_SEEN = np.zeros((5, SIZE))
_SEEN[(0, 1, 2), (0, 1, 2)] = _SEEN[(0, 1, 2), (7, 8, 9)] = _SEEN[3, HEADING] = _SEEN[4, ELEVATION] = 1.0


class TipFilter:
    """Estimates the tip from stage samples and poses, one at a time.

    Call `predict` with every stage sample and `update` with every pose; `tip` is the estimate at the newest stage
    sample. `counts` holds the number of poses for each `PoseUse`.

    Parameters
    ----------
    registration
        Distance from coil to tip, and the motion from the frame of the tracker to the frame of the plan.
    entry
        Pose on the surface of the tissue, at stage depth zero: x_mm, y_mm, heading_rad in the plane of the plan, and,
        if known, z_mm and elevation_rad out of it (0).
    planned_per_mm
        Curvature of the plan (1/mm): a positive number, or a function of x_mm, y_mm and z_mm.
    settings
        Standard deviations and limits; None means `TipSettings()`.
    fibre
        Curvature sensors along the needle, for `update_fibre`; None: the needle has none.
    plane
        Image plane of an ultrasound probe, for `update_image`; None: there is no probe.

    Raises
    ------
    DataError
        The entry or the curvature is not finite, or the curvature is not positive.
    """

    settings: TipSettings

    def __init__(
        self,
        registration: Registration,
        entry: tuple[float, ...],
        planned_per_mm: Planned,
        settings: TipSettings | None = None,
        fibre: FibreSensors | None = None,
        plane: ImagePlane | None = None,
    ) -> None:
        if len(entry) not in (3, 5) or not all(map(math.isfinite, entry)):
            rule = "must be finite numbers: x_mm, y_mm, heading_rad, and, if known, z_mm, elevation_rad"
            raise DataError(Mistake("entry", str(entry), rule))
        if not callable(planned_per_mm) and not 0 < planned_per_mm < math.inf:
            raise DataError(Mistake("planned_per_mm", f"{planned_per_mm}", "must be a number above 0, in 1/mm"))
        self.registration = registration
        self.settings = settings = settings or TipSettings()
        self._entry = entry
        self._gate = float(chdtri(5, settings.gate))
        self._channel: CutChannel | None = None
        self._stage = StageTrack()
        self._base_roll = 0.0
        # Length, state and covariance of the path: at the coil, and stored behind it.
        self._at = 0.0
        self._state, self._covariance = np.zeros(SIZE), np.zeros((SIZE, SIZE))
        self._past: list[tuple[float, Array, Array]] = []
        self._pose_ns: int | None = None
        self._used_ns: int | None = None
        self._doubt = 0
        self._lost = False
        self._cached: TipEstimate | None = None
        self._windows = FibreWindows(fibre, settings) if fibre else None
        self._images = ImageFixes(plane, settings) if plane else None
        self._predictor = PathPredictor(planned_per_mm, settings, self._windows, self._images)
        self.nis: float = math.nan
        """Normalised squared innovation of the last used or outlying pose, chi-squared with 5 degrees of freedom.

        NaN before the first such pose.
        """
        self.counts: dict[PoseUse, int] = dict.fromkeys(PoseUse, 0)

    @classmethod
    def for_scenario(
        cls,
        scenario: Scenario,
        registration: Registration,
        entry: tuple[float, ...],
        settings: TipSettings | None = None,
        fibre: FibreSensors | None = None,
        plane: ImagePlane | None = None,
    ) -> Self:
        """Return a filter with the planned curvature of a scenario, including its layers and tissues.

        Parameters
        ----------
        scenario : Scenario
            Scenario in the plane.
        registration, entry, settings, fibre, plane
            As in `TipFilter`.

        Returns
        -------
        TipFilter
        """
        planned: Planned = 1 / scenario.needle.curvature_radius_mm
        if not scenario.uniform:
            planned = PlaneCurvatureMap(scenario).at
        return cls(registration, entry, planned, settings, fibre, plane)

    def predict(self, sample: StageSample) -> None:
        """Take a stage sample. A sample is ignored if it is not GOOD, not finite, or not newer than the last one."""
        now, depth, roll = sample.stamp.received_ns, sample.depth_mm, sample.roll_rad
        if sample.health is not Health.GOOD or not math.isfinite(depth + roll + sample.velocity_mm_s):
            return
        if not self._stage.is_newer(now):
            return
        self._cached = None
        self._stage.add(now, depth, sample.velocity_mm_s)
        self._base_roll = roll
        if self._channel is None:
            self._channel = CutChannel(depth, roll)
            self._begin(min(depth - self.registration.coil_offset_mm, 0.0))
        else:
            left_at = self._channel.move(depth, roll)
            if left_at is not None:
                self._predictor.forget_beyond(left_at)
            if left_at is not None and left_at < self._at:
                # The path beyond is new, and no pose has measured it.
                self._at, self._state, self._covariance = self._path_at(left_at)
                del self._past[bisect_right(self._past, self._at, key=lambda past: past[0]) :]

    def update(self, sample: PoseSample) -> PoseUse:
        """Take a pose, and return how the filter used it."""
        use = self._take(sample)
        self.counts[use] += 1
        return use

    def update_fibre(self, sample: FibreSample) -> None:
        """Correct the estimate with a sample of the curvature sensors along the needle.

        A sensor corrects it each time that it has moved by its gauge length. Samples before the first stage sample are
        ignored. Raises DataError if the filter has no curvature sensors or another number of them, or if ten samples in
        a row have curvatures above 0.1 1/mm: they are in 1/m.
        """
        if self._windows is None:
            raise DataError(Mistake("fibre", "", "is missing: give TipFilter the sensors of the needle"))
        self._windows.require(sample)
        if self._channel is None:
            return
        for key in self._windows.read(sample, self._stage.depth_at(sample.stamp.received_ns), self._base_roll):
            self._predictor.forget()
            if key[1] <= self._windows.newest(self._at):
                now = self._state, self._covariance
                self._state, self._covariance = self._predictor.corrected(key, self._at, *now)
                self._cached = None

    def update_image(self, sample: ImageSample) -> PoseUse:
        """Take a detection of the tip in an image, and return how the filter used it; `counts` does not count it.

        Raises DataError if the filter has no image plane.
        """
        if self._images is None:
            raise DataError(Mistake("plane", "", "is missing: give TipFilter the image plane of the probe"))
        if self._channel is None:
            return PoseUse.EARLY
        if sample.health is not Health.GOOD or not math.isfinite(sample.u_mm + sample.v_mm):
            return PoseUse.SUSPECT if sample.health is Health.SUSPECT else PoseUse.MISSING
        measured_ns = sample.stamp.received_ns - round(self.settings.image_latency_s * _NANO)
        length = self._stage.depth_at(measured_ns)
        if length < self._at - _SAME_PLACE_MM:
            return PoseUse.WITHDRAWN
        waited_ns = math.inf if self._pose_ns is None else measured_ns - self._pose_ns
        if waited_ns > self.settings.coasting_s * _NANO:
            self._follow(length - self.registration.coil_offset_mm)
        place, (_, *predicted) = np.array([sample.u_mm, sample.v_mm]), self._path_at(length)
        if not self._images.agrees(place, *predicted):
            return PoseUse.OUTLIER
        self._cached = None
        if length > self._at:
            self._images.add(length, place, self._at)
            self._predictor.forget()
        else:
            self._state, self._covariance = self._images.used(place, self._state, self._covariance)
        self._used_ns = max(measured_ns, self._used_ns or measured_ns)
        return PoseUse.USED

    @property
    def tip(self) -> TipEstimate:
        """The tip at the newest stage sample. Raises DataError before the first stage sample."""
        self._cached = self._cached or self._estimate()
        return self._cached

    def tip_ahead(self, length_mm: float) -> TipEstimate:
        """Return the estimate that the tip will have after a further insertion without rotation.

        Raises DataError before the first stage sample.
        """
        return self._estimate(length_mm) if length_mm else self.tip

    def tip_state(self) -> tuple[Array, Array]:
        """Return state and covariance of the tip: of the shapes (11,) and (11, 11), and larger with curvature sensors.

        `tip._path` defines the first eleven columns.

        Raises DataError before the first stage sample.
        """
        return self.ahead(0.0)

    def ahead(self, length_mm: float) -> tuple[Array, Array]:
        """Return state and covariance that the tip will have after a further insertion without rotation.

        The change of the curvature per length is included; it decays over `change_mm`. Shapes and errors are those of
        `tip_state`.
        """
        if self._channel is None:
            raise DataError("the tip filter has not had a stage sample yet")
        _, state, covariance = self._path_at(self._channel.length_mm + length_mm)
        forward = tangent(state)
        covariance = covariance.copy()
        covariance[:3, :3] += self.registration.coil_offset_sd_mm**2 * np.outer(forward, forward)
        return state, covariance

    def mean_curvature(self, length_mm: float) -> tuple[float, float]:
        """Return the expected mean curvature (1/mm) over the next length (mm) of path, and its standard deviation.

        The planned curvature is that at the tip. Raises DataError before the first stage sample.
        """
        state, covariance = self.tip_state()
        weights = np.zeros(state.size)
        weights[FACTOR], weights[CHANGE] = 1.0, mean_gained(length_mm, self.settings.change_mm)
        planned = self._predictor.planned_at(state)
        return float(weights @ state) * planned, math.sqrt(float(weights @ covariance @ weights)) * planned

    def _begin(self, at_mm: float) -> None:
        """Set state and covariance at the path length `at_mm`, from the entry pose and its standard deviations."""
        self._state, self._covariance = begun(self._entry, at_mm, self.settings)
        if self._windows:
            self._state, self._covariance = self._windows.start(self._state, self._covariance)
        self._at = at_mm
        self._past = [(at_mm, self._state, self._covariance)]

    def _take(self, sample: PoseSample) -> PoseUse:
        if self._channel is None:
            return PoseUse.EARLY
        if sample.health is Health.MISSING:
            return PoseUse.MISSING
        if sample.health is not Health.GOOD:
            return PoseUse.SUSPECT
        if not all(map(math.isfinite, (*sample.position_mm, *sample.quaternion))) or not any(sample.quaternion):
            return PoseUse.MISSING
        measured_ns = sample.stamp.received_ns - round(self.settings.latency_s * _NANO)
        if self._pose_ns is not None and measured_ns <= self._pose_ns:
            return PoseUse.STALE
        if self._pose_ns is not None and self.settings.wander_sd_mm:
            passed_s = (measured_ns - self._pose_ns) / _NANO
            self._state, self._covariance = wandered(self._state, self._covariance, passed_s, self.settings)
        self._pose_ns = measured_ns
        at = self._stage.depth_at(measured_ns) - self.registration.coil_offset_mm
        if at < self._at - _SAME_PLACE_MM:
            return PoseUse.WITHDRAWN
        self._cached = None
        self._follow(at)
        used = self._correct(sample)
        self._store()
        if used:
            self._used_ns = measured_ns
        self._doubt = max(self._doubt - 1, 0) if used else min(self._doubt + 1, 2 * self.settings.lost_after)
        self._lost = self._doubt > 0 if self._lost else self._doubt >= self.settings.lost_after
        return PoseUse.USED if used else PoseUse.OUTLIER

    def _follow(self, length_mm: float) -> None:
        """Move the state to a path length, unless the state is already there or beyond."""
        assert self._channel is not None
        if length_mm > self._at:
            self._at, self._state, self._covariance = self._predictor.onwards(
                self._channel, self._at, self._state, self._covariance, length_mm
            )
            self._store()

    def _store(self) -> None:
        """Store the state for the path behind it, if it is far enough from the last one or replaces it."""
        now = (self._at, self._state, self._covariance)
        if self._at - self._past[-1][0] >= _SPACING_MM:
            self._past.append(now)
        elif self._at == self._past[-1][0]:
            self._past[-1] = now

    def _correct(self, sample: PoseSample) -> bool:
        """Set `nis`, and return whether the pose agrees with the state. An agreeing pose corrects the state."""
        settings = self.settings
        position, direction = self.registration.place(sample.position_mm, sample.quaternion)
        level = math.hypot(direction[0], direction[1])
        seen = np.array([*position, math.atan2(direction[1], direction[0]), math.atan2(direction[2], level)])
        model = np.zeros((5, self._state.size))
        model[:, :SIZE] = _SEEN
        expected = model @ self._state
        left = seen - expected
        left[3] = math.remainder(left[3], 2 * math.pi)
        angle = settings.angle_sd_rad
        # The noise of the heading grows with the elevation.
        across = angle / max(math.cos(float(self._state[ELEVATION])), 1e-3)
        noise = np.diag(np.array([settings.position_sd_mm] * 3 + [across, angle]) ** 2)
        spread = model @ self._covariance @ model.T + noise
        self.nis = float(left @ np.linalg.solve(spread, left))
        if not self.nis <= self._gate:
            return False
        state, covariance = kalman_update(self._state, self._covariance, expected + left, noise, model)
        self._state, self._covariance = np.asarray(state, float), np.asarray(covariance + covariance.T) / 2
        return True

    def _path_at(self, length_mm: float) -> tuple[float, Array, Array]:
        """Return `length_mm`, and state and covariance of the path at this path length.

        In front of the coil they are predicted from the coil, behind it from the nearest stored state before.
        """
        at, state, covariance = self._at, self._state, self._covariance
        if length_mm < at:
            number = max(bisect_right(self._past, length_mm, key=lambda past: past[0]) - 1, 0)
            at, state, covariance = self._past[number]
        assert self._channel is not None
        return self._predictor.onwards(self._channel, at, state, covariance, length_mm)

    def _estimate(self, length_mm: float = 0.0) -> TipEstimate:
        state, covariance = self.ahead(length_mm)
        assert self._channel is not None
        settings = self.settings
        pending = abs(self._base_roll - self._channel.last_roll_rad)
        sd = np.sqrt(np.maximum(np.diag(covariance)[:SIZE], 0.0)).tolist()
        x, y, z, heading, elevation, factor, offset = state[:7].tolist()
        change = float(state[CHANGE])
        planned = self._predictor.planned_at(state)
        now, depth = self._stage.newest
        age = math.inf if self._used_ns is None else max(now - self._used_ns, 0) / _NANO
        forward = tangent(state)
        across = float(np.trace(covariance[:3, :3]) - forward @ covariance[:3, :3] @ forward)
        if self._lost or across > 2 * settings.lost_sd_mm**2:
            status = TipStatus.LOST
        elif self._used_ns is None:
            status = TipStatus.WAITING
        else:
            status = TipStatus.COASTING if age > settings.coasting_s else TipStatus.TRACKING
        return TipEstimate(
            time_ns=now, status=status, x_mm=x, y_mm=y, z_mm=z, heading_rad=math.remainder(heading, 2 * math.pi),
            elevation_rad=elevation, roll_rad=self._base_roll + offset, curvature_per_mm=factor * planned,
            curvature_factor=factor, x_sd_mm=sd[0], y_sd_mm=sd[1], z_sd_mm=sd[2], heading_sd_rad=sd[HEADING],
            elevation_sd_rad=sd[ELEVATION],
            roll_sd_rad=math.hypot(sd[ROLL], settings.roll_sd_sqrt_rad * math.sqrt(pending)),
            curvature_sd_per_mm=sd[FACTOR] * planned, curvature_factor_sd=sd[FACTOR], depth_mm=depth, pose_age_s=age,
            curvature_factor_change_per_mm=change, curvature_factor_change_sd_per_mm=sd[CHANGE],
        )  # fmt: skip
