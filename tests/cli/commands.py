"""Runs the program: in this process, which takes milliseconds, or in a process of its own, as a user does."""

import contextlib
import io
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from needleplan.cli import main

# Time in s after which a command is taken to hang.
TIMEOUT_S = 120

Done = subprocess.CompletedProcess[str]


@contextlib.contextmanager
def at_most(seconds: float, what: str) -> Iterator[None]:
    """Fail the test if the block takes longer. Only the main thread can be interrupted like this."""

    def fail(*_: object) -> None:
        # A BaseException: the program cannot take it for an error of its own.
        pytest.fail(f"{what}: still runs after {seconds} s")

    before = signal.signal(signal.SIGALRM, fail)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)


def needleplan(*arguments: object, cwd: Path | None = None) -> Done:
    """Run a command in this process."""
    words = [str(each) for each in arguments]
    output, errors = io.StringIO(), io.StringIO()
    with (
        contextlib.redirect_stdout(output),
        contextlib.redirect_stderr(errors),
        contextlib.chdir(cwd or Path.cwd()),
        at_most(TIMEOUT_S, " ".join(["needleplan", *words])),
    ):
        try:
            code = main(words)
        except SystemExit as end:
            code = int(end.code or 0)
    return Done(words, code, output.getvalue(), errors.getvalue())


def program(*arguments: object, cwd: Path | None = None) -> Done:
    """Run a command in a process of its own."""
    command = [sys.executable, "-m", "needleplan", *map(str, arguments)]
    return subprocess.run(command, cwd=cwd, capture_output=True, text=True, timeout=TIMEOUT_S, check=False)


def refused(done: Done, *words: str) -> None:
    """Assert one clear message, exit code 2, nothing on standard output and no traceback."""
    assert done.returncode == 2, done.stderr
    assert done.stdout == ""
    assert "Traceback" not in done.stderr
    for word in words:
        assert word in done.stderr
