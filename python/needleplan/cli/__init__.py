"""The command line, `needleplan`."""

from needleplan.cli.program import main

__all__ = ["main"]
