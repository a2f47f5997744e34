"""Policy tables as MATLAB files (.mat, version 7): the arrays, their axes, the scenario, and digests of all.

The axes of the arrays are [x, y, heading, bevel] in MATLAB too, unlike those that MATLAB's `h5read` shows.
"""

from __future__ import annotations

import io
import os
from dataclasses import asdict
from typing import Any

import numpy as np

from needleplan.artifacts import version, write_whole
from needleplan.extras import require
from needleplan.planning._plane_file import TABLES
from needleplan.planning._table import PolicyTable

__all__ = ["write_mat"]

_FORMAT = "needleplan.table-mat/1"


def write_mat(table: PolicyTable, path: str | os.PathLike[str]) -> None:
    """Write a policy table to a MATLAB file for `load`. If this fails, an existing file is unchanged.

    Parameters
    ----------
    table : PolicyTable
        The table.
    path : str or path
        The file to write.

    Raises
    ------
    OutputError
        If the file cannot be written.
    MissingLibraryError
        If scipy is not installed.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> import needleplan as npl
    >>> from needleplan.planning import write_mat
    >>> table = npl.plan("four_obstacles")
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     write_mat(table, Path(folder) / "table.mat")
    ...     (Path(folder) / "table.mat").stat().st_size > 0
    True
    """
    require("scipy")
    from scipy.io import savemat

    scenario = table.scenario
    content: dict[str, Any] = {
        "format": _FORMAT,
        "made_by": f"needleplan {version()}",
        **{name: getattr(table, name) for name in TABLES},
        "x_mm": scenario.x_mm,
        "y_mm": scenario.y_mm,
        "heading_rad": scenario.headings_rad,
        "bevel": np.array([-1.0, 1.0]),
        "spacing_mm": np.array(scenario.grid.spacing_mm),
        "scenario": scenario.to_toml(),
        "digest": table.digest,
        "stats": asdict(table.stats) | {"status": str(table.stats.status), "order": np.array(table.stats.order, float)},
    }
    image = io.BytesIO()
    # The stubs of scipy do not know streams.
    savemat(image, content, do_compression=True, oned_as="column")  # type: ignore[arg-type]
    write_whole(path, image.getbuffer())
