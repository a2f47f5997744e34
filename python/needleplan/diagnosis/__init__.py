"""Diagnosis: where simulation and measurement disagree, which effect is missing, its amplitude, and the uncertainty.

The stages of a diagnosis, in the order of the data:

| stage | module |
|---|---|
| check the recordings, fit the sensor noise | `data` |
| calibrate the base model to each trial | `calibration`; `channels` describes the measured quantities |
| score every effect of the catalogue | `catalogue`; `likelihood` holds the linear algebra |
| fit effects jointly with the base model | `joint_fit` |
| compare with nonparametric alternatives, validate on held-out trials | `alternatives` |
| select effects round by round | `selection_round`, `selection` |
| decide the verdict, estimate amplitudes | `_verdict` |
| locate the gap, describe a gap that no effect explains | `gap`, `formula` |
| collect the result, write it as a document | `_diagnosis` |

`next_motion` proposes the motion to measure next. `isolability` shows which effects the recorded motions can separate.
"""

import needleplan.extras.lab  # noqa: F401  # raises MissingLibraryError
from needleplan.diagnosis._diagnosis import SCHEMA, Diagnosis, diagnose, document_of
from needleplan.diagnosis._isolability import Isolability, isolability
from needleplan.diagnosis._verdict import DiagnosisDecision, Verdict
from needleplan.diagnosis.calibration import CalibratedTrial
from needleplan.diagnosis.catalogue import FittedEffect, Library
from needleplan.diagnosis.channels import GapAxis
from needleplan.diagnosis.data import Lack
from needleplan.diagnosis.formula import Formula, GapDescription
from needleplan.diagnosis.gap import Curve, Curves, MotionPhase, motion_phases
from needleplan.diagnosis.joint_fit import recalibrated_trials
from needleplan.diagnosis.likelihood import Gates
from needleplan.diagnosis.selection_round import RoundOutcome

__all__ = [
    "SCHEMA",
    "CalibratedTrial",
    "Curve",
    "Curves",
    "Diagnosis",
    "DiagnosisDecision",
    "FittedEffect",
    "Formula",
    "GapAxis",
    "GapDescription",
    "Gates",
    "Isolability",
    "Lack",
    "Library",
    "MotionPhase",
    "RoundOutcome",
    "Verdict",
    "diagnose",
    "document_of",
    "isolability",
    "motion_phases",
    "recalibrated_trials",
]
