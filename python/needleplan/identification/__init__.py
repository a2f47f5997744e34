"""Identification of models from data files, one file a kind."""

from needleplan.identification.identification import Finding, Identification

__all__ = ["Finding", "Identification"]
