"""Runs the notebooks, which are kept without output, for the site and for the tests."""

import sys
import time
from pathlib import Path
from typing import Any

import nbformat
from nbclient import NotebookClient
from traitlets.config import Config

_TIMEOUT_S = 300  # seconds after which a cell counts as hung


def read(file: Path) -> Any:
    """Return a notebook as it is kept."""
    return nbformat.read(file, as_version=4)


def executed(file: Path) -> Any:
    """Return a notebook with the output of all cells. Raises CellExecutionError at the first cell that fails."""
    book = read(file)
    config = Config()
    config.KernelManager.transport = "ipc"  # no network between this process and the kernel
    NotebookClient(book, timeout=_TIMEOUT_S, kernel_name="python3", config=config).execute()
    return book


def write(folder: Path, files: list[Path]) -> None:
    """Write the executed notebooks into a folder."""
    folder.mkdir()
    for file in files:
        begin_s = time.perf_counter()
        nbformat.write(executed(file), folder / file.name)
        print(f"{file.name}: {time.perf_counter() - begin_s:.0f} s", file=sys.stdout, flush=True)
