"""A diagnosis on files: model and data in, a folder with the diagnosis out."""

from needleplan.reports.diagnosis.folder import diagnose_files, write_folder

__all__ = ["diagnose_files", "write_folder"]
