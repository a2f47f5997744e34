"""The robot in C of the examples, compiled for the tests."""

from __future__ import annotations

import socket
import subprocess
from pathlib import Path

from tests import pages


def free_port() -> int:
    """Return a UDP port of this machine that nobody uses."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        return int(free.getsockname()[1])


def robot_in_c(folder: Path, *options: str, source: str = "robot") -> Path:
    """Compile `robot.c`, or another file of the example, with all warnings as errors, and return the program."""
    made = folder / source
    strict = ("-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "-O2", f"-I{pages.ROOT}/docs/reference")
    file = pages.ROOT / f"examples/robot-in-c/{source}.c"
    subprocess.run(["cc", *strict, *options, file, "-o", made, "-lm"], check=True, timeout=120)
    return made
