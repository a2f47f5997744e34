"""Comparison of a model with recordings: the gap of each trial, with and without the effects of the model."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from needleplan.artifacts import CallRepr, ShortRepr
from needleplan.diagnosis import Settings
from needleplan.diagnosis.calibration import calibrate_trial
from needleplan.diagnosis.data import Lack, check_data, measured_output, sensor_noise
from needleplan.errors import DataError
from needleplan.models import Model, simulate
from needleplan.models.effects import AugmentedModel
from needleplan.signals import UNITS, Array, Record, Role, SensorNoise, averaged_record

__all__ = ["ModelComparison", "TrialGap", "compare"]


@dataclass(frozen=True)
class TrialGap(CallRepr):
    """Root mean square (RMS) of measured minus modelled output of one trial, with and without the effects of a model.

    Parameters
    ----------
    trial : str
        Name of the trial.
    role : Role
        Role of the trial, train or holdout.
    gap : float
        RMS with all effects, in the unit of the channel.
    without : float
        RMS of the base model alone; that of the model if it has no effects.
    noise : float
        RMS of the sensor noise.
    steps : tuple of float
        RMS of the base model, and with one effect more each, in the order of the model.

    Examples
    --------
    >>> from needleplan.reports.diagnosis import TrialGap
    >>> from needleplan.signals import Role
    >>> TrialGap("first", Role.TRAIN, gap=0.02, without=0.1, noise=0.02).explained
    1.0
    """

    trial: str
    role: Role
    gap: float
    without: float
    noise: float
    steps: tuple[float, ...] = ()

    @property
    def explained(self) -> float:
        """Share of the energy of the base model's gap above the noise that the effects explain; at most 1.

        Negative if the gap is larger with the effects; NaN if the base model leaves no more than noise.
        """
        open_ = self.without**2 - self.noise**2
        return min(1 - (self.gap**2 - self.noise**2) / open_, 1.0) if open_ > 0 else math.nan

    @property
    def smaller(self) -> bool:
        """Whether the gap is smaller with the effects than without."""
        return self.gap < self.without


@dataclass(frozen=True)
class ModelComparison(ShortRepr):
    """A model compared with recordings.

    Parameters
    ----------
    model : Model
        The model, with or without effects.
    trials : tuple of TrialGap
        The gap of each trial.
    fitted : bool
        Whether the parameters of the base model were fitted to each trial, with and without the effects.
    unit : str
        Unit of all gaps.
    remarks : tuple of str
        How the noise was estimated, if there is no record of it.
    """

    model: Model
    trials: tuple[TrialGap, ...]
    fitted: bool
    unit: str
    remarks: tuple[str, ...]

    @property
    def effects(self) -> tuple[str, ...]:
        """Names of the effects of the model."""
        return tuple(effect.name for effect in self.model.effects) if isinstance(self.model, AugmentedModel) else ()

    @property
    def ok(self) -> bool:
        """Whether the gap of every trial is smaller with the effects; true for a model without effects."""
        return not self.effects or all(trial.smaller for trial in self.trials)

    def lines(self) -> Iterator[str]:
        """Yield the lines for the terminal."""
        how = "base fitted to each trial" if self.fitted else "parameters of the file"
        yield f"{self.model.name}: RMS of measured minus modelled output, {how}"
        width = max(len("trial"), *(len(trial.trial) for trial in self.trials))
        head = f"  {'trial':<{width}}  {'gap':>9}"
        yield f"{head}  {'without effects':>15}  {'noise':>9}  explained" if self.effects else f"{head}  {'noise':>9}"
        for trial in self.trials:
            row = f"  {trial.trial:<{width}}  {trial.gap:>9.4g}"
            if self.effects:
                share = "-" if math.isnan(trial.explained) else f"{trial.explained:.1%}"
                row += f"  {trial.without:>15.4g}"
            row += f"  {trial.noise:>9.4g}"
            yield f"{row}  {share:>9}  {self.unit}" if self.effects else f"{row}  {self.unit}"
        for count in range(1, len(self.effects) if len(self.effects) > 1 else 0):
            gaps = ", ".join(f"{trial.trial} {trial.steps[count]:.4g}" for trial in self.trials)
            yield f"  with {', '.join(self.effects[:count])} alone: {gaps} {self.unit}"
        worse = [trial.trial for trial in self.trials if not trial.smaller]
        if self.effects and worse:
            yield f"  the effects do not make the gap smaller in {', '.join(worse)}"
        yield from (f"  remark: {remark}" for remark in self.remarks)


def compare(model: Model, recordings: Sequence[Record], *, fitted: bool = False) -> ModelComparison:
    """Return the gap between a model and each trial, with and without the effects of the model.

    Parameters
    ----------
    model : Model
        The model, with or without effects.
    recordings : sequence of Record
        Trials of the roles train and holdout, and records of noise. Without these, the noise is estimated from the
        trials, which a remark says. Trials of the role reference, which are without the effects, are left out.
    fitted : bool
        Fit the parameters of the base model and the lag of the sensor to each trial, once with the effects and once
        without; the effects keep their amplitudes. Trials are averaged to 60 Hz, as for a diagnosis, so that the gap
        without effects is the stage "parameters" of its budget. The default takes all parameters as they are, no lag,
        and all samples.

    Returns
    -------
    ModelComparison
        The gaps of all trials, in the order of `recordings`.

    Raises
    ------
    DataError
        As for a diagnosis: a trial lacks a column, is too short, or is sampled unevenly.

    Examples
    --------
    >>> import numpy as np
    >>> import needleplan as npl
    >>> from needleplan.models.effects import AddedEffect, AugmentedModel
    >>> from needleplan.reports.diagnosis import compare
    >>> from needleplan.signals import Record, insertion_cycles
    >>> base = npl.models.ShaftAndTip(friction=0.01, cutting=0.5, onset_mm=3.0, presliding_mm=0.5)
    >>> model = AugmentedModel(base, (AddedEffect("viscous", {"size": 1e-3}),))
    >>> motion = insertion_cycles(50.0, 5.0, rate_hz=50.0)
    >>> noise = np.random.default_rng(0).normal(0.0, 0.02, len(motion))
    >>> force = npl.models.simulate(model, motion).output + noise
    >>> columns = {"time_s": motion.time_s, "depth_mm": motion.depth_mm, "velocity_mm_s": motion.velocity_mm_s}
    >>> found = compare(model, [Record({**columns, "force_n": force}, "first")])
    >>> found.ok, round(found.trials[0].explained, 1)
    (True, 1.0)
    """
    try:
        check_data(recordings, model.channel)
        recordings = (
            [averaged_record(recording, Settings.rate_hz) for recording in recordings] if fitted else recordings
        )
        checked = check_data(recordings, model.channel)
    except DataError as error:
        raise DataError(error.mistakes, "compare") from None
    noise = sensor_noise(model, checked)
    remarks = (checked.lacks[Lack.NOISE],) if Lack.NOISE in checked.lacks else ()
    base = model.base if isinstance(model, AugmentedModel) else model
    trials = [recording for recording in recordings if recording.role in (Role.TRAIN, Role.HOLDOUT)]
    effects = model.effects if isinstance(model, AugmentedModel) else ()
    steps = [AugmentedModel(base, effects[:count]) if count else base for count in range(len(effects) + 1)]
    found = []
    for trial in trials:
        gaps = tuple(_gap(base, trial, noise, fitted, _whole(step)) for step in steps)
        found.append(TrialGap(trial.trial, trial.role, gaps[-1], gaps[0], noise.rms, gaps))
    return ModelComparison(model, tuple(found), fitted, UNITS[model.channel.columns[0]], remarks)


def _whole(model: Model) -> Callable[[Model], Model]:
    """Return the function that adds the effects of `model` to its base model with other parameters."""
    return lambda base: replace(model, base=base) if isinstance(model, AugmentedModel) else base


def _gap(
    base: Model, record: Record, noise: SensorNoise, fitted: bool, whole: Callable[[Model], Model]
) -> float:  # fmt: skip
    """Return the RMS of measured minus modelled output."""
    modelled: Array
    if fitted:
        free = [name for name, what in base.parameters().items() if what.free]
        modelled = calibrate_trial(base, record, noise, free, whole=whole).predicted
    else:
        modelled = simulate(whole(base), record.motion()).output.ravel()
    return float(np.sqrt(np.nanmean((measured_output(record, base.channel) - modelled) ** 2)))
