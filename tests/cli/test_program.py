"""The program as a whole."""

import os
import subprocess
import sys
import tomllib
from importlib import metadata
from pathlib import Path

import pytest

from needleplan.cli import scenarios
from needleplan.reports.chapters import GROUP
from tests.cli.commands import needleplan
from tests.control.scenes import small_table
from tests.pages import ROOT


def test_help_names_every_command() -> None:
    done = needleplan("--help")
    assert done.returncode == 0
    for command in ("plan", "path", "evaluate", "entry", "info", "reproduce"):
        assert command in done.stdout
        assert needleplan(command, "--help").returncode == 0


@pytest.mark.parametrize(
    ("error", "says"),
    [
        (PermissionError(13, "Permission denied", "somewhere.h5"), "somewhere.h5: Permission denied"),
        (OSError(24, "Too many open files"), "Too many open files"),
        (OSError("no device"), "no device"),
    ],
)
def test_an_error_of_the_system_is_not_laid_to_the_standard_output(
    error: OSError, says: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(_: object) -> int:
        raise error

    monkeypatch.setattr(scenarios, "_run_scenarios", fail)
    done = needleplan("scenarios")
    assert (done.returncode, done.stderr) == (2, f"needleplan: {says}\n")


def test_version() -> None:
    assert needleplan("--version").stdout == f"needleplan {metadata.version('needleplan')}\n"


def test_the_installed_chapters_are_those_of_the_project() -> None:
    listed = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["entry-points"][GROUP]
    installed = metadata.entry_points(group=GROUP)
    assert sorted((each.name, each.value) for each in installed) == sorted(listed.items())
    for each in installed:
        chapter = each.load()
        assert callable(chapter.run), each
        assert callable(chapter.files), each


def test_nothing_heavy_is_imported_before_it_is_needed() -> None:
    code = (
        "import sys, needleplan.cli; needleplan.cli.main(['info', '/nowhere.h5']);"
        "print(*sorted({'matplotlib', 'h5py', 'shapely', 'scipy'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["h5py"]
    # A stop waits for nothing that it does not need.
    code = (
        "import sys, needleplan.cli;"
        "code = needleplan.cli.main(['stop', '--robot', 'udp://127.0.0.1:1', '--within', '0.1']);"
        "print(code, *sorted({'matplotlib', 'h5py', 'shapely', 'numpy', 'needleplan.planning'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split()[1:] == []


@pytest.mark.slow
@pytest.mark.parametrize(
    ("command", "not_needed"),
    [
        (["recording", "info", "/nowhere.mcap"], {"scipy", "h5py", "matplotlib"}),
        (["simulate", "nowhere"], {"scipy.stats", "scipy.signal", "scipy.interpolate", "filterpy", "matplotlib"}),
        (["lab", "nowhere"], {"scipy.stats", "scipy.signal", "scipy.interpolate", "filterpy", "matplotlib"}),
    ],
    ids=lambda value: value[0] if isinstance(value, list) else None,
)
def test_what_takes_a_second_to_import_is_not_imported_by_who_does_not_use_it(
    command: list[str], not_needed: set[str]
) -> None:
    code = f"import sys, needleplan.cli; needleplan.cli.main({command}); print(*({not_needed} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == []
    assert "nowhere" in done.stderr


@pytest.mark.slow
def test_nothing_is_imported_while_the_needle_moves(tmp_path: Path) -> None:
    """An import takes longer than the robot waits for a sign of life."""
    small_table().write(tmp_path / "table.h5")
    code = """if True:
        import sys
        from dataclasses import replace
        from needleplan.control import Insertion, Options, RunRecorder, RunSetup
        from needleplan.estimation.tip import TipSettings
        from needleplan.planning import PolicyTable
        from needleplan.simulation import Simulation, simulated_station
        table, steering = PolicyTable.read("table.h5"), Simulation.read("steering")
        effects = replace(steering.setup.effects, curvature_error=0.3, heading_noise_rad_sqrt_mm=0.002)
        bent = replace(steering.setup, effects=effects)
        station = simulated_station(replace(steering, setup=bent), table, table.best_entry().pose)
        options = Options(velocity_mm_s=10, velocity_rad_s=10, torsion=station.torsion)
        known = station.registration
        setup = RunSetup(options, registration=known)
        with station, RunRecorder("run.mcap", table, setup, station.clock) as recorder:
            quiet = TipSettings(heading_sd_rad_sqrt_mm=0.002)
            with Insertion(
                table, station, options, registration=known, tip_settings=quiet, listeners=[recorder]
            ) as loop:
                before = set(sys.modules)
                report = loop.run()
                new = {name.partition(".")[0] for name in set(sys.modules) - before}
        print(len(report.steps), report.replans, *(new & {"scipy", "filterpy", "numpy", "needleplan", "mcap"}))
    """
    where = {"cwd": tmp_path, "env": {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, **where)
    steps, replans, *imported = done.stdout.split()
    assert int(steps) > 2
    assert int(replans) > 0
    assert imported == []
