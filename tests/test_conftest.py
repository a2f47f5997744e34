"""Tests restore signals that were ignored when they were started, and a failure is shown before the next test ends."""

import signal
import subprocess
import sys
from pathlib import Path

import pytest

from tests import pages

TESTS = """
import os, signal, subprocess, sys
SHOW = "import signal; print(*(signal.getsignal(number).name for number in (1, 15)), signal.getsignal(2).__name__)"

def test_child():
    done = subprocess.run([sys.executable, "-c", SHOW], capture_output=True, text=True)
    assert done.stdout == "SIG_DFL SIG_DFL default_int_handler\\n"

def test_self():
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL
    os.kill(os.getpid(), signal.SIGHUP)  # the tests go on, as under nohup

def test_fails():
    assert "shown" == "once"

def test_last():
    print("the last test")
"""


def ignore() -> None:
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)


@pytest.mark.slow
def test_ignored_signals_are_restored_and_a_failure_is_shown_at_once_and_once(tmp_path: Path) -> None:
    file = tmp_path / "test_some.py"
    file.write_text(TESTS)
    options = ["-s", "-c", "/dev/null", "-p", "tests.conftest", "-p", "no:cacheprovider"]
    done = subprocess.run(
        [sys.executable, "-m", "pytest", *options, file],
        cwd=pages.ROOT, capture_output=True, text=True, check=False, timeout=120, preexec_fn=ignore,
    )  # fmt: skip
    assert "1 failed, 3 passed" in done.stdout, done.stdout + done.stderr
    assert done.stdout.count('>       assert "shown" == "once"') == 1
    assert done.stdout.index('assert "shown" == "once"') < done.stdout.index("the last test")
