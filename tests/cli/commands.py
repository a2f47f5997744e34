"""Runs the program as a user does."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path


def needleplan(*arguments: str | Path, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
    """Run `needleplan` in a process of its own."""
    command = [sys.executable, "-m", "needleplan", *map(str, arguments)]
    return subprocess.run(command, cwd=cwd, capture_output=True, text=True, timeout=120, check=False)


def refused(done: subprocess.CompletedProcess[str], *words: str) -> None:
    """Assert one clear message, exit code 2, nothing on standard output and no traceback."""
    assert done.returncode == 2, done.stderr
    assert done.stdout == ""
    assert "Traceback" not in done.stderr
    for word in words:
        assert word in done.stderr
