"""From recordings to the result of a diagnosis: check, average, calibrate, search, decide, remark on other laws."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from needleplan.diagnosis._along_needle import sensor_remarks
from needleplan.diagnosis._base_law import Law
from needleplan.diagnosis._blocks import HETEROGENEITY_SDS
from needleplan.diagnosis._budget import FindingKind, OtherLaw
from needleplan.diagnosis._components import Components
from needleplan.diagnosis._constants import (
    EMPTY_STEPS,
    FEWEST_REFERENCES,
    MOST_SAMPLES,
    SLOWEST_HZ,
    TOLERANCE_SCALES,
    UNKNOWN_NOISE,
    VISIBLE_SHARE,
)
from needleplan.diagnosis._contradiction import contradiction
from needleplan.diagnosis._decision import DiagnosisDecision, Ranked, Verdict, decide
from needleplan.diagnosis._fit import fit_hypothesis
from needleplan.diagnosis._hypothesis import Hypothesis
from needleplan.diagnosis._posterior import Posterior
from needleplan.diagnosis._problem import Problem
from needleplan.diagnosis._result import Diagnosis, detection_limits_of, most_probable
from needleplan.diagnosis._search import search
from needleplan.diagnosis._settings import Settings
from needleplan.diagnosis._threads import one_thread
from needleplan.diagnosis.calibration import Calibration, calibrate, calibration_remarks
from needleplan.diagnosis.catalogue import Library, base_of, require_effects, with_effects
from needleplan.diagnosis.data import FEWEST_VALUES, CheckedData, check_data, check_needle, sensor_noise
from needleplan.diagnosis.references import identified_from
from needleplan.errors import DataError, InputError, Mistake
from needleplan.extras.progress_bar import progress_bar
from needleplan.models import Model, ModelFile, simulate
from needleplan.models.effects import SIZE, effects_of
from needleplan.recording import read_records
from needleplan.signals import UNITS, Record, Role, SensorNoise, averaged_record, lagged, parts_of, records_of

__all__ = ["answer_of", "at_bound", "default_library", "diagnose"]

# Effects that recordings do not separate from another law of reversal, such as an elastoplastic one.
_LIKE_A_REVERSAL = ("drive_stick",)

_TRIALS = (Role.TRAIN, Role.HOLDOUT, Role.REFERENCE)

# The laws of the base in words, and effects that would look alike.
_LAWS = {
    Law.REVERSAL: ("friction reverses", "a longer bristle or a delay"),
    Law.MEMORY: ("friction remembers its reversals", "moving tissue"),
    Law.DEPTH: ("the forces depend on the depth", "cutting_with_depth"),
    Law.FORCE: ("the forces depend on their size and direction", "gain_error or friction_by_direction"),
    Law.SPEED: ("the forces depend on the speed", "viscous or stribeck"),
    Law.ENTRY: ("the forces come up at the entry", "entry_spring, or a layer near the entry,"),
}


@one_thread
def diagnose(
    model: Model | ModelFile | str | os.PathLike[str],
    recordings: object,
    *,
    library: Library | None = None,
    settings: Settings | None = None,
    references: bool = True,
    strict: bool = False,
    progress: Callable[[str], None] | bool | None = None,
) -> Diagnosis:
    """Find where a model and recordings disagree, and which effects the model lacks.

    Parameters
    ----------
    model
        The base model, or its file, or the path of the file: a gap that other values of the parameters take up is
        judged by the intervals of a file. Effects that the model has already are fitted again in every hypothesis, and
        further ones are sought.
    recordings
        Records, tables of columns such as DataFrames, paths of data files, or a list of these, with the roles train,
        holdout (another motion), reference (without the effects that are sought) and noise (the sensor at rest). All
        trials enter one likelihood; the references show what is normal. An effect is named only with a noise record, a
        held-out trial of another motion, and at least two training trials.
    library
        Effects to look for; by default all effects of the model's channel, the further ones included. A library caches
        sensitivities: pass the same library for all data sets of one needle.
    settings
        Constants of model, priors and answers.
    references
        Whether the recordings from which a model file was identified are references too, if the file names them and
        none is given.
    strict
        Whether the diagnosis of three and more references alone is the result, if they show an effect or another law.
    progress
        True: show a bar on the terminal or in the notebook. A function is called with the name of each stage when it
        begins.

    Returns
    -------
    Diagnosis
        Answer, named effects with 95 % intervals, probabilities of all hypotheses, and the corrected model.

    Raises
    ------
    DataError
        If the recordings are not usable; the message lists all mistakes.
    ModelError
        If the model is no model or its file cannot be read, or if its channel cannot be diagnosed or has no effects.
    InputError
        If `library`, `settings` or `progress` has another type.

    Examples
    --------
    The data contain viscous friction, which the model lacks:

    >>> import numpy as np
    >>> from needleplan.diagnosis import Library
    >>> from needleplan.diagnosis import diagnose
    >>> from needleplan.models import ShaftAndTip, simulate
    >>> from needleplan.models.effects import effect_named
    >>> from needleplan.signals import Record, Role, lspb
    >>> base = ShaftAndTip(friction=0.012, cutting=0.4, onset_mm=4.0, presliding_mm=0.05)
    >>> truth = effect_named("viscous").apply(base, {"size": 3e-4})
    >>> random = np.random.default_rng(0)
    >>> def trial(name, role, depths_mm, speeds_mm_s):
    ...     motion = lspb(depths_mm, speeds_mm_s, rate_hz=50)
    ...     force = simulate(truth, motion).output + random.normal(0, 0.02, len(motion))
    ...     columns = {"time_s": motion.time_s, "depth_mm": motion.depth_mm, "velocity_mm_s": motion.velocity_mm_s}
    ...     return Record({**columns, "force_n": force}, name, role)
    >>> still = {"time_s": np.arange(1000) / 50, "force_n": random.normal(0, 0.02, 1000)}
    >>> recordings = [
    ...     trial("first", Role.TRAIN, [-2, 30, 20, 60, -2], [4, 8, 6, 12]),
    ...     trial("second", Role.TRAIN, [-2, 45, 35, 60, -2], [9, 5, 3, 10]),
    ...     trial("third", Role.HOLDOUT, [-2, 20, 60, -2], [10, 4, 8]),
    ...     Record(still, "air", Role.NOISE),
    ... ]
    >>> few = Library([effect_named(name) for name in ("viscous", "stribeck", "bias")], base)
    >>> found = diagnose(base, recordings, library=few)
    >>> print(found.verdict, found.names)
    named ('viscous',)
    >>> size = found.effects[0].estimates["size"]
    >>> size.low < 3e-4 < size.high
    True
    """
    if isinstance(progress, bool):
        with progress_bar(progress) as show:
            return diagnose(
                model, recordings, library=library, settings=settings, references=references, strict=strict,
                progress=show,
            )  # fmt: skip
    if progress is not None and not callable(progress):
        rule = "must be a function of a text, True for a bar, or None"
        raise InputError(Mistake("progress", repr(progress), rule), "diagnose")
    tell = progress or (lambda _: None)
    file, records = ModelFile.of(model), records_of(recordings, read_records)
    base = file.model
    _require_type(Library, library, "library")
    _require_type(Settings, settings, "settings")
    library, settings = library or default_library(base), settings or Settings()
    require_effects(base, library)
    check_data(records, base.channel)  # averaging hides gaps and uneven sampling
    normal_remarks: list[str] = []
    if references:
        more, normal_remarks = identified_from(file, records)
        records = [*records, *more]
    if sum(record.role is Role.REFERENCE for record in records) >= FEWEST_REFERENCES:
        tell("diagnosing the references")
        first = diagnose(replace(file, parents=()), _normal(records), library=library, settings=settings)
        if strict and first.verdict not in (Verdict.NONE, Verdict.UNDERPOWERED):
            remark = "strict: the references show this alone, and the other recordings were not diagnosed"
            return replace(first, remarks=(*normal_remarks, remark, *first.remarks))
        base = first.model if first.verdict is Verdict.NAMED else base
        normal_remarks += _of_references(first)
    elif strict:
        normal_remarks.append(f"strict has no effect: it needs {FEWEST_REFERENCES} references")
    tell("calibrating the model to the trials")
    checked, empty = _best_sampling(base, records, settings)
    calibration = empty.problem.calibration
    tell("searching missing effects")
    posterior, errors = search(empty.problem, library, Components(empty.problem), empty).without_formula_errors()
    decision, laws = answer_of(posterior, checked, settings)
    best = most_probable(posterior)
    remarks = [*normal_remarks, *checked.remarks, *calibration_remarks(calibration), *errors]
    limit = HETEROGENEITY_SDS.max()
    if best.problem.sds[best.best] == limit:
        remarks.append(f"the heterogeneity is at its limit, {limit:.0%}: model or noise is far off")
    found = Diagnosis(
        decision, posterior, calibration, checked, settings, tuple(records), tuple(remarks), file.estimates,
        given=file.model, laws=tuple(laws),
    )  # fmt: skip
    found = replace(found, decision=_accounted(found))
    return replace(found, remarks=(*remarks, *sensor_remarks(found.model, records, file), *_kept(found)))


def _require_type(kind: type, value: object, name: str) -> None:
    """Raise InputError unless a value is None or of a type."""
    if not isinstance(value, kind | None):
        rule = f"must be a {kind.__name__} of needleplan.diagnosis"
        raise InputError(Mistake(name, f"<{type(value).__name__}>", rule), "diagnose")


def _accounted(found: Diagnosis) -> DiagnosisDecision:
    """Return the answer; `CHANGED` if no effect is missing, but other parameters or laws close a part of the gap."""
    if found.verdict not in (Verdict.NONE, Verdict.UNDERPOWERED):
        return found.decision
    causes = [finding.name for finding in found.findings if finding.kind in (FindingKind.PARAMETER, FindingKind.LAW)]
    if not causes:
        return found.decision
    differ = f"{', '.join(causes)} {'differ' if len(causes) > 1 else 'differs'} from the model"
    why = f"no effect is needed (probability {found.decision.probability:.2f}), but {differ}"
    return replace(found.decision, verdict=Verdict.CHANGED, because=why)


def _normal(recordings: Sequence[Record]) -> list[Record]:
    """Return the references as trials of their own, the last one held out, with the noise."""
    references = [recording for recording in recordings if recording.role is Role.REFERENCE]
    roles = [*[Role.TRAIN] * (len(references) - 1), Role.HOLDOUT]
    noise = [recording for recording in recordings if recording.role is Role.NOISE]
    return [*(replace(each, role=role) for each, role in zip(references, roles, strict=False)), *noise]


def _of_references(first: Diagnosis) -> Iterator[str]:
    """Yield remarks on what the references show, which were diagnosed alone."""
    if first.verdict is Verdict.NAMED:
        yield f"the references already show {', '.join(first.names)}: it was added to the base"
    elif first.verdict not in (Verdict.NONE, Verdict.UNDERPOWERED, Verdict.CHANGED):
        yield f"the references alone are not explained by the model: {first.decision.because}"


def _kept(found: Diagnosis) -> Iterator[str]:
    """Yield a remark if the corrected model is the given base."""
    if found.keeps_given:
        unit, which = UNITS[found.given.channel.columns[0]], "held-out" if found.checked.held_out else "training"
        before, after = (f"{found.held_out_rms(model):.3g} {unit}" for model in (found.given, found.base))
        cause = "the trials differ" if found.verdict is Verdict.CHANGED else "what has no name distorts it"
        yield (
            f"the calibrated base predicts the {which} trials worse (RMS {after}) than the given base ({before}), "
            f"which is kept: {cause}"
        )


def answer_of(
    posterior: Posterior, checked: CheckedData, settings: Settings
) -> tuple[DiagnosisDecision, Sequence[OtherLaw]]:
    """Return the answer from the posterior, and the laws of the base that differ from the model's."""
    axes = {component.name: component.axis for component in posterior.components.components}
    ranked = [Ranked(value, tuple(dict.fromkeys(names)), axes.get(which)) for value, names, which in posterior.ranked]
    best = most_probable(posterior)
    laws = list(_other_laws(best, settings))
    decision = decide(
        ranked, settings, powered=_powered(posterior), at_bound=at_bound(best),
        contradiction=contradiction(best, posterior.hypotheses[()]), lacks=[str(lack) for lack in checked.lacks],
        laws={law.words: law.nats for law in laws},
    )  # fmt: skip
    return decision, laws


def default_library(model: Model) -> Library:
    """Return the effects that `diagnose` compares by default: all effects on the channel of a model.

    Effects that recordings cannot separate from another friction law at reversals are left out.
    """
    effects = effects_of(model.channel, further=True)
    return Library([effect for effect in effects if effect.name not in _LIKE_A_REVERSAL], base_of(model)[0])


def _best_sampling(model: Model, recordings: Sequence[Record], settings: Settings) -> tuple[CheckedData, Hypothesis]:
    """Return the checked recordings and the fitted empty set.

    Readings are means over the sample intervals, or instants if the model, calibrated to means, predicts these better.
    Only at low rates do they differ.
    """
    moved = [recording.motion() for recording in recordings if "depth_mm" in recording.columns]
    trials = [recording for recording in recordings if recording.role in _TRIALS]
    rate_hz, remarks = _affordable_rate(trials, settings)
    # Blocks are whole numbers of samples, and the shortest trial must keep enough of them.
    rate_hz = max(rate_hz, *(_least_rate_hz(trial) for trial in trials))
    checked = _sampled(model, recordings, rate_hz)
    noise = sensor_noise(model, checked)
    calibration = calibrate(model, checked.training, checked.held_out, noise, checked.references)
    if any(parts_of(motion) > 1 for motion in moved):
        other = _sampled(model, recordings, rate_hz, instants=True)
        if _misfit(calibration, other.trials) < _misfit(calibration, checked.trials):
            checked, noise = other, sensor_noise(model, other)
            calibration = calibrate(model, checked.training, checked.held_out, noise, checked.references)
    own = calibration.trials
    problem = Problem(calibration, own, settings, _noise_freedom(checked, calibration.noise))
    start = fit_hypothesis(problem, calibration.effects, own, most_steps=0)
    empty = fit_hypothesis(problem, start.effects, start.trials, most_steps=EMPTY_STEPS, like=start)
    # With effects the tissue is no more heterogeneous than the data permit where no effect explains anything.
    largest_sd = float(max(empty.problem.sds[empty.levels].max(), HETEROGENEITY_SDS[1]))
    problem = empty.problem.up_to(largest_sd)
    checked = replace(checked, remarks=(*checked.remarks, *remarks))
    return checked, Hypothesis.at(problem, empty.effects, empty.trials, None, empty.formula_error, empty.scales)


def _sampled(model: Model, recordings: Sequence[Record], rate_hz: float, *, instants: bool = False) -> CheckedData:
    """Return the checked recordings, averaged to at most `rate_hz`; readings are means, or taken at instants."""
    used = [averaged_record(recording, rate_hz, instants=instants) for recording in recordings]
    return check_needle(check_data(used, model.channel), model)


def _misfit(calibration: Calibration, records: Sequence[Record]) -> float:
    """Return the squared whitened residual of the recordings of all trials, at the calibrated parameters."""
    found = 0.0
    for trial, record in zip(calibration.trials, records, strict=True):
        motion = record.motion()
        predicted = simulate(with_effects(trial.model, calibration.effects), motion).output.ravel()
        residual = calibration.noise.whiten(trial.measured - lagged(predicted, motion, trial.lag_s))
        found += float(np.nansum(residual**2))
    return found


def _affordable_rate(trials: Sequence[Record], settings: Settings) -> tuple[float, list[str]]:
    """Return the rate (Hz) at which the samples of all trials fit into the memory, and a remark if it is lower.

    Raises DataError if the rate would be too low to see reversals.
    """
    together_s = sum(float(np.ptp(trial["time_s"])) for trial in trials)
    rate_hz = MOST_SAMPLES / max(together_s, 1e-9)
    if rate_hz >= settings.rate_hz or sum(map(len, trials)) <= MOST_SAMPLES:
        return settings.rate_hz, []
    if rate_hz < SLOWEST_HZ:
        rule = f"at most {MOST_SAMPLES / SLOWEST_HZ:g} s: leave out pauses, or trials that repeat a motion"
        raise DataError(Mistake("trials", f"{together_s:.0f} s together", rule), "diagnose")
    return rate_hz, [
        f"the trials last {together_s:.0f} s together: they were averaged to {rate_hz:.0f} Hz to save memory"
    ]


def _least_rate_hz(trial: Record) -> float:
    """Return the least rate to which a trial can be averaged: a sample is the mean of a whole number of readings."""
    block = max(len(trial) // FEWEST_VALUES, 1)
    return float(1 / (block * np.median(np.diff(trial["time_s"]))))


def _noise_freedom(checked: CheckedData, noise: SensorNoise) -> float:
    """Return the number of samples that determined the noise variance, or next to none if no noise was recorded."""
    found = sum(len(each) - noise.order - 1 for each in checked.noise or checked.rest)
    return float(max(found, UNKNOWN_NOISE))


def at_bound(hypothesis: Hypothesis) -> dict[str, str]:
    """Return for each effect the amplitude at a bound other than 0, or the time constant at its least value, if any.

    An effect that would be smaller, or faster, than data can show stands for something else. The least delay is no such
    value: it is what counts as an effect beside the usual lag of a sensor, and delays are named that are a little less.
    """
    found = {}
    for effect in hypothesis.effects:
        for name, value in effect.values.items():
            what = effect.effect.parameters[name]
            low, high = effect.bounds.get(name, (what.lower, what.upper))
            least = () if effect.effect.is_lag or (name != SIZE and what.unit != "s") else (low,)
            ends = (*least, high) if name == SIZE else least
            if value and value in ends:
                found[effect.name] = name
    return found


def _powered(posterior: Posterior) -> bool:
    """Return whether most effects of a relevant amplitude would have been named with the wanted power."""
    visible = [each.noise_multiple for each in detection_limits_of(posterior) if each.visible]
    relevant = posterior.problem.settings.relevant
    return bool(visible) and float(np.mean([each <= relevant for each in visible])) >= VISIBLE_SHARE


def _other_laws(hypothesis: Hypothesis, settings: Settings) -> Iterator[OtherLaw]:
    """Yield each law of the base that differs from the model's beside a set of effects.

    The evidence with the tolerance of the law is compared with that of its least tolerance.
    """
    h, noise, linear = hypothesis.best, hypothesis.problem.noise_scale, hypothesis.linear
    best = linear.evidence_with(linear.precision, h, noise)
    rows = sum(len(block.residual) for block in linear.blocks)
    effects = _squared_outputs(hypothesis)
    for law, group in hypothesis.groups.items():
        if law is Law.EFFECTS:
            continue
        least = {**hypothesis.scales, law: TOLERANCE_SCALES[0]}
        gain = best - linear.evidence_with(hypothesis.precision_with(least), h, noise)
        energy = sum(float(((each[:, group] @ linear.mean[h, group]) ** 2).sum()) for each in linear.basis)
        if gain > math.log(settings.other_law) and energy > settings.law_tolerance**2 * effects:
            yield OtherLaw(str(law), *_LAWS[law], gain, math.sqrt(energy / rows))


def _squared_outputs(hypothesis: Hypothesis) -> float:
    """Return the squared whitened output of each effect that the given model lacks, summed over effects and trials."""
    found = 0.0
    for number, (trial, own) in enumerate(zip(hypothesis.trials, hypothesis.outputs, strict=False)):
        for each, output in zip(hypothesis.effects, own, strict=True):
            if not each.given:
                whitened = hypothesis.problem.whiten(trial, number, np.asarray(output))
                found += float(whitened @ whitened)
    return found
