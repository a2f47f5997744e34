"""Output of the second edition of the diagnosis: document, report, curves, model, and motions."""

from needleplan.reports.diagnosis.posterior.document import SCHEMA, document_of, whole_document
from needleplan.reports.diagnosis.posterior.folder import (
    MOST_TRIALS,
    POSTERIOR_FILES,
    diagnose_records,
    lines_of,
    next_trials_of,
    write_folder,
)
from needleplan.reports.diagnosis.posterior.traces import traces_of

__all__ = [
    "MOST_TRIALS",
    "POSTERIOR_FILES",
    "SCHEMA",
    "diagnose_records",
    "document_of",
    "lines_of",
    "next_trials_of",
    "traces_of",
    "whole_document",
    "write_folder",
]
