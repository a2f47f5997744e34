"""The program as a whole."""

from __future__ import annotations

import subprocess
import sys
from importlib import metadata

from tests.cli.commands import needleplan


def test_help_names_every_command() -> None:
    done = needleplan("--help")
    assert done.returncode == 0
    for command in ("plan", "path", "evaluate", "entry", "info", "reproduce"):
        assert command in done.stdout
        assert needleplan(command, "--help").returncode == 0


def test_version() -> None:
    assert needleplan("--version").stdout == f"needleplan {metadata.version('needleplan')}\n"


def test_nothing_heavy_is_imported_before_it_is_needed() -> None:
    code = (
        "import sys, needleplan.cli; needleplan.cli.main(['info', '/nowhere.h5']);"
        "print(*sorted({'matplotlib', 'h5py', 'shapely', 'scipy'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["h5py"]
    code = "import sys, needleplan.cli; print(*sorted({'matplotlib', 'h5py', 'shapely', 'numpy'} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == []
