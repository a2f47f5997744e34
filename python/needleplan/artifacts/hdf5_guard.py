"""Reading of HDF5 files that may be damaged, in a child process with limits of time and memory.

One damaged byte may make libhdf5 loop for ever or crash. `_hdf5_child.py` is the program of the child process.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

from needleplan.errors import DataError

__all__ = ["in_child", "require_harmless"]

_CHILD = Path(__file__).with_name("_hdf5_child.py")
_LEAST_CPU_S = 5  # CPU time (s) that every file may take, including the start of the child, 0.4 s
_BYTES_PER_S = 4_000_000  # further file size (bytes) that gives a second more; libhdf5 is 10 to 100 times as fast
_WALL_FACTOR = 4  # wall time over CPU time on a machine with other work
_LEAST_MEMORY_BYTES = 2**31
_MEMORY_FACTOR = 64  # further memory over file size; compressed columns are up to 20 times as large as in the file


def require_harmless(path: str | os.PathLike[str]) -> None:
    """Raise DataError if libhdf5 crashes or loops when it opens a file with all its datasets and attributes.

    A child process tries it, which takes 0.4 s. What is wrong otherwise is for the reader of the file to find.
    """
    size = Path(path).stat().st_size
    in_child(["try", os.fspath(path)], b"", size, os.fspath(path))


def in_child(arguments: list[str], content: bytes, size: int, source: str) -> bytes:
    """Return what the child process writes. Raises DataError if it crashes, takes too long, or cannot be started."""
    cpu_s = _LEAST_CPU_S + size // _BYTES_PER_S
    memory_bytes = _LEAST_MEMORY_BYTES + _MEMORY_FACTOR * size
    try:
        done = subprocess.run(
            [sys.executable, "-P", str(_CHILD), str(cpu_s), str(memory_bytes), *arguments],
            input=content, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, timeout=_WALL_FACTOR * cpu_s, check=False,
            start_new_session=True,  # Ctrl-C reaches the parent, which ends the child
            # One thread of a library of linear algebra takes address space that the memory limit would count.
            env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path), "OPENBLAS_NUM_THREADS": "1"},
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        raise DataError(_slow(cpu_s), source) from None
    except OSError as error:
        raise DataError(f"cannot be read: no Python process can be started: {error.strerror}", source) from error
    if done.returncode:
        slow = done.returncode in (-getattr(signal, "SIGXCPU", 0), -getattr(signal, "SIGKILL", 0))
        raise DataError(_slow(cpu_s) if slow else "is damaged: libhdf5 crashed when reading it", source)
    return bytes(done.stdout)


def _slow(cpu_s: int) -> str:
    return f"is damaged: libhdf5 did not finish reading it in {cpu_s} s"
