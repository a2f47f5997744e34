"""A diagnosis on files: model and data in, a folder with the diagnosis out."""

from needleplan.reports.diagnosis.folder import FILES, diagnose_files, write_folder

__all__ = ["FILES", "diagnose_files", "write_folder"]
