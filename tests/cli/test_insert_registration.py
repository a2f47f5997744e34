"""`needleplan insert --registration`: the file has a verdict, and its error at the target fits to the target."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from needleplan.cli import main
from needleplan.cli.insert import read_judged
from needleplan.errors import DataError
from needleplan.estimation.registration import Registration, RegistrationVerdict, VerdictStatus, register
from tests.control.scenes import small_table
from tests.estimation.registrations import known

TARGET = (60.0, 22.0, 0.0)


def far_points() -> Registration:
    """Return a passed registration of four points with errors of 1 mm, 500 mm from the target."""
    plan = np.array([[0, 0, 0], [30, 0, 0], [0, 30, 0], [0, 0, 30.0]]) + TARGET + np.array([0, 0, 500.0])
    tracker = plan + np.random.default_rng(0).normal(0, 0.6, plan.shape)
    motion = register(tracker, plan)
    x, y, z, w = motion.rotation.as_quat().tolist()
    tx, ty, tz = motion.translation_mm.tolist()
    pairs = tuple(
        ((ax, ay, az), (bx, by, bz)) for (ax, ay, az), (bx, by, bz) in zip(tracker.tolist(), plan.tolist(), strict=True)
    )
    return Registration((w, x, y, z), (tx, ty, tz), points=pairs, verdict=RegistrationVerdict(VerdictStatus.PASSED))


@pytest.mark.parametrize(
    ("registration", "words"),
    [
        (Registration(), ['verdict.status = "none": must be "passed" or "accepted" for real', "needleplan register"]),
        (replace(known(), verdict=RegistrationVerdict(VerdictStatus.REFUSED)), ['verdict.status = "refused"']),
        (far_points(), ["error at the target (TRE)", "at most the radius of the target"]),
    ],
    ids=["not judged", "refused", "far points"],
)
def test_what_is_refused(
    registration: Registration, words: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    small_table().write(tmp_path / "table.h5")
    registration.write(tmp_path / "needle.toml")
    assert main(["insert", str(tmp_path / "table.h5"), "--registration", str(tmp_path / "needle.toml")]) == 2
    said = capsys.readouterr().err
    assert "needle.toml" in said
    for word in words:
        assert word in said


@pytest.mark.parametrize(
    ("registration", "share", "says"),
    [
        (far_points(), 0.4, ""),
        (far_points(), 0.7, "exceeds half its radius"),
        (known(), 0.0, "its error at the target (TRE) is unknown"),
        (known(), 0.0, "the registration was accepted: a simulated tracker"),
    ],
)
def test_remarks_before_an_insertion(
    registration: Registration, share: float, says: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    radius = registration.tre_mm(TARGET) / share if share else 2.0
    plan = SimpleNamespace(target_in_registration_mm=TARGET, target_radius_mm=radius)
    registration.write(tmp_path / "needle.toml")
    assert read_judged(str(tmp_path / "needle.toml"), plan) == registration  # type: ignore[arg-type]
    said = capsys.readouterr().err
    assert says in said if says else not said


@pytest.mark.parametrize(("old", "new"), [('accepted = "a simulated tracker"\n', ""), ('"accepted"', '"passed"')])
def test_an_accepted_registration_has_a_reason(old: str, new: str, tmp_path: Path) -> None:
    file = tmp_path / "needle.toml"
    file.write_text(known().to_toml().replace(old, new))
    with pytest.raises(DataError, match=r"verdict.accepted = .*must be the reason of the person"):
        Registration.read(file)
