# fmt: off
"""The constants of the diagnosis that a user does not change: value, unit, effect and reason, in one table.

Those that a user may change are in `Settings`. Each row is a number, or the numbers of a grid.
"""

from __future__ import annotations

from typing import NamedTuple, TypeVar

import numpy as np

__all__ = [
    "ACROSS_RATIO", "ALIKE", "AMPLITUDE_SCALES", "BASE_DEPTHS", "BASE_FORCES", "BASE_SPEEDS", "BESIDE",
    "CALIBRATION_STEPS", "CHANCE", "CHILDREN", "CLOCK_RAD", "CLOCK_S", "CONSTANTS", "CONTENDERS", "CONTENDS",
    "CONVERGED",
    "COORDINATE_STEP", "DAMPING_TRIES", "DELAY_SHARES", "DEVIATES_FROM", "DEVIATES_TO", "DISTORTED", "EARLIEST_S",
    "EDGES_MM", "EDGE_LAW", "EFFECT_DEPTHS", "EFFECT_SPEEDS", "EFFECT_TIMES", "EMPTY_STEPS", "ENTRY_CORRELATION",
    "ENTRY_LEAST", "ENTRY_MODES", "FAR", "FAR_LEVEL", "FEWEST_REFERENCES", "FINER", "FIRST_STEP_S", "FIT_LEVELS",
    "FORCE_LAG_S", "FORCE_PRIORS", "FORMULA_ERRORS", "FORMULA_SDS", "GAINED", "GRID_MARGIN", "HELD_PROMISE",
    "HETEROGENEITIES", "HIDDEN_MODES", "HOPELESS", "IMPOSSIBLE", "INVISIBLE", "KEPT_BYTES", "KEPT_MOTIONS",
    "KNOWN_NOISE", "LARGEST_FAMILY", "LATE_S", "LAW_SCALES", "LEAST_CLOSED", "LEAST_DROP", "LEAST_PROMISE",
    "LEAST_SHARE", "LED", "LIKELY", "LINEAR_STEP", "LOCAL_S",
    "LONGEST", "LONGEST_LAG_S", "LONGEST_STEP", "LOST", "MEMORY_LAW", "MORE_SEARCHES", "MOST_EFFECTS", "MOST_MODES",
    "MOST_NODES", "MOST_SAMPLES", "MOST_STEPS", "MOVED", "NEAR", "NEAR_S", "NEAR_TURN", "NEGLIGIBLE",
    "NEGLIGIBLE_ERROR", "NEIGHBOURHOODS", "NODES", "NODES_S", "NOISE_SDS", "NOT_VISITED", "OTHER_LENGTH", "OTHER_SCALE",
    "OWN_LAW", "PARAMETER_FACTOR", "PARENTS", "PRIOR_SD", "RELATIVE_STEP", "REPETITIONS", "REST_SPEED_SHARE",
    "REVERSAL_CORRELATION", "REVERSAL_MODES", "REVERSAL_TRAVELS", "RIMS_MM", "RIM_LAW", "RINGING_HZ", "RINGING_S",
    "ROUGH_MM", "SCALE_ROUNDS", "SCATTER", "SCATTER_FREEDOM", "SHORTEST", "SIGNIFICANT", "SINGLES", "SINGLE_SAMPLE",
    "SLOWEST_HZ", "SMOOTH_MM", "SPEED_LAW", "STARTS", "STEP_EVERY_S", "STRETCH", "STRONG",
    "SURE_NATS", "TIP_LAG_S", "TIP_PRIORS", "TISSUE_GRID_MM", "TISSUE_VARIANCE", "TOLERANCE_SCALES",
    "TURN_FEWEST", "TURN_MOST", "TURN_REST", "TURN_TRAVEL", "UNKNOWN_NOISE", "UNUSUAL_LAG_FACTOR", "USUAL_SD",
    "VALID_RATIOS", "VISIBLE_MODE", "VISIBLE_SHARE", "WAVES_HZ", "WAVES_PER_MM", "WAVE_STEP", "Constant",
]

_T = TypeVar("_T")


class Constant(NamedTuple):
    """A constant of the diagnosis: name, value, unit, effect of a larger value, and reason for the value."""

    name: str
    value: object
    unit: str
    effect: str
    reason: str


_TABLE: list[Constant] = []


def _one(name: str, value: _T, unit: str, effect: str, reason: str) -> _T:
    """Add a row to the table, and return the value."""
    _TABLE.append(Constant(name, value, unit, effect, reason))
    return value


# Laws of the base.
SPEED_LAW = _one("SPEED_LAW", 0.2, "base_law", "standard deviation of the laws along the speed",
    "friction depends little on the speed")
OWN_LAW = _one("OWN_LAW", 0.015, "base_law", "standard deviation of all laws of the base in a single trial",
    "trials of one tissue have nearly the same laws")
RIM_LAW = _one("RIM_LAW", 2.5, "entry_law", "standard deviation of the friction density at the entry",
    "the tissue is dimpled there, or does not touch the shaft")
RIMS_MM = _one("RIMS_MM", (0.5, 1.0, 2.0, 4.0), "mm", "depths over which these deviations decay",
    "a dimple is some millimetres deep")
BASE_DEPTHS = _one("BASE_DEPTHS", 4, "cosines", "laws along the depth", "a choice")
BASE_FORCES = _one("BASE_FORCES", 3, "cosines", "laws along the force",
    "a bent scale, and friction that grows with the load")
BASE_SPEEDS = _one("BASE_SPEEDS", 2, "cosines", "laws along the logarithm of the speed", "a choice")
NODES = _one("NODES", 40, "nodes", "of a law that is merged into the base",
    "lines depart by up to 5 % from the finest functions at the entry")
DEVIATES_FROM = _one("DEVIATES_FROM", 0.3, "onset or presliding lengths", "place from which a law may deviate",
    "before, nothing has slid or been cut")
DEVIATES_TO = _one("DEVIATES_TO", 3.0, "onset or presliding lengths",
    "place from which a deviation decays as the inverse place", "laws agree far from entry and reversal")
ENTRY_CORRELATION = _one("ENTRY_CORRELATION", 0.9, "logarithm of the depth",
    "correlation length of the rise of the cutting force", "real laws have kinks, a Matern process with one derivative")
ENTRY_MODES = _one("ENTRY_MODES", 14, "functions", "rise of the cutting force", "a choice between time and accuracy")
ENTRY_LEAST = _one("ENTRY_LEAST", 0.02, "onset lengths", "depth from which these functions are defined",
    "no sample lies before")
REVERSAL_CORRELATION = _one("REVERSAL_CORRELATION", 0.7, "logarithm of the travel",
    "correlation length of the law of reversal", "laws of contacts are smooth")
REVERSAL_MODES = _one("REVERSAL_MODES", 8, "functions", "law of reversal", "a choice between time and accuracy")
MEMORY_LAW = _one("MEMORY_LAW", 4.0, "reversal_law",
    "standard deviation of the share of contacts that close their loops", "nothing is known of the memory")
REVERSAL_TRAVELS = _one("REVERSAL_TRAVELS", (0.0375, 120.0), "presliding lengths",
    "travels between which the law of reversal may deviate",
    "outside, friction has not begun to reverse, or has done so")
OTHER_LENGTH = _one("OTHER_LENGTH", 2.0, "reversal_law",
    "standard deviation of the logarithm of the presliding length of all trials", "30 %: it depends on the surfaces")

# Errors of single trials, and tissue.
CLOCK_S = _one("CLOCK_S", 0.001, "s", "standard deviation of the time of a reversal", "clocks of robot and sensor")
STRETCH = _one("STRETCH", 0.133, "reversal_law", "standard deviation of the length of a single reversal", "2 %")
SINGLE_SAMPLE = _one("SINGLE_SAMPLE", 0.05, "reversal_law",
    "error of each sample after a reversal, in units of the change of the force", "0.75 %")
TURN_TRAVEL = _one("TURN_TRAVEL", 5.0, "presliding lengths", "travel in which a reversal shapes the force",
    "after it, less than 1 % is left")
TURN_FEWEST = _one("TURN_FEWEST", 3, "samples", "least number with errors of a reversal", "a choice")
TURN_MOST = _one("TURN_MOST", 15, "samples", "largest number with errors of a reversal", "a quarter of a second")
TURN_REST = _one("TURN_REST", 0.002, "largest speed", "speed below which no reversal begins", "rounding of the speed")
NEGLIGIBLE_ERROR = _one("NEGLIGIBLE_ERROR", 0.2, "noise sd", "error of a trial that is neglected",
    "2 % of the variance")
FORMULA_ERRORS = _one("FORMULA_ERRORS", (0.05, 0.15, 0.4), "local change of the outputs",
    "standard deviations of the errors of the formulas, of which one is chosen", "from a good formula to another shape")
LOCAL_S = _one("LOCAL_S", 0.25, "s", "half of the window of the local change", "shorter than effects act")
NODES_S = _one("NODES_S", 0.5, "s", "distance of the nodes of the errors of the formulas", "the window")
MOST_NODES = _one("MOST_NODES", 200, "nodes", "errors of the formulas in a trial", "time of computation")
VISIBLE_MODE = _one("VISIBLE_MODE", 1.0, "noise variance", "energy of a tissue mode below which it is left out",
    "one degree of freedom of the noise")
USUAL_SD = _one("USUAL_SD", 0.13, "share", "largest heterogeneity at which this energy is counted",
    "a missing effect looks like more")
HETEROGENEITIES = _one("HETEROGENEITIES", (0.0, 0.01, 0.02, 0.03, 0.045, 0.06, 0.08, 0.1, 0.13, 0.17, 0.22, 0.3),
    "share", "heterogeneities that are summed over", "steps of a third; more than 0.3 is no tissue")
HIDDEN_MODES = _one("HIDDEN_MODES", 1.0, "noise variance",
    "energy of the modes of the tissue that are left out together", "one degree of freedom of the noise")
ROUGH_MM = _one("ROUGH_MM", 6.0, "mm", "correlation length of rough tissue", "tissue varies over some millimetres")
SMOOTH_MM = _one("SMOOTH_MM", 6.7, "mm", "correlation length of smooth tissue", "the same")
TISSUE_GRID_MM = _one("TISSUE_GRID_MM", 0.25, "mm", "depths at which tissue is defined", "15 mm/s at 60 Hz")
TISSUE_VARIANCE = _one("TISSUE_VARIANCE", 0.9999, "share", "variance that the modes hold",
    "the rest is below the noise")
MOST_MODES = _one("MOST_MODES", 200, "modes", "of the tissue", "0.6 mm in 60 mm")
ACROSS_RATIO = _one("ACROSS_RATIO", 0.5, "share", "heterogeneity of the curvature across the bevel", "a choice")
FORCE_LAG_S = _one("FORCE_LAG_S", 0.004, "s", "prior of the lag of a force sensor", "a low-pass filter of 40 Hz")
TIP_LAG_S = _one("TIP_LAG_S", 0.005, "s", "prior of the lag of a tracker", "trackers filter over some milliseconds")
FORCE_PRIORS = _one("FORCE_PRIORS", {"presliding_mm": 0.2}, "logarithm",
    "prior standard deviation of the presliding length of a trial", "it depends on the surfaces")
TIP_PRIORS = _one("TIP_PRIORS", {"curvature_per_mm": 0.2}, "logarithm",
    "prior standard deviation of the curvature of a trial", "repeated insertions agree within a fifth")
PRIOR_SD = _one("PRIOR_SD", 0.7, "logarithm", "prior standard deviation of other parameters", "about a factor of two")

# Laws of the effects, and their prior.
EFFECT_DEPTHS = _one("EFFECT_DEPTHS", 4, "cosines", "an effect's law along the depth", "a choice")
EFFECT_TIMES = _one("EFFECT_TIMES", 3, "cosines", "an effect's law along the time", "a choice")
EFFECT_SPEEDS = _one("EFFECT_SPEEDS", 3, "cosines", "an effect's law along the speed", "a choice")
OTHER_SCALE = _one("OTHER_SCALE", 0.9, "logarithm", "factor of the scales of which an effect's shape is blended",
    "2.5: a Gaussian from exponentials")
CLOCK_RAD = _one("CLOCK_RAD", 0.1, "rad", "standard deviation of the phase of a trial", "breaths are not exact clocks")
EDGES_MM = _one("EDGES_MM", (0.25, 0.5, 1.0), "mm", "travels over which an effect at a depth may follow the tip",
    "the bevel is as long")
EDGE_LAW = _one("EDGE_LAW", 0.5, "share", "standard deviation of each of these shares", "edges are sharp or soft")
TOLERANCE_SCALES = _one("TOLERANCE_SCALES", (0.1, 1.0, 3.0), "standard deviations",
    "scales of each law of the base; the likeliest is taken", "from the model's law to a foreign one")
LAW_SCALES = _one("LAW_SCALES", (0.1, 1.0), "standard deviations", "scales of the laws of the effects",
    "from the library's formula to another one")
SCALE_ROUNDS = _one("SCALE_ROUNDS", 2, "rounds", "in which the scales are chosen one after the other",
    "time of computation")
AMPLITUDE_SCALES = _one("AMPLITUDE_SCALES", np.array([0.5, 2.0, 8.0, 32.0]), "noise RMS",
    "scales of the prior of an amplitude", "from hardly visible to far above the noise, in steps of four")
MOST_EFFECTS = _one("MOST_EFFECTS", 3, "effects", "different effects of a set", "time of computation")
KEPT_BYTES = _one("KEPT_BYTES", 1e9, "bytes", "sensitivities that a library keeps in memory", "half of a small machine")
KEPT_MOTIONS = _one("KEPT_MOTIONS", 32, "motions", "that it keeps in any case", "trials of one diagnosis")
GRID_MARGIN = _one("GRID_MARGIN", 1.3, "factor", "search range of a parameter beyond its grid",
    "half a step of the grid")
VALID_RATIOS = _one("VALID_RATIOS", (0.4, 2.5), "grid amplitude",
    "amplitudes for which the sensitivity of a nonlinear effect holds", "a choice")
PARAMETER_FACTOR = _one("PARAMETER_FACTOR", 2.0, "factor", "grid of base parameters of cached sensitivities",
    "data sets of one needle share them")
UNUSUAL_LAG_FACTOR = _one("UNUSUAL_LAG_FACTOR", 2.0, "usual lag", "lag up to which a delay is no effect",
    "two standard deviations of the prior")
EARLIEST_S = _one("EARLIEST_S", -0.01, "s", "least lag",
    "a law of reversal that comes early; a lead holds within a sample")
LONGEST_LAG_S = _one("LONGEST_LAG_S", 0.2, "s", "largest lag", "longer ones are errors of clocks")

# Functions of one variable that compete with the effects.
WAVES_PER_MM = _one("WAVES_PER_MM", (0.04, 1.2), "1/mm", "frequencies of waves of the position", "25 mm to 0.8 mm")
WAVES_HZ = _one("WAVES_HZ", (0.1, 6.0), "Hz", "frequencies of waves in time", "breathing to vibration")
WAVE_STEP = _one("WAVE_STEP", 0.8, "inverse range", "step of these frequencies", "neighbours are just distinct")
FIRST_STEP_S = _one("FIRST_STEP_S", 2.0, "s", "time of the first step", "before it a step is a bias")
STEP_EVERY_S = _one("STEP_EVERY_S", 0.4, "s", "distance of the times of a step", "effects act over 0.1 s and longer")
RINGING_HZ = _one("RINGING_HZ", (1.5, 12.0, 0.5), "Hz", "first, last and distance of frequencies of ringing",
    "holders and amplifiers")
RINGING_S = _one("RINGING_S", 0.25, "s", "time in which ringing decays", "the same")
LATE_S = _one("LATE_S", (0.02, 0.06, 0.2, 0.6), "s", "lags behind the acceleration", "dragged cables")
NOT_VISITED = _one("NOT_VISITED", 1e-9, "largest value", "value of a function below which no sample is at its place",
    "rounding")
NEAR_TURN = _one("NEAR_TURN", 2, "samples", "before and after a reversal that count as near it",
    "errors of single reversals")
REST_SPEED_SHARE = _one("REST_SPEED_SHARE", 0.02, "largest speed", "speed up to which the needle is at rest",
    "drives at rest still report some speed")
FINER = _one("FINER", 6, "points", "on each side at which a place or a frequency is refined", "a twelfth of the grid")

# Fit.
MOST_STEPS = _one("MOST_STEPS", 5, "steps", "of a fit", "time of computation")
EMPTY_STEPS = _one("EMPTY_STEPS", 12, "steps", "of the fit of the empty set", "all others begin there")
CONVERGED = _one("CONVERGED", 0.1, "nats", "rise of a step below which a fit ends",
    "probabilities change by less than a tenth")
LEAST_PROMISE = _one("LEAST_PROMISE", 0.5, "nats", "expected rise below which a fit ends",
    "the linear model accounts for it")
HELD_PROMISE = _one("HELD_PROMISE", 5.0, "nats", "expected rise below which a stage with held tolerances ends",
    "the next stage goes on")
CONTENDS = _one("CONTENDS", 4.0, "nats", "lead over the least evidence from which derivatives are renewed at the end",
    "others hardly win")
FIT_LEVELS = _one("FIT_LEVELS", 4, "heterogeneities", "that are summed over in the steps of a fit",
    "time of computation")
SHORTEST = _one("SHORTEST", 0.05, "step", "share of a step below which a fit ends", "four halvings")
LONGEST = _one("LONGEST", 0.5, "logarithm or rad", "largest step of a parameter", "outputs are linear within")
NEIGHBOURHOODS = _one("NEIGHBOURHOODS", (1.0, 0.5, 0.25), "grid steps",
    "in which an effect with local optima is sought", "down to 0.025 mm")
NEGLIGIBLE = _one("NEGLIGIBLE", 12.0, "nats", "deficit of a heterogeneity that is left out", "odds of 160,000")
FAR_LEVEL = _one("FAR_LEVEL", 30.0, "nats", "the same at the values of the effects", "amplitudes are integrated over")
RELATIVE_STEP = _one("RELATIVE_STEP", 1e-3, "logarithm", "step of numerical derivatives", "outputs are linear within")
LINEAR_STEP = _one("LINEAR_STEP", 0.05, "typical value", "the same of other parameters", "the same")
COORDINATE_STEP = _one("COORDINATE_STEP", 1e-3, "fit coordinate", "the same of the base", "the same")
CALIBRATION_STEPS = _one("CALIBRATION_STEPS", 10, "steps", "of a calibration", "time of computation")
DAMPING_TRIES = _one("DAMPING_TRIES", 5, "tries", "of the damping of a step", "time of computation")
LONGEST_STEP = _one("LONGEST_STEP", 0.7, "fit coordinate", "largest step of a calibration", "a factor of two")
LEAST_DROP = _one("LEAST_DROP", 0.02, "squared residual", "drop below which a calibration ends", "a hundredth of a nat")
NEAR = _one("NEAR", 0.15, "fit coordinate", "change up to which derivatives are used again",
    "a choice between time and accuracy")
NEAR_S = _one("NEAR_S", 0.003, "s", "the same of the lag", "the same")
MOVED = _one("MOVED", 0.2, "these changes", "share above which derivatives are renewed at the end of a fit",
    "3 %, or 0.6 ms")

# Search.
SINGLES = _one("SINGLES", 6, "fits", "of single effects", "time of computation")
CHILDREN = _one("CHILDREN", 3, "fits", "of sets with one more effect", "time of computation")
PARENTS = _one("PARENTS", 3, "sets", "of one size that are extended", "the same")
REPETITIONS = _one("REPETITIONS", 3, "effects", "repetitions in a set", "six bumps")
NOISE_SDS = _one("NOISE_SDS", 3.0, "standard deviations",
    "excess of the residual up to which no more than noise is left", "one in 700 by chance")
KNOWN_NOISE = _one("KNOWN_NOISE", 100, "samples", "of noise from which this can be said", "14 % of the variance")
HOPELESS = _one("HOPELESS", 2.0, "nats", "deficit of a screened set that is not fitted",
    "a fit adds little to its screening")
LED = _one("LED", 3.0, "nats", "gain over the empty set from which a set is extended",
    "effects that gain nothing alone seldom do together")
BESIDE = _one("BESIDE", 4.0, "nats", "deficit from which no function is tried beside a set", "it has no weight")
ALIKE = _one("ALIKE", 0.5, "gain", "share from which an effect imitates another one", "their squared correlation")
MORE_SEARCHES = _one("MORE_SEARCHES", 3, "searches",
    "for the start of an effect with local optima, and further fits of a set near the best", "each must gain")
GAINED = _one("GAINED", 1.0, "nats", "gain from which the next one follows", "less changes no answer")
LOST = _one("LOST", 8.0, "nats", "deficit from which a fit is given up", "later steps change a few nats")
FAR = _one("FAR", 8.0, "nats", "deficit from which a set has no weight", "odds of 3,000")
STRONG = _one("STRONG", 10.0, "nats", "gain from which an effect or a function is fitted in any case", "odds of 22,000")
DELAY_SHARES = _one("DELAY_SHARES", (0.6, 1.0, 2.0, 4.0), "lag of the base", "delays from which a fit begins",
    "a lag of the base hides them")
INVISIBLE = _one("INVISIBLE", 30.0, "noncentrality", "of the largest amplitude, below which an effect is no hypothesis",
    "no data here could show it")
IMPOSSIBLE = _one("IMPOSSIBLE", -50.0, "nats", "evidence of an amplitude that is not permitted", "none")
DISTORTED = _one("DISTORTED", 1, "effects", "beside which others are sought at the given base", "time of computation")
STARTS = _one("STARTS", 20, "starts", "of an effect with local optima, which are refined as linear columns",
    "more than a breath has frequencies")
CONTENDERS = _one("CONTENDERS", 5, "starts", "of a nonlinear effect that are linearised with the base free",
    "time of computation")

# Answer.
LIKELY = _one("LIKELY", 0.5, "probability", "from which something is more probable than not", "by definition")
LARGEST_FAMILY = _one("LARGEST_FAMILY", 4, "effects", "of a family", "longer lists help nobody")
VISIBLE_SHARE = _one("VISIBLE_SHARE", 0.75, "share", "of the effects that must be visible for the answer NONE",
    "some effects are never visible")
FORMULA_SDS = _one("FORMULA_SDS", 2.0, "law_along_axis", "error of a formula up to which it may imitate another effect",
    "one formula in twenty is further off")
UNKNOWN_NOISE = _one("UNKNOWN_NOISE", 1, "samples", "that know the noise, if it was guessed from the trials",
    "next to none")
FEWEST_REFERENCES = _one("FEWEST_REFERENCES", 3, "trials", "references from which they are diagnosed first",
    "two to fit, and one held out")
MOST_SAMPLES = _one("MOST_SAMPLES", 20_000, "samples", "of all trials after averaging",
    "1.3 GB in four trials, 9 GB in one")
SLOWEST_HZ = _one("SLOWEST_HZ", 20.0, "Hz", "lowest rate to which trials are averaged for this", "reversals last 50 ms")
LEAST_SHARE = _one("LEAST_SHARE", 0.05, "gap", "share below which nothing without a name is a finding",
    "less is not worth a sentence")
LEAST_CLOSED = _one("LEAST_CLOSED", 1 / 3, "gap", "share that named effects close in held-out trials, at least",
    "what is missing closes most of a gap to which it was not fitted; laws of the base leave some")
SURE_NATS = _one("SURE_NATS", 6.9, "nats", "log odds from which another law, or a trial without an effect, is found",
    "1,000 to 1")
SIGNIFICANT = _one("SIGNIFICANT", 3.0, "standard deviations", "of the energy of the noise from which a gap has shares",
    "one in 700 by chance")
SCATTER = _one("SCATTER", 0.2, "logarithm", "usual standard deviation of a parameter between trials",
    "repeated insertions agree within a fifth")
SCATTER_FREEDOM = _one("SCATTER_FREEDOM", 8, "degrees of freedom",
    "weight of the usual scatter beside that of the trials", "as if nine insertions had shown it")
CHANCE = _one("CHANCE", 0.01, "probability", "of a parameter without a change to be found changed", "a choice")

CONSTANTS = tuple(_TABLE)
"""The table: one row for each constant."""
