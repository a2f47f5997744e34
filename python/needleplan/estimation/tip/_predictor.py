"""Prediction of the tip filter along the channel, with the windows of the curvature sensors on the way."""

from __future__ import annotations

import math
from collections.abc import Callable

from scipy.special import chdtri

from needleplan.estimation.tip._estimate import TipSettings
from needleplan.estimation.tip._images import ImageFixes
from needleplan.estimation.tip._path import ChannelPiece, CutChannel, moved, tangent
from needleplan.estimation.tip._windows import FibreWindows
from needleplan.signals import Array

__all__ = ["PathPredictor", "Planned"]

Planned = float | Callable[[float, float, float], float]

# Longest piece (mm) of one prediction step: in a longer piece, the covariance of a straight chord is too inaccurate.
_LONGEST_MM = 5.0

# Step (mm) along the path at which a planned curvature that depends on the place is evaluated.
_LOOKED_UP_MM = 1.0

# Path length (mm) below which two places are the same.
_SAME_MM = 1e-9

_Place = tuple[float, Array, Array]


class PathPredictor:
    """Predicts state and covariance along the channel.

    Parameters
    ----------
    planned_per_mm
        Curvature of the plan: a number, or a function of x_mm, y_mm and z_mm.
    settings
        Standard deviations and limits of the filter.
    windows
        Readings of the curvature sensors; None: the needle has none.
    images
        Positions of the tip in images; None: there is no probe.
    """

    def __init__(
        self, planned_per_mm: Planned, settings: TipSettings, windows: FibreWindows | None, images: ImageFixes | None
    ) -> None:
        self._planned = planned_per_mm
        self._settings = settings
        self._windows = windows
        self._images = images
        self._gate = float(chdtri(2, settings.gate))
        # Beginning and last stop of the newest prediction: path length, state and covariance.
        self._kept: tuple[_Place, _Place] | None = None

    def forget(self) -> None:
        """Discard the stored prediction, because measurements or the channel ahead of its beginning have changed."""
        self._kept = None

    def forget_beyond(self, length_mm: float) -> None:
        """Discard measurements beyond a path length, at which the tip has left its channel for a new one."""
        self.forget()
        for measurements in (self._windows, self._images):
            if measurements:
                measurements.forget_beyond(length_mm)

    def planned_at(self, state: Array) -> float:
        """Return the curvature of the plan (1/mm) at a state."""
        return self._planned(*state[:3].tolist()) if callable(self._planned) else self._planned

    def onwards(
        self, channel: CutChannel, at: float, state: Array, covariance: Array, until_mm: float
    ) -> tuple[float, Array, Array]:
        """Predict from the path length `at` to `until_mm`; return `until_mm`, state and covariance there.

        If `until_mm` is smaller, the path is extrapolated backwards as a straight line. A prediction from the same
        state goes on from the last stop of the one before: the end of a window, or an image. The result is the same.
        """
        if until_mm < at:
            # Before the first stored state the path is extrapolated as a straight line.
            state = state.copy()
            state[:3] += (until_mm - at) * tangent(state)
            return until_mm, state, covariance
        begin = (at, state, covariance)
        if self._kept and self._kept[0][1] is state and self._kept[0][2] is covariance and self._kept[1][0] <= until_mm:
            at, state, covariance = self._kept[1]
        while at < until_mm:
            if at <= channel.settled_mm:
                self._kept = begin, (at, state, covariance)
            end = min(until_mm, self._window_end(at), self._images.following(at) if self._images else until_mm)
            for piece in channel.pieces(at, end):
                for part in self._parts(piece):
                    state, covariance = moved(state, covariance, part, self.planned_at(state), self._settings)
            at = end
            if self._images:
                state, covariance = self._images.corrected(at, state, covariance)
            if self._windows and at >= 0 and self._window_end(at) - at >= self._windows.gauge_mm - _SAME_MM:
                state, covariance = self._windows.ended(state, covariance)
                for key in self._windows.complete(self._windows.newest(at)):
                    state, covariance = self.corrected(key, at, state, covariance)
        return until_mm, state, covariance

    def corrected(self, key: tuple[int, int], at: float, state: Array, covariance: Array) -> tuple[Array, Array]:
        """Return state and covariance at the path length `at` after a complete (sensor, window)."""
        assert self._windows is not None
        return self._windows.corrected(key, self._windows.newest(at), state, covariance, self._gate)

    def _window_end(self, at: float) -> float:
        """Return the next path length at which a window ends, or the first begins; infinite without sensors."""
        if self._windows is None:
            return math.inf
        return 0.0 if at < 0 else self._windows.gauge_mm * (self._windows.newest(at) + 2)

    def _parts(self, piece: ChannelPiece) -> list[ChannelPiece]:
        """Cut a piece into equal parts that are short enough for one prediction step, and return the parts."""
        longest = _LOOKED_UP_MM if callable(self._planned) else _LONGEST_MM
        if piece.length_mm <= longest or not piece.fresh:
            return [piece]
        count = math.ceil(piece.length_mm / longest)
        part = piece._replace(length_mm=piece.length_mm / count)
        return [part, *[part._replace(turned_rad=0.0)] * (count - 1)]
