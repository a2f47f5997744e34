"""`needleplan register` as a user runs it."""

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from needleplan.errors import DataError, InputError
from needleplan.estimation import Registration
from needleplan.estimation.registration import RefusalReason, VerdictStatus, read_points, read_poses, register_tracker
from tests.cli.commands import needleplan, program, refused
from tests.estimation.registrations import (
    NOISE,
    OFFSET_MM,
    PLAN,
    SHIFT_MM,
    TURNED,
    tracker_points,
    write,
    write_points,
    write_poses,
)

NOISY = ("--noise-mm", "0.35")


@pytest.mark.slow
def test_a_needle_is_registered(tmp_path: Path) -> None:
    poses, points = write_poses(tmp_path / "poses.csv"), write_points(tmp_path / "points.csv")
    out = tmp_path / "needle.toml"
    done = program("register", "--pivot", poses, "--points", points, "-o", out, "--target", "100,50", "--json", *NOISY)
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    assert told["verdict"] == {
        "status": "passed", "noise_mm": 0.35, "noise_source": "declared", "accepted": "", "reasons": [],
    }  # fmt: skip
    found = Registration.read(out)
    assert found.verdict.status is VerdictStatus.PASSED
    assert told["digest"] == found.digest
    assert found.coil_offset_mm == pytest.approx(OFFSET_MM, abs=4 * found.coil_offset_sd_mm)
    assert told["pivot"]["interval_mm"][0] < found.coil_offset_mm < told["pivot"]["interval_mm"][1]
    assert found.coil_axis == 1
    # What the tracker sees at the tip of a needle along +x of the plan is there in the plan.
    place = TURNED.inv().apply(np.array([50.0, 20.0, 0.0]) - SHIFT_MM)
    x, y, z, w = TURNED.inv().as_quat().tolist()
    coil = found.place(tuple(place.tolist()), (w, x, y, z))
    np.testing.assert_allclose(coil.position_mm, [50, 20, 0], atol=0.5)
    np.testing.assert_allclose(coil.direction, [0, 0, 1], atol=0.01)
    assert told["points"]["fre_mm"] == pytest.approx(found.fre_mm)
    assert 0.05 < told["tre_mm"] < 0.5
    plain = needleplan("register", "--pivot", poses, "--points", points, "--target", "100,50", *NOISY)
    assert "its axis points to the tip" in plain.stdout
    assert "TRE" in plain.stdout
    assert "passed; noise of the tracker 0.35 mm, declared" in plain.stdout


def test_an_axis_that_points_backwards_is_turned_round(tmp_path: Path) -> None:
    points = write_points(tmp_path / "points.csv")
    done = register_tracker(write_poses(tmp_path / "poses.csv", sign=-1.0), points, noise=NOISE)
    assert done.registration
    assert done.registration.coil_axis == -1
    assert done.registration.coil_offset_mm == pytest.approx(OFFSET_MM, abs=0.3)


def test_points_touched_with_the_needle_itself(tmp_path: Path) -> None:
    poses = write_poses(tmp_path / "poses.csv")
    random = np.random.default_rng(3)
    tip = tracker_points(noise_mm=0.0)
    axes = random.normal(size=tip.shape)
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    # The shortest rotation of z to an axis.
    quaternions = np.column_stack([1 + axes[:, 2], -axes[:, 1], axes[:, 0], np.zeros(len(axes))])
    quaternions /= np.linalg.norm(quaternions, axis=1, keepdims=True)
    header = "tracker_x_mm,tracker_y_mm,tracker_z_mm,plan_x_mm,plan_y_mm,plan_z_mm,qw,qx,qy,qz"
    rows = np.column_stack([tip - OFFSET_MM * axes, PLAN, quaternions]).tolist()
    done = register_tracker(poses, write(tmp_path / "points.csv", header, rows), noise=NOISE)
    assert done.motion
    assert done.motion.fre_mm < 0.1
    assert done.names[0] == "line 2"


def test_a_needle_that_was_not_turned_is_no_registration(tmp_path: Path) -> None:
    poses, points = write_poses(tmp_path / "poses.csv", degrees=3.0), write_points(tmp_path / "points.csv")
    done = needleplan("register", "--pivot", poses, "--points", points, "-o", tmp_path / "out.toml", "--json")
    assert done.returncode == 1
    assert "too little rotation" in done.stderr
    assert json.loads(done.stdout)["pivot"]["offset_mm"] is None
    assert not (tmp_path / "out.toml").exists()
    assert needleplan("register", "--pivot", poses, "--points", points).returncode == 1


def test_a_refused_registration_is_not_written_unless_a_person_accepts_it(tmp_path: Path) -> None:
    poses = write_poses(tmp_path / "poses.csv")
    moved = tracker_points()
    moved[2] += 8.0
    points, out = write_points(tmp_path / "points.csv", moved), tmp_path / "out.toml"
    command = ("register", "--pivot", poses, "--points", points, "-o", out)
    done = needleplan(*command, *NOISY, "--json")
    assert done.returncode == 1
    assert "refused" in done.stderr
    assert "residual: that of the points (FLE) is" in done.stderr
    assert json.loads(done.stdout)["verdict"]["status"] == "refused"
    assert not out.exists()
    unknown = needleplan(*command)
    assert unknown.returncode == 1
    assert "noise unknown" in unknown.stderr
    assert not out.exists()
    done = needleplan(*command, *NOISY, "--accept", "a test of the file")
    assert done.returncode == 0
    assert "accepted in spite of residual" in done.stderr
    verdict = Registration.read(out).verdict
    assert (verdict.status, verdict.accepted) == (VerdictStatus.ACCEPTED, "a test of the file")
    assert len(verdict.reasons) == 1


def test_a_pivot_alone_is_calibrated_with_the_noise_at_rest(tmp_path: Path) -> None:
    poses = write_poses(tmp_path / "poses.csv")
    random = np.random.default_rng(5)
    rows = np.column_stack([random.normal(0, 0.2, (50, 3)), np.tile([0.0, 0, 0, 1], (50, 1))]).tolist()
    rest = write(tmp_path / "rest.csv", "x_mm,y_mm,z_mm,qx,qy,qz,qw", rows)
    done = needleplan("calibrate", poses, "--rest", rest, "--json")
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    assert told["pivot"]["offset_mm"] == pytest.approx(OFFSET_MM, abs=0.3)
    assert told["verdict"]["noise_source"] == "measured at rest, 50 poses"
    plain = needleplan("calibrate", poses, "--noise-mm", "0.02")
    assert plain.returncode == 1
    assert "times the noise of the tracker (0.02 mm, declared)" in plain.stderr
    assert "verdict      refused" in plain.stdout
    refused(needleplan("calibrate", "none.csv", "--noise-mm", "1"), "none.csv", "cannot be read")


def test_bad_points_are_named(tmp_path: Path) -> None:
    poses = write_poses(tmp_path / "poses.csv")
    tracker = tracker_points(plan := np.vstack([PLAN, [[30, 60, 20]]]))
    slipped = tracker.copy()
    slipped[2] += 8.0
    done = register_tracker(poses, write_points(tmp_path / "points.csv", slipped, plan))
    assert done.outlier
    assert done.outlier.distance_mm == pytest.approx(8 * 3**0.5, abs=1.5)
    assert any(each.startswith("P3 is ") for each in done.remarks)
    done = register_tracker(poses, write_points(tmp_path / "points.csv", tracker * (1, 1, -1), plan))
    assert RefusalReason.HANDEDNESS in {refusal.reason for refusal in done.refusals}
    line = np.outer(np.arange(4.0), [10, 20, 5])
    with pytest.raises(DataError, match="points of the plan = 4 points: must not lie on one line") as caught:
        register_tracker(poses, write_points(tmp_path / "line.csv", tracker_points(line), line))
    assert caught.value.source.endswith("line.csv")
    with pytest.raises(DataError, match="points of the tracker = 4 points: must not lie in one place"):
        register_tracker(poses, write_points(tmp_path / "line.csv", np.ones((4, 3)), PLAN[:4]))
    with pytest.raises(DataError, match="points of the tracker = 2 points: must be at least 3"):
        register_tracker(poses, write_points(tmp_path / "two.csv", tracker_points(PLAN[:2]), PLAN[:2]))


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("x_mm,", "x,", "column x_mm: is not in the file"),
        ("x_mm,y_mm", "x_mm,x_mm,y_mm", "column x_mm: is ambiguous"),
        ("\n", "\n1,2\n", "line 2: has 2 cells, but column 7 is needed"),
        ("\n", "\n1,2,3,0,0,0,2\n", "qw to qz (line 2) = length 2: must be a quaternion of length 1"),
        ("\n", "\n1,2,3,0,0,0,1e200\n", "qw to qz (line 2) = length inf: must be a quaternion of length 1"),
        ("\n", "\n1,2,,0,0,0,1\n", "line 2: must have all seven numbers, or none"),
        ("\n", "\n1,2,1e9,0,0,0,1\n", "z_mm (line 2) = 1e+09: must be at most 100000 mm"),
    ],
)
def test_mistakes_in_poses_are_named(old: str, new: str, says: str, tmp_path: Path) -> None:
    poses, points = write_poses(tmp_path / "poses.csv", poses=20), write_points(tmp_path / "points.csv")
    poses.write_text(poses.read_text().replace(old, new, 1))
    with pytest.raises(DataError) as caught:
        register_tracker(poses, points)
    assert says in str(caught.value)


def test_wrong_input_is_refused(tmp_path: Path) -> None:
    poses, points = write_poses(tmp_path / "poses.csv"), write_points(tmp_path / "points.csv")
    refused(needleplan("register", "--pivot", "none.csv", "--points", points), "none.csv", "cannot be read")
    refused(needleplan("register", "--pivot", poses, "--points", points, "--target", "1"), "must be X,Y or X,Y,Z")
    refused(needleplan("register", "--pivot", poses, "--points", points, "-o", points), "would replace")
    refused(
        needleplan("register", "--pivot", poses, "--points", points, "--noise-mm", "0"),
        "finite number in mm above 0",
    )
    refused(needleplan("register", "--pivot", poses, "--points", points, "--accept", " "), "must be a reason")
    refused(needleplan("register", "--pivot", poses, "--points", points, "--columns", "w=1"), 'did you mean "qw"')


def test_unseen_frames_are_left_out(tmp_path: Path) -> None:
    poses = write_poses(tmp_path / "poses.csv", poses=30)
    poses.write_text(poses.read_text() + ",,,,,,\nnan,nan,nan,nan,nan,nan,nan\n")
    assert read_poses(poses).missing == 2


@settings(max_examples=60, deadline=None)
@given(st.text(alphabet="0123456789.,;-+eEnaqwxyz_m\n\"' #", max_size=120), st.integers(0, 300))
def test_any_text_is_read_or_refused(tmp_path_factory: pytest.TempPathFactory, text: str, place: int) -> None:
    folder = tmp_path_factory.getbasetemp()
    for name, written, read in (("p", write_poses, read_poses), ("q", write_points, read_points)):
        file = folder / f"fuzzed_{name}.csv"
        if name == "p":
            write_poses(file, poses=10)
        else:
            written(file)
        whole = file.read_text()
        file.write_text(whole[:place] + text + whole[place:])
        try:
            read(file)
        except InputError as error:
            assert str(error)
