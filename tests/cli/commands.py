"""Runs the program: in this process, which takes milliseconds, or in a process of its own, as a user does."""

from __future__ import annotations

import contextlib
import io
import subprocess
import sys
from pathlib import Path

from needleplan.cli import main

Done = subprocess.CompletedProcess[str]


def needleplan(*arguments: object, cwd: Path | None = None) -> Done:
    """Run a command in this process."""
    words = [str(each) for each in arguments]
    output, errors = io.StringIO(), io.StringIO()
    with (
        contextlib.redirect_stdout(output),
        contextlib.redirect_stderr(errors),
        contextlib.chdir(cwd or Path.cwd()),
    ):
        try:
            code = main(words)
        except SystemExit as end:
            code = int(end.code or 0)
    return Done(words, code, output.getvalue(), errors.getvalue())


def program(*arguments: object, cwd: Path | None = None) -> Done:
    """Run a command in a process of its own."""
    command = [sys.executable, "-m", "needleplan", *map(str, arguments)]
    return subprocess.run(command, cwd=cwd, capture_output=True, text=True, timeout=120, check=False)


def refused(done: Done, *words: str) -> None:
    """Assert one clear message, exit code 2, nothing on standard output and no traceback."""
    assert done.returncode == 2, done.stderr
    assert done.stdout == ""
    assert "Traceback" not in done.stderr
    for word in words:
        assert word in done.stderr
