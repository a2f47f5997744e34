"""Every bench runs, with few runs, small grids or one case, in one process that imports the package once."""

import importlib
import inspect
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

BENCHES = Path(__file__).parents[2] / "benches" / "python"
DATA = Path(__file__).parents[3] / "shared" / "data"
REAL = DATA / "real_insertions"


def _once(call: Callable[[], object], _: int) -> float:
    """Time a call once instead of several times."""
    begin = time.perf_counter()
    call()
    return time.perf_counter() - begin


# Words of the command line, and constants of the module, that make a bench short.
SHORT: dict[str, tuple[str, dict[str, Any]]] = {
    "adaptation": ("--seeds 2 --scenarios four_obstacles --ratios 1", {}),
    "breathing_gate": ("--runs 1", {"KINDS": ((10.0, 3.0),)}),
    "compare_mdp": ("--only none --time-limit 1", {}),
    "curvature": ("--trials 1", {}),
    "damaged_files": ("--files 1", {}),
    "deflection": ("--insertions 2", {}),
    "fault_proxy": ("--list", {}),
    "fit_intervals": ("--short", {}),
    "force_filter": ("--sets 1 --every 100 --factors 3", {}),
    "joint_filter": ("--starts 1", {"PUBLISHED_FORCES": ()}),
    "lookup": ("--spacing 2", {"POSES": 1000, "timed": _once, "shell": lambda _: {}}),
    "next_insertion": ("--short", {}),
    "predicted_tip": ("--runs 1 --layers 1", {}),
    "predictions": ("--scenarios four_obstacles --poses 1 --runs 10", {}),
    "promised_success": (
        "",
        {"SCENARIOS": ("four_obstacles",), "ANATOMIES": (), "LABS": ("four_obstacles",), "SEEDS": 1},
    ),
    "quiet_sensor": ("--effect viscous --rate 50 --noise 0.05", {}),
    "real_adaptation": (str(REAL), {"TISSUES": ("phantomC",), "SHARES": (0.5,)}),
    "real_insertions": (str(REAL), {"TISSUES": ("phantomC",)}),
    "recording": ("--seconds 1 --kills 1", {}),
    "roofline": ("", {}),
    "scaling": ("--spacings 4 --time-limit 60", {}),
    "second_generator": ("--out sets --sets 1", {}),
    "space_predictions": ("--spacing 4 --entries 1 --runs 2", {}),
    "space_volumes": ("--volumes 1", {}),
    "third_generator": ("--out sets --sets 1", {}),
    "tip_fibre": ("--seeds 1", {}),
    "tip_filter": ("--seeds 1", {}),
    "trial_scatter": ("--runs 3 --output scatter.md", {"TRIALS": (2,), "RATIOS": (1.0,)}),
    "trials": ("--runs 2 --insertions 1", {}),
}
NEEDS = {"real_adaptation": REAL, "real_insertions": REAL}

# Those that have no short form are imported only.
COMMANDS = sorted(
    file.stem for file in BENCHES.glob("*.py") if '__name__ == "__main__"' in file.read_text(encoding="utf-8")
)


@pytest.fixture(autouse=True)
def on_path(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(BENCHES))


@pytest.mark.study
@pytest.mark.parametrize("name", SHORT)
def test_it_runs(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    if name in NEEDS and not NEEDS[name].exists():
        pytest.skip(f"{NEEDS[name]} is not there: the data are of others")
    words, constants = SHORT[name]
    module = importlib.import_module(name)
    for constant, value in constants.items():
        monkeypatch.setattr(module, constant, value)
    monkeypatch.setattr(sys, "argv", [f"{name}.py", *words.split()])
    monkeypatch.chdir(tmp_path)
    assert module.main() in (None, 0)
    assert capsys.readouterr().out or list(tmp_path.iterdir())


@pytest.mark.slow
@pytest.mark.parametrize("name", COMMANDS)
def test_it_is_imported(name: str) -> None:
    try:
        module = importlib.import_module(name)
    except ModuleNotFoundError as error:
        pytest.skip(f"{error.name} is not installed")
    assert inspect.getdoc(module)
