"""Second edition of the diagnosis: posterior probabilities of sets of effects from one likelihood of all trials.

The mathematics is on one page: docs/explanation/posterior.md. `needleplan diagnose` still uses the first edition.

| stage | module |
|---|---|
| constants, each with unit, effect and reason | `_settings` |
| evidence of a linear Gaussian model | `_evidence` |
| what all hypotheses share: reversals, tissue, law tolerance | `_problem` |
| outputs and derivatives of effects | `_tangents` |
| a set of effects and its evidence | `_hypothesis` |
| fit of a set | `_fit` |
| nonparametric components | `_components` |
| search over sets | `_search` |
| probabilities of all hypotheses, prior | `_posterior` |
| answer from the posterior | `_decision` |
| where the gap is, curves along an axis | `_gap` |
| result: estimates, model, held-out shrink, detection limits | `_result` |
| from recordings to the result; leave one motion out | `_diagnose` |
| ranked table, and why each hypothesis lost | `_ranking` |
| motions to measure next, by expected information | `_next_motion` |
"""

from needleplan.diagnosis.posterior._decision import PosteriorAnswer, PosteriorDecision, Ranked, decide
from needleplan.diagnosis.posterior._diagnose import default_library, diagnose_posterior
from needleplan.diagnosis.posterior._gap import GapPart, residuals_of
from needleplan.diagnosis.posterior._next_motion import CandidateMotion, NextTrials, next_trials
from needleplan.diagnosis.posterior._ranking import RankedHypothesis, hypothesis_words, ranked_hypotheses
from needleplan.diagnosis.posterior._result import PosteriorDiagnosis
from needleplan.diagnosis.posterior._settings import Setting, Settings

__all__ = [
    "CandidateMotion",
    "GapPart",
    "NextTrials",
    "PosteriorAnswer",
    "PosteriorDecision",
    "PosteriorDiagnosis",
    "Ranked",
    "RankedHypothesis",
    "Setting",
    "Settings",
    "decide",
    "default_library",
    "diagnose_posterior",
    "hypothesis_words",
    "next_trials",
    "ranked_hypotheses",
    "residuals_of",
]
