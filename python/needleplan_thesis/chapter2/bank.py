"""The bank of three joint extended Kalman filters of the thesis (section 2.4, Table 2.1).

Each filter estimates the state z and one or two parameters in natural units, and treats the other parameters as known.
The estimates of a filter enter the model before the next filter is triggered. The prediction of z is a step of Kutta's
method. This is the published form, kept for comparison: it diverges easily, and its final parameters predict poorly.
Use `needleplan.identification.identify_by_passes` for identification.

`BankSettings` holds the choices that the text leaves open:

- *The exponents of Q.* The thesis prints 0.05 * 10^(+3 to +15). One step of sigma1 would have a standard deviation of
  7e6, although sigma1 is 2.5, and the +-3 sigma bands of Fig. 2.5 could not be drawn. The default assumes that a minus
  sign was lost: negative exponents give plausible steps.
- *The order of triggering.* Either all three filters process every sample, or the filters take turns, one filter a
  sample. If all three do, each starts from the z of the previous sample, because z would otherwise advance three times.
- *P0.* The thesis calls it "large". Either (5 theta)^2, because the starting values are within +-500 %, or a constant
  of up to 10^15, as in the text.
- *P0 and Q of z.* The thesis gives no values.
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
"""For each model and filter, the parameters with the printed exponents n of their process variances 0.05 * 10^n."""


class Exponents(StrEnum):
    """Sign of the exponents of Table 2.1."""

    NEGATIVE = "negative"
    """Variance 0.05 * 10^-n: steps are small compared with the parameters."""

    AS_PRINTED = "as_printed"
    """Variance 0.05 * 10^n: a step is so large that the previous value of a parameter has no influence."""


class Trigger(StrEnum):
    """Which filters process a sample."""

    ALL_IN_SEQUENCE = "all_in_sequence"
    """Every filter processes every sample."""

    ONE_IN_TURN = "one_in_turn"
    """One filter processes each sample; the filters take turns."""


@dataclass(frozen=True)
class BankSettings:
    """Choices that the text of the thesis leaves open; see the module docstring.

    - `initial_variance`: initial variance P0 of each parameter; None means (5 theta)^2
    - `state_sd`, `state_walk`: initial standard deviation and process variance of z
    - `filters`: parameters and exponents of each filter, in the form of `TABLE_2_1`; None means that table
    """

    exponents: Exponents = Exponents.NEGATIVE
    trigger: Trigger = Trigger.ALL_IN_SEQUENCE
    initial_variance: float | None = None
    measurement_variance: float = 0.01
    """Measurement variance R (N^2), as printed."""

    state_sd: float = 0.0
    state_walk: float = 0.0
    filters: tuple[dict[str, int], ...] | None = None


@dataclass(frozen=True)
class BankRun:
    """Result of the bank: status, final parameters, and the estimates at every sample.

    The final parameters `values` may lie outside the bounds of the model. `track` has +-3 sigma limits; it ends before
    the sample at which the bank diverged.
    """

    status: FilterStatus
    values: dict[str, float]
    track: Track


def run_bank(model: DepthForce, record: Record, settings: BankSettings | None = None) -> BankRun:
    """Run the bank of filters over a record, starting from the parameters of `model`.

    A divergence ends the run and is reported by the status. Raises DataError if the record lacks force or motion.
    """
    settings = settings or BankSettings()
    definition = settings.filters or TABLE_2_1[type(model)]
    motion, measured = record.motion(), record["force_n"]
    instants = zip(
        motion.time_s.tolist(), motion.depth_mm.tolist(), motion.direction.tolist(), measured.tolist(), strict=True
    )
    bank = _Bank(model, definition, settings)
    with np.errstate(all="ignore"):
        samples = []
        for instant in instants:
            try:
                samples.append(bank.take(*instant))
            except (ArithmeticError, ValueError, np.linalg.LinAlgError):
                break  # the bank diverged: g crossed zero, or a number overflowed
    status = FilterStatus.DONE if len(samples) == len(measured) else FilterStatus.DIVERGED
    return BankRun(status, dict(zip(NAMES, bank.values, strict=True)), _track(record, bank, samples))


_Sample = tuple[float, float, float, list[float], list[float]]
"""Predicted force, innovation and its standard deviation (N); estimates of z and the parameters; their deviations."""


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

    def take(self, time: float, depth: float, direction: float, measured: float) -> _Sample:
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


def _track(record: Record, bank: _Bank, samples: list[_Sample]) -> Track:
    n = len(samples)
    predicted, innovation, spread = (np.array([sample[k] for sample in samples]) for k in range(3))
    width = 1 + len(bank.names)
    x: Array = np.array([sample[3] for sample in samples]).reshape(n, width)
    sd: Array = np.array([sample[4] for sample in samples]).reshape(n, width)
    bands = [(x[:, k] - 3 * sd[:, k], x[:, k], x[:, k] + 3 * sd[:, k]) for k in range(width)]
    return Track(
        record["time_s"][:n], record["depth_mm"][:n], predicted, innovation, spread, np.isfinite(innovation),
        dict(zip(bank.names, bands[1:], strict=True)), bands[0],
    )  # fmt: skip
