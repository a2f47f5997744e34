"""Real Dask clusters on this machine: a scheduler and workers as processes of their own, which tests may kill."""

import contextlib
import os
import signal
import socket
import subprocess
import sys
from pathlib import Path
from types import TracebackType
from typing import Self

from tests.pages import environment
from tests.recording.samples import wait_for


class DaskProcesses:
    """A scheduler and workers; all of them are killed at the end."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            self.port: int = probe.getsockname()[1]
        self.address = f"tcp://127.0.0.1:{self.port}"
        self._all: list[subprocess.Popen[bytes]] = []

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, _: TracebackType | None) -> None:
        for process in self._all:
            kill(process)

    def scheduler(self) -> subprocess.Popen[bytes]:
        """Start a scheduler at the address of this cluster."""
        process = self._start("scheduler", "--host", "127.0.0.1", "--port", str(self.port), "--no-dashboard")
        wait_for(lambda: self._answers() or process.poll() is not None)
        return process

    def _answers(self) -> bool:
        with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", self.port), 1.0):
            return True
        return False

    def worker(self, *, path: Path | None = None) -> subprocess.Popen[bytes]:
        """Start a worker without a nanny; `path` is put in front of the folders of its modules."""
        options = ("--nthreads", "1", "--no-nanny", "--no-dashboard", "--death-timeout", "30")
        return self._start("worker", self.address, *options, path=path)

    def _start(self, *arguments: str, path: Path | None = None) -> subprocess.Popen[bytes]:
        env = environment()
        if path:
            env["PYTHONPATH"] = os.pathsep.join([str(path), env.get("PYTHONPATH", "")])
        with (self.folder / f"{arguments[0]}-{len(self._all)}.log").open("wb") as log:
            process = subprocess.Popen(
                [sys.executable, "-m", "dask", *arguments],
                cwd=self.folder, env=env, stdout=log, stderr=log, start_new_session=True,
            )  # fmt: skip
        self._all.append(process)
        return process


def kill(process: subprocess.Popen[bytes] | subprocess.Popen[str]) -> None:
    """Kill a process and its children at once, as a power failure does."""
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    process.wait(20)
