"""Which program of this machine owns the serial line to a robot.

Only one program can read a serial line. That program serves the robot to the others at a UDP port of this machine, and
writes the port into a file that it keeps locked, in a folder that only the user may enter.

`needleplan stop` uses this module before the whole program is imported, so it imports nothing that takes long.
"""

from __future__ import annotations

import os
import zlib

__all__ = ["line_place", "line_port", "run_folder"]


def run_folder() -> str:
    """Return the folder in which runs of this user leave their sockets and files."""
    folder = os.environ.get("XDG_RUNTIME_DIR") or os.environ.get("TMPDIR") or "/tmp"
    return f"{folder}/needleplan-{os.getuid()}"


def line_place(path: str) -> str:
    """Return the path of the file that the owner of a line locks. All names of one line have one path.

    Parameters
    ----------
    path : str
        Path of the serial port, such as /dev/ttyUSB0.

    Returns
    -------
    str
    """
    return f"{run_folder()}/{zlib.crc32(os.path.realpath(path).encode()):08x}.line"


def line_port(path: str) -> int | None:
    """Return the UDP port of this machine at which a program serves the robot on a line.

    Parameters
    ----------
    path : str
        Path of the serial port.

    Returns
    -------
    int or None
        None if no program of this user owns the line.
    """
    try:
        import fcntl  # Windows has none

        if os.lstat(run_folder()).st_uid != os.getuid():
            return None  # a folder of another user, whose port may be anything
        with open(line_place(path), encoding="ascii") as file:  # noqa: PTH123 (`pathlib` takes longer to import)
            try:
                fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
            except BlockingIOError:
                return int(file.read())
    except (ImportError, OSError, ValueError):
        return None
    return None
