"""The bank of three joint extended Kalman filters as the thesis describes it (section 2.4, Table 2.1).

Each filter estimates z and one or two parameters, in natural units, and takes the others as known; its estimates go
into the model before the next one is triggered. z takes a step of Kutta's method. This is the published form, for
comparison: it is easily lost, and its final parameters mean little. `identify_by_passes` is the one to use.

What the text leaves open is a choice here (`BankSettings`):

- *The exponents of Q.* Printed are 0.05 * 10^(+3 to +15). The standard deviation of a step of sigma1 would be 7e6 where
  sigma1 is 2.5, and the +-3 sigma bands of Fig. 2.5 could not be drawn. With negative exponents the steps are sane: a
  minus sign that was lost is our reading, and the default.
- *The order of triggering.* All three filters on every sample, each from the same z of the sample before (otherwise z
  would advance three times), or one filter a sample in turn.
- *P0.* "Large"; either (5 theta)^2, as the starts are within +-500 %, or a constant, up to the 10^15 of the text.
- *P0 and Q of z*, which are not given.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from needleplan.estimation import ScalarKalmanFilter
from needleplan.identification import FilterStatus, Track
from needleplan.models.force import DepthForce, ForceModel1, ForceModel2
from needleplan.models.force.sensitivity import NAMES, Row, Values, force, kutta_step
from needleplan.signals import Array, Record

__all__ = ["TABLE_2_1", "BankRun", "BankSettings", "Exponents", "Trigger", "run_bank"]

TABLE_2_1: Mapping[type[DepthForce], tuple[dict[str, int], ...]] = {
    ForceModel1: ({"f2": 5, "sigma0": 9}, {"f1": 15, "sigma1": 15}, {"alpha": 5, "sigma2": 15}),
    ForceModel2: ({"sigma0": 9}, {"f1": 15, "sigma1": 15}, {"beta": 3, "sigma2": 15}),
}
"""The parameters of each filter with the printed exponents of their variances, Q = 0.05 diag(10^n)."""


class Exponents(StrEnum):
    """How the exponents of Table 2.1 are read."""

    NEGATIVE = "negative"
    """0.05 * 10^-n: steps that are small beside the parameters."""

    AS_PRINTED = "as_printed"
    """0.05 * 10^n: every parameter is new at every sample."""


class Trigger(StrEnum):
    """Which filters take a sample."""

    ALL_IN_SEQUENCE = "all_in_sequence"
    ONE_IN_TURN = "one_in_turn"


@dataclass(frozen=True)
class BankSettings:
    """The choices that the text leaves open; see the module.

    `initial_variance` None means (5 theta)^2 for each parameter. `filters` replaces the pairing of Table 2.1.
    """

    exponents: Exponents = Exponents.NEGATIVE
    trigger: Trigger = Trigger.ALL_IN_SEQUENCE
    initial_variance: float | None = None
    measurement_variance: float = 0.01
    """R in N^2, as printed."""

    state_sd: float = 0.0
    state_walk: float = 0.0
    filters: tuple[dict[str, int], ...] | None = None


@dataclass(frozen=True)
class BankRun:
    """What the bank said; `values` are the final parameters, which need not be those of any model.

    `track` has natural +-3 sigma limits; it ends where the bank diverged.
    """

    status: FilterStatus
    values: dict[str, float]
    track: Track


def run_bank(model: DepthForce, record: Record, settings: BankSettings | None = None) -> BankRun:
    """Run the bank along a record from the parameters of `model`.

    Raises DataError for a record without force or motion.
    """
    settings = settings or BankSettings()
    definition = settings.filters or TABLE_2_1[type(model)]
    motion, measured = record.motion(), record["force_n"]
    instants = zip(
        motion.time_s.tolist(), motion.depth_mm.tolist(), motion.direction.tolist(), measured.tolist(), strict=True
    )
    bank = _Bank(model, definition, settings)
    with np.errstate(all="ignore"):
        said = []
        for instant in instants:
            try:
                said.append(bank.take(*instant))
            except (ArithmeticError, ValueError, np.linalg.LinAlgError):
                break  # g has gone through zero, or a number has left the range of numbers
    status = FilterStatus.DONE if len(said) == len(measured) else FilterStatus.DIVERGED
    return BankRun(status, dict(zip(NAMES, bank.values, strict=True)), _track(record, bank, said))


_Said = tuple[float, float, float, list[float], list[float]]
"""Prediction, innovation, its standard deviation, (z, parameters), their standard deviations."""


class _Bank:
    def __init__(self, model: DepthForce, definition: tuple[dict[str, int], ...], settings: BankSettings) -> None:
        self.settings = settings
        self.values = [float(getattr(model, name)) for name in NAMES]
        self.z = 0.0
        self.places = [[NAMES.index(name) for name in each] for each in definition]
        self.names = [name for each in definition for name in each]
        sign = -1 if settings.exponents is Exponents.NEGATIVE else 1
        self.filters = []
        for places, each in zip(self.places, definition, strict=True):
            known = np.array([self.values[place] for place in places])
            variances = (5 * known) ** 2 if settings.initial_variance is None else settings.initial_variance
            covariance = np.diag([settings.state_sd**2, *np.broadcast_to(variances, known.shape)])
            walk = np.diag([settings.state_walk, *(0.05 * 10.0 ** (sign * n) for n in each.values())])
            self.filters.append(
                ScalarKalmanFilter(np.array([0.0, *known]), covariance, walk, settings.measurement_variance)
            )  # fmt: skip
        self.before: tuple[float, float] | None = None
        self.count = 0

    def take(self, time: float, depth: float, direction: float, measured: float) -> _Said:
        in_turn = self.settings.trigger is Trigger.ONE_IN_TURN
        triggered = [self.count % len(self.filters)] if in_turn else range(len(self.filters))
        self.count += 1
        last = self.z
        prior: tuple[float, float] | None = None
        for number in triggered:
            kalman, places = self.filters[number], self.places[number]
            kalman.x = np.array([last, *(self.values[place] for place in places)])
            if self.before is not None:
                was, at = self.before
                row = kutta_step(last, self._all(), (at, (at + depth) / 2, depth), time - was)
                change = np.eye(len(kalman.x))
                change[0] = _part(row, places)
                kalman.advance(np.array([row[0], *kalman.x[1:]]), change)
            row = force(float(kalman.x[0]), self._all(), depth, direction)
            gradient = np.array(_part(row, places))
            spread = float(gradient @ kalman.P @ gradient) + self.settings.measurement_variance
            prior = prior or (row[0], spread)
            if math.isfinite(measured):
                kalman.correct(measured, row[0], gradient)
            if kalman.lost:
                raise ArithmeticError
            self.z, *found = kalman.x.tolist()
            for place, value in zip(places, found, strict=True):
                self.values[place] = value
        self.before = (time, depth)
        assert prior is not None
        variances = [
            each.P[k + 1, k + 1]
            for each, places in zip(self.filters, self.places, strict=True)
            for k in range(len(places))
        ]
        variances.insert(0, self.filters[triggered[-1]].P[0, 0])
        estimates = [self.z, *(self.values[NAMES.index(name)] for name in self.names)]
        sds = np.sqrt(np.maximum(variances, 0.0)).tolist()
        return prior[0], measured - prior[0], math.sqrt(max(prior[1], 0.0)), estimates, sds

    def _all(self) -> Values:
        sigma0, sigma1, sigma2, f1, f2, alpha, beta = self.values
        return sigma0, sigma1, sigma2, f1, f2, alpha, beta


def _part(row: Row, places: list[int]) -> list[float]:
    return [row[1], *(row[2][place] for place in places)]


def _track(record: Record, bank: _Bank, said: list[_Said]) -> Track:
    n = len(said)
    predicted, innovation, spread = (np.array([each[k] for each in said]) for k in range(3))
    width = 1 + len(bank.names)
    x: Array = np.array([each[3] for each in said]).reshape(n, width)
    sd: Array = np.array([each[4] for each in said]).reshape(n, width)
    bands = [(x[:, k] - 3 * sd[:, k], x[:, k], x[:, k] + 3 * sd[:, k]) for k in range(width)]
    return Track(
        record["time_s"][:n], record["depth_mm"][:n], predicted, innovation, spread, np.isfinite(innovation),
        dict(zip(bank.names, bands[1:], strict=True)), bands[0],
    )  # fmt: skip
