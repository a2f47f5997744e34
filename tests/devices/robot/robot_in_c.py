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


def robot_in_c(folder: Path, *options: str, source: str = "robot", change: tuple[str, str] = ("", "")) -> Path:
    """Compile `robot.c`, or another file of the example, with all warnings as errors, and return the program.

    `change` replaces a text of the file.
    """
    made, example = folder / source, pages.ROOT / "examples/robot-in-c"
    strict = ("-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "-O2", f"-I{pages.ROOT}/docs/reference")
    text = (example / f"{source}.c").read_text()
    assert change[0] in text
    file = folder / f"{source}.c"
    file.write_text(text.replace(*change, 1))
    subprocess.run(["cc", *strict, f"-I{example}", *options, file, "-o", made, "-lm"], check=True, timeout=120)
    return made
