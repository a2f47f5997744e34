"""Diagnose the recordings of a model, and write a diagnosis into a folder: report, model, next motion, scenario."""

from needleplan.reports.diagnosis.corrected_plan import CorrectedPlan, along_mm, corrected_plan
from needleplan.reports.diagnosis.effect_file import effect_file_text
from needleplan.reports.diagnosis.folder import FILES, diagnose_records, whole_document, write_folder
from needleplan.reports.diagnosis.motion_file import motion_text, next_motion_document
from needleplan.reports.diagnosis.source import DiagnosisSource
from needleplan.reports.diagnosis.traces import traces_of

__all__ = [
    "FILES",
    "CorrectedPlan",
    "DiagnosisSource",
    "along_mm",
    "corrected_plan",
    "diagnose_records",
    "effect_file_text",
    "motion_text",
    "next_motion_document",
    "traces_of",
    "whole_document",
    "write_folder",
]
