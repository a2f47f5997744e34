"""Diagnosis: where simulation and measurement disagree, which effect is missing, its amplitude, and the uncertainty.

One likelihood of all trials gives the posterior probabilities of sets of missing effects. The mathematics is on one
page: docs/explanation/posterior.md. The stages, in the order of the data:

| stage | module |
|---|---|
| check the recordings, fit the sensor noise | `data` |
| calibrate the base model to each trial | `calibration`; `channels` describes measured quantities and tissue |
| effects on a grid of places, times and rates | `catalogue` |
| constants with unit, effect and reason: those that a user may change, and all others | `_settings`, `_constants` |
| evidence of a linear Gaussian model, and the products of one trial | `_evidence`, `_blocks` |
| errors of single trials, which all hypotheses share | `_problem` |
| law tolerance of reversal, base and effects | `_reversal`, `_base_law`, `_effect_law` |
| a set of effects at fitted values, and its evidence | `_hypothesis`, `_tangents`, `_fit`, `_refinement` |
| nonparametric components | `_components` |
| search over sets | `_search` |
| probabilities of all hypotheses, prior | `_posterior` |
| answer from the posterior | `_decision` |
| what closes the gap: budget and findings | `_budget` |
| ranked table, and why each hypothesis lost | `_ranking` |
| where the gap is, curves along an axis | `_gap` |
| result: estimates, model, held-out shrink, detection limits | `_result` |
| from recordings to the result | `_diagnose` |
| recordings from which the model was identified, as references | `references` |
| claims of a plan beside recorded insertions | `plan_claims` |
| motions to measure next, by expected information | `_next_motion`, `_programs` |

`isolability` shows which effects the recorded motions can separate.
"""

import needleplan.extras.lab  # noqa: F401  # raises MissingLibraryError
from needleplan.diagnosis._budget import FindingKind, GapBudget, GapFinding, GapStage, OtherLaw, OtherParameter
from needleplan.diagnosis._decision import DiagnosisDecision, Ranked, Verdict, decide
from needleplan.diagnosis._diagnose import default_library, diagnose
from needleplan.diagnosis._gap import Curve, Curves, GapPart, MotionPhase, motion_phases, residuals_of
from needleplan.diagnosis._isolability import Isolability, isolability
from needleplan.diagnosis._next_motion import CandidateMotion, NextTrials, next_trials
from needleplan.diagnosis._programs import programs, recorded_limits
from needleplan.diagnosis._ranking import RankedHypothesis, hypothesis_words, ranked_hypotheses
from needleplan.diagnosis._result import Diagnosis
from needleplan.diagnosis._settings import Setting, Settings
from needleplan.diagnosis.catalogue import DetectionLimit, FittedEffect, Library
from needleplan.diagnosis.channels import GapAxis
from needleplan.diagnosis.data import Lack
from needleplan.signals import Dwell, Insert, Limits, Program, Rotate

__all__ = [
    "CandidateMotion",
    "Curve",
    "Curves",
    "DetectionLimit",
    "Diagnosis",
    "DiagnosisDecision",
    "Dwell",
    "FindingKind",
    "FittedEffect",
    "GapAxis",
    "GapBudget",
    "GapFinding",
    "GapPart",
    "GapStage",
    "Insert",
    "Isolability",
    "Lack",
    "Library",
    "Limits",
    "MotionPhase",
    "NextTrials",
    "OtherLaw",
    "OtherParameter",
    "Program",
    "Ranked",
    "RankedHypothesis",
    "Rotate",
    "Setting",
    "Settings",
    "Verdict",
    "decide",
    "default_library",
    "diagnose",
    "hypothesis_words",
    "isolability",
    "motion_phases",
    "next_trials",
    "programs",
    "ranked_hypotheses",
    "recorded_limits",
    "residuals_of",
]
