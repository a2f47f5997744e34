"""Ctrl-C, sent for real, at random moments: exit code 130 and never a traceback."""

import random
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.conftest import SMALL

TRIES = 8
LONGEST_S = 1.5
BEGUN = re.compile(r"\| +argparse$")  # the import that follows the handler


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("interrupt")
    slow = SMALL.replace("tolerance = 1e-3", 'tolerance = 1e-9\nmethod = "vi"')
    (path / "slow.toml").write_text(slow.replace("[solver]", "[grid]\nspacing_mm = [0.2, 0.2]\n[solver]"))
    return path


def interrupted(arguments: list[str], after_s: float, cwd: Path, start: list[str]) -> tuple[int, str]:
    """Start the program, interrupt it some time after it has begun, and return its exit code and what it said."""
    process = subprocess.Popen(
        [sys.executable, "-X", "importtime", *start, *arguments],
        cwd=cwd, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
        # A background job of a shell ignores interrupts, and so would its children.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )  # fmt: skip
    with process:
        assert process.stderr is not None
        said = []
        for line in process.stderr:
            said.append(line)
            if BEGUN.search(line):
                break
        time.sleep(after_s)
        process.send_signal(signal.SIGINT)
        said += process.stderr.readlines()
    return process.returncode, "".join(line for line in said if not line.startswith("import time:"))


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(TRIES))
def test_an_interrupt_at_any_moment(seed: int, folder: Path) -> None:
    after_s = random.Random(seed).uniform(0.0, LONGEST_S) * (seed > 0)
    entry = ["-c", "import sys; from needleplan.cli import main; sys.exit(main())"]
    start = entry if seed % 2 else ["-m", "needleplan"]
    code, said = interrupted(["plan", "slow.toml", "-o", "table.h5"], after_s, folder, start)
    assert "Traceback" not in said
    assert "KeyboardInterrupt" not in said
    assert code == 130
    assert said.splitlines()[-1] == "needleplan: interrupted"
    assert [each.name for each in folder.iterdir()] == ["slow.toml"]


@pytest.mark.parametrize("seed", range(2))
def test_a_second_interrupt_ends_at_once(seed: int, folder: Path) -> None:
    process = subprocess.Popen(
        [sys.executable, "-m", "needleplan", "plan", "slow.toml"],
        cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )  # fmt: skip
    assert process.stderr is not None
    process.stderr.readline()
    for _ in range(2):
        process.send_signal(signal.SIGINT)
        time.sleep(0.02 * seed)
    _, said = process.communicate(timeout=60)
    assert "Traceback" not in said
    assert said.splitlines()[-1] == "needleplan: interrupted"
    assert process.returncode in (130, -signal.SIGINT)  # a shell reports 130 for both


@pytest.mark.slow
def test_an_interrupt_ends_an_evaluation_while_it_runs(table_file: Path) -> None:
    arguments = ["evaluate", str(table_file), "--start", "0,25,0", "--runs", "5e7"]
    process = subprocess.Popen(
        [sys.executable, "-c", EVALUATION, *arguments],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )  # fmt: skip
    assert process.stdout is not None
    assert process.stdout.readline() == "runs\n"
    time.sleep(0.2)  # the runs take ten seconds and more
    sent = time.monotonic()
    process.send_signal(signal.SIGINT)
    output, said = process.communicate(timeout=60)
    assert time.monotonic() - sent < 1  # 0.02 to 0.08 s in 16 of 16, beside ten other programs
    assert (process.returncode, output, said) == (130, "", "needleplan: interrupted\n")


# A program that tells when the runs of `evaluate` begin.
EVALUATION = """
import sys
from needleplan import cli
from needleplan.planning import _execution
rollouts = _execution.Execution.rollouts
def told(*arguments):
    print("runs", flush=True)
    return rollouts(*arguments)
_execution.Execution.rollouts = told
sys.exit(cli.main())
"""


# A program that writes a file in child processes; the n-th is interrupted at the n-th call or return of a function.
WRITING = """
import os, signal, sys
from pathlib import Path
from needleplan import cli
from needleplan.artifacts import whole_file
import needleplan.cli.program as program

def run_command(_):
    left = int(os.environ["AT"])
    def count(*_):
        nonlocal left
        left -= 1
        if left == 0:
            os.kill(os.getpid(), signal.SIGINT)
    sys.setprofile(count)
    with whole_file("table") as partial:
        partial.write_bytes(b"whole")
    sys.setprofile(None)
    return 3 if left > 0 else 0

program.run_command = run_command
for at in range(1, 1000):
    os.environ["AT"] = str(at)
    child = os.fork()
    if not child:
        os._exit(cli.main())
    code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    found = sorted(os.listdir())
    print(code, *found)
    if "table" in found:
        assert Path("table").read_bytes() == b"whole"
        os.unlink("table")
    if code == 3:
        break
"""


@pytest.mark.slow
def test_an_interrupt_at_any_call_leaves_no_unfinished_file(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-c", WRITING], cwd=tmp_path, capture_output=True, text=True, check=False, timeout=60
    )
    ends = done.stdout.splitlines()
    assert set(ends) == {"130", "130 table", "3 table"}, done.stdout + done.stderr
    assert len(ends) > 50
    assert ends[-1] == "3 table"


def test_an_interrupt_where_python_cannot_raise_it_ends_the_program() -> None:
    code = """if True:
        import signal, sys
        from needleplan import cli
        class Dying:
            def __del__(self):
                signal.raise_signal(signal.SIGINT)
                sum(range(1000))
        import needleplan.cli.program as program
        def run_command(_):
            Dying()
            return 0
        program.run_command = run_command
        sys.exit(cli.main())
    """
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False, timeout=60)
    assert (done.returncode, done.stderr) == (130, "needleplan: interrupted\n")


def test_an_interrupt_that_a_library_turns_into_an_error_is_one() -> None:
    code = """if True:
        import signal, sys
        from needleplan import cli
        import needleplan.cli.program as program
        def run_command(_):
            try:
                signal.raise_signal(signal.SIGINT)
            except KeyboardInterrupt:
                raise ImportError("cannot import name") from None
        program.run_command = run_command
        sys.exit(cli.main())
    """
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False, timeout=60)
    assert (done.returncode, done.stderr) == (130, "needleplan: interrupted\n")


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_sigterm_and_a_closed_terminal_end_a_command_like_an_interrupt(number: signal.Signals, folder: Path) -> None:
    process = subprocess.Popen(
        [sys.executable, "-m", "needleplan", "plan", "slow.toml", "-o", "table.h5"],
        cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    assert process.stderr is not None
    process.stderr.readline()
    process.send_signal(number)
    _, said = process.communicate(timeout=60)
    assert (process.returncode, said) == (128 + number, "needleplan: interrupted\n")
    assert [each.name for each in folder.iterdir()] == ["slow.toml"]


@pytest.mark.slow
def test_a_signal_that_the_process_ignores_stays_ignored(folder: Path) -> None:
    """As under nohup."""
    process = subprocess.Popen(
        [sys.executable, "-m", "needleplan", "plan", "slow.toml"],
        cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        preexec_fn=lambda: signal.signal(signal.SIGHUP, signal.SIG_IGN),
    )  # fmt: skip
    assert process.stderr is not None
    process.stderr.readline()
    process.send_signal(signal.SIGHUP)
    with pytest.raises(subprocess.TimeoutExpired):
        process.wait(0.5)
    process.send_signal(signal.SIGTERM)
    process.communicate(timeout=60)
    assert process.returncode == 128 + signal.SIGTERM


SWALLOWED = """
import os, signal, sys
from needleplan.cli import main
import needleplan.cli.program as program

def swallowing(arguments, run=program.run_command):
    try:
        os.kill(os.getpid(), signal.SIGINT)
    except BaseException:
        pass  # as a library may do
    return run(arguments)

program.run_command = swallowing
sys.exit(main())
"""


@pytest.mark.slow
def test_an_interrupt_that_a_library_swallows_ends_the_command(folder: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-c", SWALLOWED, "plan", "slow.toml", "-o", "table.h5"],
        cwd=folder, capture_output=True, text=True, check=False, timeout=120,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )  # fmt: skip
    assert (done.returncode, done.stderr.splitlines()[-1]) == (130, "needleplan: interrupted")
    assert [each.name for each in folder.iterdir()] == ["slow.toml"]
