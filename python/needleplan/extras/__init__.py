"""The optional libraries of needleplan: which extra of the package installs which library.

`plan` and the look-up need numpy, h5py and shapely only. Everything else is in an extra, such as
``pip install "needleplan[lab]"``; `docs/how-to/install.md` lists them. A missing library raises
`needleplan.errors.MissingLibraryError`, which names the extra.
"""

from __future__ import annotations

import sys
from importlib.util import find_spec
from types import MappingProxyType

from needleplan.errors import MissingLibraryError, Mistake

__all__ = ["EXTRAS", "explained", "is_installed", "require"]

EXTRAS = MappingProxyType({
    "matplotlib": "figures",
    "scipy": "lab",
    "filterpy": "lab",
    "mcap": "lab",
    "threadpoolctl": "lab",
    "pyarrow": "export",
    "rosbags": "export",
    "distributed": "sweep",
    "canopen": "canopen",
    "svgelements": "svg",
    "nibabel": "volumes",
    "nrrd": "volumes",
    "pydicom": "dicom",
    "starlette": "view",
    "uvicorn": "view",
    "xarray": "xarray",
})  # fmt: skip
"""The extra that installs a library, by the name under which Python imports the library."""


def require(*libraries: str) -> None:
    """Raise MissingLibraryError if one of the libraries is not installed. The names are keys of `EXTRAS`.

    No library is imported; the check of one library takes 0.1 ms.
    """
    for library in libraries:
        if not is_installed(library):
            raise _missing(library)


def explained(error: ImportError) -> MissingLibraryError | None:
    """Return an error that names the extra to install if `error` is due to a missing optional library, else None."""
    library = (error.name or "").partition(".")[0]
    return _missing(library) if library in EXTRAS and not is_installed(library) else None


def is_installed(library: str) -> bool:
    """Return whether Python finds the library; the library is not imported."""
    if library in sys.modules:
        return sys.modules[library] is not None
    try:
        return find_spec(library) is not None
    except ImportError:
        return False


def _missing(library: str) -> MissingLibraryError:
    rule = f"needs {library}: install it with `pip install needleplan[{EXTRAS[library]}]`"
    return MissingLibraryError(Mistake("", "", rule))
