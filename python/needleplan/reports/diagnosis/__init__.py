"""Diagnose the recordings of a model, and write a diagnosis into a folder: report, model, next motion, scenario."""

from needleplan.reports.diagnosis.comparison import ModelComparison, TrialGap, compare
from needleplan.reports.diagnosis.corrected_plan import CorrectedPlan, along_mm, corrected_plan
from needleplan.reports.diagnosis.document import SCHEMA, document_of, whole_document
from needleplan.reports.diagnosis.effect_file import effect_file_text
from needleplan.reports.diagnosis.folder import (
    FILES,
    MOST_TRIALS,
    DiagnosisSource,
    diagnose_records,
    lines_of,
    next_trials_of,
    write_folder,
)
from needleplan.reports.diagnosis.motion_file import motion_problem, motion_text
from needleplan.reports.diagnosis.traces import traces_of

__all__ = [
    "FILES",
    "MOST_TRIALS",
    "SCHEMA",
    "CorrectedPlan",
    "DiagnosisSource",
    "ModelComparison",
    "TrialGap",
    "along_mm",
    "compare",
    "corrected_plan",
    "diagnose_records",
    "document_of",
    "effect_file_text",
    "lines_of",
    "motion_problem",
    "motion_text",
    "next_trials_of",
    "traces_of",
    "whole_document",
    "write_folder",
]
