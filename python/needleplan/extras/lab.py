"""Importing this module raises MissingLibraryError if a library of the extra `lab` is not installed.

The packages that cannot be imported without these libraries import this module first.
"""

from needleplan.extras import EXTRAS, require

__all__: list[str] = []

require(*(library for library, extra in EXTRAS.items() if extra == "lab"))
