"""`plan`, `entry` and `insert` print the promise under what options and files say of errors."""

import json
from pathlib import Path

import pytest

import needleplan as npl
from needleplan.estimation.registration import register
from needleplan.planning import Uncertainty
from tests.cli.commands import needleplan, refused
from tests.conftest import SMALL
from tests.estimation.registrations import PLAN, tracker_points

OPTIONS = ("--entry-sd-mm", "1", "--heading-sd-deg", "2", "--tre-mm", "1.5", "--curvature-ratio", "0.9,1.1")
GIVEN = Uncertainty(entry_sd_mm=1.0, heading_sd_deg=2.0, tre_mm=1.5, curvature_ratio=(0.9, 1.1))


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory, table: npl.PolicyTable) -> Path:
    path = tmp_path_factory.mktemp("promise")
    (path / "small.toml").write_text(SMALL)
    table.write(path / "table.h5")
    return path / "table.h5"


def registration(folder: Path, noise_mm: float) -> Path:
    """Write an accepted registration whose points have this noise."""
    from needleplan.estimation import Registration

    tracker = tracker_points(noise_mm=noise_mm)
    made = register(tracker, PLAN)
    file = Registration(
        quaternion=tuple(made.rotation.as_quat(scalar_first=True)), translation_mm=tuple(made.translation_mm),
        points=tuple((tuple(a), tuple(b)) for a, b in zip(tracker.tolist(), PLAN.tolist(), strict=True)),
    ).accepted("a test")  # fmt: skip
    file.write(folder / "registration.toml")
    return folder / "registration.toml"


def test_plan_entry_and_python_promise_the_same(file: Path, table: npl.PolicyTable) -> None:
    promise = table.success_under(GIVEN, table.best_entry())
    wanted = json.loads(json.dumps(promise.record()))
    assert json.loads(needleplan("entry", file, *OPTIONS, "--json").stdout)["promise"] == wanted
    planned = needleplan("plan", file.parent / "small.toml", *OPTIONS, "--json")
    assert json.loads(planned.stdout)["promise"] == wanted
    shown = needleplan("entry", file, *OPTIONS).stdout
    names = ("as planned", "entry", "registration", "curvature", "promise")
    for name, part in zip(names, promise.parts().values(), strict=True):
        assert f"{name:<12} {part}\n" in shown
    assert "promise" not in json.loads(needleplan("entry", file, "--json").stdout)


def test_the_points_of_a_registration_say_its_error(file: Path, tmp_path: Path, table: npl.PolicyTable) -> None:
    made = registration(tmp_path, 1.5)
    found = json.loads(needleplan("entry", file, "--registration", made, "--json").stdout)["promise"]
    error = npl.open(made).error
    wanted = table.success_under(Uncertainty(registration=error, coil_mm=0.0), table.best_entry())
    assert found == json.loads(json.dumps(wanted.record()))
    assert found["registration"]["success"] < found["exact"]["success"]
    refused(needleplan("entry", file, "--registration", made, "--tre-mm", "1"), "--tre-mm", "left out")


def test_insert_promises_before_anything_moves(file: Path, tmp_path: Path) -> None:
    made = registration(tmp_path, 0.5)
    done = needleplan("insert", file, "--registration", made, "--curvature-ratio", "0.8,1.2", "--json")
    promise = json.loads(done.stdout)["promise"]
    assert list(promise) == ["exact", "registration", "curvature", "tip", "together", "uncertainty"]
    first = next(line for line in done.stderr.splitlines() if not line.startswith("warning"))
    assert first.startswith("as planned: ")


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--tre-mm", "-1"), ("--tre-mm", "at least 0")),
        (("--curvature-ratio", "1.2,0.8"), ("--curvature-ratio", "lower end first")),
        (("--curvature-ratio", "1.2"), ("--curvature-ratio", "2")),
        (("--entry-sd-mm", "1e9"), ("--entry-sd-mm", "at most 50")),
        (("--registration", "nowhere.toml"), ("nowhere.toml",)),
    ],
)
def test_wrong_errors_are_refused(file: Path, options: tuple[str, ...], words: tuple[str, ...]) -> None:
    refused(needleplan("entry", file, *options), *words)
