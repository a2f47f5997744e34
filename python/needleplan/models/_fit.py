"""Identification of model parameters from records by nonlinear least squares.

The fit works in the coordinates u of `Scale`: u = ln(p), or p divided by its typical magnitude. With the residuals r =
measured - simulated(u) it minimises |r|^2 within the ranges of the parameters (SciPy's trust-region reflective method).
The covariance of u is that of least squares with autoregressive noise, which is fitted to the residuals
(`_noise_model`). It stays valid if neighbouring noise samples are correlated, as after a sensor's filter. With a number
of lags m, it is the kernel estimator of Newey and West (Econometrica 55 (1987) 703)::

    C = (J'J)^-1 S (J'J)^-1,    S = sum over lags |k| <= m of (1 - |k|/(m+1)) sum_i J_i r_i r_(i+k) J_(i+k)'

The 95 % intervals are u +- t sd, clipped to the range and transformed to p. For parameters with a logarithmic scale the
intervals are therefore asymmetric.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from needleplan.errors import DataError, Mistake, ModelError
from needleplan.models._base import Model
from needleplan.models._estimates import Estimate, Fit, FitStatus
from needleplan.models._noise_model import noise_model
from needleplan.models._parameter import Parameter
from needleplan.models._simulate import require_model, simulate
from needleplan.signals import Array, Record, records_of

__all__ = ["fit"]

# Largest residual, in the unit of the channel; it replaces larger residuals and NaN of a simulation that grew without
# bound.
_DIVERGED = 1e6
# Standard deviation of a coordinate above which its parameter counts as not identified; 1 is a factor of e.
_UNKNOWN_SD = 1.0
# Singular values of the scaled Jacobian below this share of the largest one count as zero. The Jacobian consists of
# differences, so that two equal columns differ by rounding: by some 1e-7.
_SINGULAR = 1e-6
# Weight of a coordinate in a direction above which its parameter takes part in the trade.
_TRADES = 0.1


def fit(
    model: Model,
    data: Record | Sequence[Record],
    *,
    free: Sequence[str] | None = None,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    smooth: Callable[[Array], Array] | None = None,
    mask: Callable[[Record], NDArray[Any]] | None = None,
    starts: int = 1,
    spread: float = 1.0,
    seed: int = 0,
    lags: int | None = None,
    max_evaluations: int = 400,
) -> Fit:
    """Identify parameters of a model from one or more records.

    Parameters
    ----------
    model : Model
        The model; its values are the first start.
    data : Record, DataFrame, or sequence of these
        Records, or tables of columns as in data files, with the motion and the model's channel. All together determine
        one set of parameters.
    free : sequence of str, optional
        Names of the parameters to estimate. The default is all parameters that the model declares free.
    bounds : mapping of str to (float, float), optional
        Narrower ranges by parameter name. Parameters that are not in `free` have no effect.
    smooth : callable, optional
        Filter that is applied to the simulated output before the comparison. Use the filter that the sensor applied to
        the measured signal, such as a moving average.
    mask : callable, optional
        Function from a record to the samples to use, bool of shape (samples,). Samples whose measurement is not finite
        are never used.
    starts : int
        Number of starts, at least one. Further starts are drawn at random around the first; `fit` returns the result
        with the smallest residual.
    spread : float
        Standard deviation of the further starts, in coordinates.
    seed : int
        Seed of the further starts.
    lags : int, optional
        Number of lags of a kernel estimator of the covariance. None: autoregressive noise, whose order the BIC chooses.
    max_evaluations : int
        Limit of the evaluations of the residuals for each start, without those for the Jacobian.

    Returns
    -------
    Fit
        The identified model with intervals and residuals.

    Raises
    ------
    DataError
        If there is no record, or the records are too short, are constant, contain no motion, or lack a column.
    ModelError
        If `free` is empty, or `free` or `bounds` names an unknown parameter.

    Examples
    --------
    The curvature of a simulated path with 0.1 mm of measurement noise:

    >>> import numpy as np
    >>> import needleplan as npl
    >>> from needleplan.signals import Record, insertion_cycles
    >>> motion = insertion_cycles(60.0, 10.0, rate_hz=20.0)
    >>> noise = np.random.default_rng(0).normal(0.0, 0.1, len(motion))
    >>> measured = npl.models.simulate(npl.models.Bicycle(curvature_per_mm=0.01), motion).output + noise
    >>> record = Record({"time_s": motion.time_s, "depth_mm": motion.depth_mm, "y_mm": measured})
    >>> found = npl.models.fit(npl.models.Bicycle(curvature_per_mm=0.005), record)
    >>> curvature = found.estimates["curvature_per_mm"]
    >>> found.ok, curvature.low < 0.01 < curvature.high
    (True, True)
    """
    from scipy.optimize import least_squares

    require_model(model)
    records = tuple(records_of(data))
    _require_known(model, bounds or {})
    problem = _Problem(model, records, _free(model, free), bounds or {}, smooth, mask)
    generator = np.random.default_rng(seed)
    first = problem.start()
    best = None
    evaluations = 0
    for number in range(max(starts, 1)):
        start = first if number == 0 else problem.inside(first + spread * generator.standard_normal(first.size))
        result = least_squares(
            problem.residual, start, bounds=problem.bounds, x_scale="jac", max_nfev=max_evaluations, method="trf"
        )
        evaluations += result.nfev
        if best is None or result.cost < best.cost:
            best = result
    assert best is not None
    return problem.conclude(best.x, np.asarray(best.jac, float), best.status, evaluations, lags)


def _free(model: Model, free: Sequence[str] | None) -> tuple[str, ...]:
    if free is None:
        return tuple(name for name, parameter in model.parameters().items() if parameter.free)
    if not free:
        raise ModelError(Mistake("free", "", "must name a parameter"), model.name)
    _require_known(model, free)
    return tuple(free)


def _require_known(model: Model, names: Iterable[str]) -> None:
    known = model.parameters()
    unknown = [Mistake(name, "", f"must be one of {', '.join(known)}") for name in names if name not in known]
    if unknown:
        raise ModelError(unknown, model.name)


class _Problem:
    """Least squares in the coordinates of the free parameters."""

    def __init__(
        self,
        model: Model,
        records: tuple[Record, ...],
        free: tuple[str, ...],
        bounds: Mapping[str, tuple[float, float]],
        smooth: Callable[[Array], Array] | None,
        mask: Callable[[Record], NDArray[Any]] | None,
    ) -> None:
        if not records:
            raise DataError(Mistake("data", "", "there is no record"))
        self.model, self.records, self.free, self.smooth = model, records, free, smooth
        self.what: list[Parameter] = [model.parameters()[name] for name in free]
        self.motions = [record.motion() for record in records]
        self.measured = [record[model.channel] for record in records]
        self.masks = [
            np.isfinite(measured) & (True if mask is None else mask(record))
            for record, measured in zip(records, self.measured, strict=True)
        ]
        self.samples = int(sum(each.sum() for each in self.masks))
        self._require_enough()
        ranges = [
            bounds.get(name, (parameter.lower, parameter.upper))
            for name, parameter in zip(free, self.what, strict=True)
        ]
        self.bounds = (
            np.array([parameter.coordinate(low) for parameter, (low, _) in zip(self.what, ranges, strict=True)]),
            np.array([parameter.coordinate(high) for parameter, (_, high) in zip(self.what, ranges, strict=True)]),
        )

    def _require_enough(self) -> None:
        if self.samples < 5 * len(self.free):
            rule = f"too short: {len(self.free)} parameters need at least {5 * len(self.free)} samples"
            raise DataError(Mistake(self.model.channel, f"{self.samples} samples", rule))
        if all(np.ptp(motion.depth_mm) == 0 and not motion.velocity_mm_s.any() for motion in self.motions):
            raise DataError(Mistake("depth_mm", "", "is constant: a needle at rest does not determine any parameter"))
        counted = [measured[mask] for measured, mask in zip(self.measured, self.masks, strict=True) if mask.any()]
        if all(np.ptp(measured) == 0 for measured in counted):
            rule = "is constant to the last bit: no sensor measures that, and nothing can be identified from it"
            raise DataError(Mistake(self.model.channel, f"{counted[0][0]:g}", rule))

    def start(self) -> Array:
        values = [getattr(self.model, name) for name in self.free]
        return self.inside(
            np.array([parameter.coordinate(value) for parameter, value in zip(self.what, values, strict=True)])
        )

    def inside(self, coordinates: Array) -> Array:
        """Return the coordinates, clipped to lie strictly within the bounds, shape (p,)."""
        low, high = self.bounds
        margin = 1e-6 * np.minimum(high - low, 1.0)
        return np.clip(coordinates, low + margin, high - margin)

    def model_at(self, coordinates: Array) -> Model:
        values = {
            name: float(np.clip(parameter.value(float(u)), parameter.lower, parameter.upper))
            for name, parameter, u in zip(self.free, self.what, coordinates, strict=True)
        }
        return self.model.with_values(**values)

    def simulated(self, coordinates: Array) -> list[Array]:
        model = self.model_at(coordinates)
        outputs = [simulate(model, motion).output for motion in self.motions]
        with np.errstate(over="ignore", invalid="ignore"):  # `residual` replaces infinity and NaN
            return outputs if self.smooth is None else [self.smooth(output) for output in outputs]

    def residual(self, coordinates: Array) -> Array:
        parts = [
            (measured - output)[mask]
            for measured, output, mask in zip(self.measured, self.simulated(coordinates), self.masks, strict=True)
        ]
        residual: Array = np.clip(np.nan_to_num(np.concatenate(parts), nan=_DIVERGED), -_DIVERGED, _DIVERGED)
        return residual

    def conclude(self, coordinates: Array, jacobian: Array, ending: int, evaluations: int, lags: int | None) -> Fit:
        from scipy import stats

        residual = self.residual(coordinates)
        covariance, condition, undetermined, freedom = self._uncertainty(jacobian, residual, lags)
        model = self.model_at(coordinates)
        quantiles = np.atleast_1d(stats.t.ppf(0.975, freedom))
        low, high = self.bounds
        at_bound = (coordinates - low < 1e-4) | (high - coordinates < 1e-4)
        diverged = bool((np.abs(residual) >= _DIVERGED).any())
        status = (
            FitStatus.DIVERGED if diverged
            else FitStatus.EVALUATION_LIMIT if ending <= 0
            else FitStatus.AT_BOUND if at_bound.any()
            else FitStatus.CONVERGED
        )  # fmt: skip
        estimates = {}
        for index, (name, parameter) in enumerate(zip(self.free, self.what, strict=True)):
            sd, u, value = float(np.sqrt(covariance[index, index])), float(coordinates[index]), getattr(model, name)
            ends = [float(np.clip(u + sign * quantiles[index] * sd, low[index], high[index])) for sign in (-1, 1)]
            known = sd < _UNKNOWN_SD and not at_bound[index]
            estimates[name] = Estimate(
                value,
                sd * parameter.slope(value),
                parameter.value(ends[0]),
                parameter.value(ends[1]),
                parameter.unit,
                known,
            )
        left = [
            np.where(mask, measured - output, np.nan)
            for measured, output, mask in zip(self.measured, self.simulated(coordinates), self.masks, strict=True)
        ]
        total = sum(measured.size for measured in self.measured)
        rmse = float(np.sqrt(np.mean(residual**2)))
        return Fit(
            model, status, self.free, estimates, covariance, tuple(left), rmse, self.samples, total - self.samples,
            condition, undetermined, evaluations,
        )  # fmt: skip

    def _uncertainty(
        self, jacobian: Array, residual: Array, lags: int | None
    ) -> tuple[Array, float, tuple[dict[str, float], ...], Array]:
        bare = np.linalg.svd(jacobian, compute_uv=False)
        condition = float(bare[0] / bare[-1]) if bare[-1] > 0 else float("inf")
        # Columns of unit length: then a small singular value says that columns nearly agree, not that one is short.
        length = np.linalg.norm(jacobian, axis=0)
        length[length <= _SINGULAR * length.max(initial=0.0)] = np.inf
        _, singular, directions = np.linalg.svd(jacobian / length, full_matrices=False)
        flat = singular <= _SINGULAR * singular[0]
        root = (directions[~flat].T / singular[~flat]) / length[:, None]
        inverse = root @ root.T
        freedom = np.full(len(self.free), float(max(self.samples - len(self.free), 1)))
        if lags is None:
            scores, freedom = self._autoregressive(jacobian, residual, inverse)
        else:
            scores = self._score_covariance(jacobian, residual, lags)
        covariance = inverse @ scores @ inverse
        # Without noise the variances are of the size of the rounding, and may come out below 0.
        np.fill_diagonal(covariance, np.maximum(covariance.diagonal(), 0.0))
        # The standard deviation of each coordinate along each direction, in units of the coordinate.
        finite = np.where(np.isinf(length), 1.0, length)
        along = directions * finite
        sd = np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", along, covariance, along), 0.0))
        weak = flat | ((sd[:, None] * np.abs(directions) / finite).max(axis=1) > _UNKNOWN_SD)
        undetermined = tuple(
            {name: float(weight) for name, weight in zip(self.free, way, strict=True) if abs(weight) > _TRADES}
            for way in directions[weak]
        )
        unknown = np.isinf(length) | (np.abs(directions[flat]) > _TRADES).any(axis=0)
        covariance[unknown, unknown] = np.inf
        return covariance, condition, undetermined, freedom

    def _autoregressive(self, jacobian: Array, residual: Array, inverse: Array) -> tuple[Array, Array]:
        """Return S for autoregressive noise, shape (p, p), and the degrees of freedom of every parameter."""
        ends = np.cumsum([int(mask.sum()) for mask in self.masks])[:-1]
        parts = np.split(jacobian, ends)
        noise = noise_model(np.split(residual, ends), parts, inverse)
        return noise.score_covariance(parts), noise.freedom(parts, inverse, self.samples)

    def _score_covariance(self, jacobian: Array, residual: Array, lags: int) -> Array:
        """Return S of Newey and West, summed over the records and corrected for p fitted parameters, shape (p, p)."""
        total: Array = np.zeros((len(self.free), len(self.free)))
        end = 0
        for mask in self.masks:
            begin, end = end, end + int(mask.sum())
            score = jacobian[begin:end] * residual[begin:end, None]
            total += score.T @ score
            for lag in range(1, min(lags, len(score) - 1) + 1):
                cross = score[lag:].T @ score[:-lag]
                total += (1 - lag / (lags + 1)) * (cross + cross.T)
        corrected: Array = total * (self.samples / max(self.samples - len(self.free), 1))
        return corrected
