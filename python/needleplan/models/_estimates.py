"""Results of a fit: estimates with intervals, the fitted model, and how the fit ended."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from needleplan.artifacts import CallRepr, ShortRepr
from needleplan.models._base import Model
from needleplan.signals import Array

__all__ = ["Estimate", "Fit", "FitStatus"]


class FitStatus(StrEnum):
    """How a fit ended.

    Examples
    --------
    >>> import needleplan as npl
    >>> [str(status) for status in npl.models.FitStatus]
    ['converged', 'evaluation_limit', 'at_bound', 'diverged']
    """

    CONVERGED = "converged"
    EVALUATION_LIMIT = "evaluation_limit"
    """The limit of the evaluations ended the best of the starts before it converged."""

    AT_BOUND = "at_bound"
    """The fit converged with a parameter at a bound of its range; the optimum may lie beyond the bound."""

    DIVERGED = "diverged"
    """The simulation grew without bound: even the best result contains a residual of at least 1e6, or NaN."""


@dataclass(frozen=True)
class Estimate(CallRepr):
    """An identified parameter value with its uncertainty.

    Parameters
    ----------
    value : float
        Estimate, in `unit`.
    sd : float
        Standard deviation, in `unit`: to first order, or of the bootstrap.
    low, high : float
        Ends of the confidence interval (95 % by default), in `unit`.
    unit : str
        Unit of the parameter.
    identified : bool
        Whether the data determine the parameter. For `fit`: whether the standard deviation of the coordinate, ln(p) or
        p / typical, is below 1, and the value is not at a bound of its range.
    between_sd : float or None
        Standard deviation of the fitted values of the recordings, in `unit`; None if it was not estimated.

    Examples
    --------
    >>> import needleplan as npl
    >>> npl.models.Estimate(value=40.0, sd=1.0, low=38.0, high=42.0, unit="mm", identified=True).high
    42.0
    """

    value: float
    sd: float
    low: float
    high: float
    unit: str
    identified: bool
    between_sd: float | None = None


@dataclass(frozen=True)
class Fit(ShortRepr):
    """An identified model with its uncertainty and residuals.

    Parameters
    ----------
    model : Model
        The model with the identified values.
    status : FitStatus
        How the fit ended.
    free : tuple of str
        Names of the p estimated parameters.
    estimates : dict of str to Estimate
        Estimate of every free parameter.
    covariance : Array
        Covariance of the coordinates of `free`, shape (p, p). The variance of a parameter that the data do not
        determine is infinite.
    residuals : tuple of Array
        Measured minus simulated for every record, shape (samples,); NaN for masked samples.
    rmse : float
        Root-mean-square residual, in the unit of the channel.
    samples, masked : int
        Number of samples that were used, and number of samples that were left out.
    condition : float
        Ratio of the largest to the smallest singular value of the Jacobian with respect to the coordinates.
    undetermined : tuple of dict
        Directions along which the residuals do not change, or so little that a coordinate has a standard deviation
        above 1: singular vectors of the Jacobian with columns of unit length. Each direction has weights by parameter
        name; weights up to 0.1 are left out.
    evaluations : int
        Number of evaluations of the residuals in all starts, without those for the Jacobian.

    Examples
    --------
    >>> import numpy as np
    >>> import needleplan as npl
    >>> from needleplan.signals import Record, insertion_cycles
    >>> motion = insertion_cycles(60.0, 10.0, rate_hz=20.0)
    >>> noise = np.random.default_rng(0).normal(0.0, 0.1, len(motion))
    >>> measured = npl.models.simulate(npl.models.Bicycle(0.01), motion).output + noise
    >>> record = Record({"time_s": motion.time_s, "depth_mm": motion.depth_mm, "y_mm": measured})
    >>> found = npl.models.fit(npl.models.Bicycle(0.005), record)
    >>> str(found.status), found.free
    ('converged', ('curvature_per_mm', 'heading_rad', 'offset_mm'))
    >>> print(f"{found.rmse:.1f} mm")
    0.1 mm
    """

    model: Model
    status: FitStatus
    free: tuple[str, ...]
    estimates: dict[str, Estimate]
    covariance: Array
    residuals: tuple[Array, ...]
    rmse: float
    samples: int
    masked: int
    condition: float
    undetermined: tuple[dict[str, float], ...]
    evaluations: int

    @property
    def trades(self) -> tuple[str, ...]:
        """A sentence for every set of parameters that the data determine only in combination."""
        sentences = []
        for direction in self.undetermined:
            names = sorted(direction, key=lambda name: -abs(direction[name]))
            if len(names) > 1:
                listed = f"{', '.join(names[:-1])} and {names[-1]}"
                sentences.append(f"the data determine {listed} only together: other values of all of them fit as well")
        return tuple(sentences)

    @property
    def ok(self) -> bool:
        """Whether the fit reached an optimum (status CONVERGED or AT_BOUND)."""
        return self.status in (FitStatus.CONVERGED, FitStatus.AT_BOUND)
