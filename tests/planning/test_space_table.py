"""3D tables: files, look-ups and scenarios."""

from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

import needleplan as npl
from needleplan.anatomy import AnatomyFile
from needleplan.artifacts import digest
from needleplan.errors import ChecksumError, OutputError, PoseError, TableError
from needleplan.planning import SpacePose, SpaceTable, SpaceTask, plan_ahead, plan_space
from needleplan.planning._seal import SEAL_BYTES, seal
from needleplan.planning._space_estimates import are_estimates
from tests.control.space_scenes import box_table

pytestmark = pytest.mark.usefixtures("few_executions")


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("space") / "table.h5"
    box_table().best_entry()
    box_table().write(path)
    return path


def test_a_table_reads_back_and_answers_alike(file: Path) -> None:
    table, again = box_table(), SpaceTable.read(file)
    assert again.digest == table.digest
    assert again.stats == table.stats
    for name in ("values", "policy", "success"):
        assert np.array_equal(getattr(again.solved, name), getattr(table.solved, name))
    start = table.best_entry()
    assert again.best_entry() == start
    assert again.lookup(start) == table.lookup(start)
    assert again.rollout(start, 50, seed=3) == table.rollout(start, 50, seed=3)


@pytest.mark.study
def test_an_estimate_is_what_executions_achieve() -> None:
    table = box_table()
    x, y, z, *_ = table.best_entry().pose
    start = SpacePose(x, y + 8.0, z, 0.917, 0.300, -0.263)
    found = table.estimate(start)
    assert found.interval is not None
    low, high = found.interval
    assert (found.runs, found) == (2000, table.estimate(start, threads=1))
    assert low < found.value < high < low + 0.028
    assert 0.4 < found.value < 0.7
    realised, error = table.rollout(start, 20_000, seed=0).success, (0.25 / 20_000) ** 0.5
    assert abs(found.value - realised) < high - low + 2 * error
    assert found.value != table.estimate(start, seed=1).value
    ahead = plan_ahead(SpaceTask(table.scenario, start)).estimate(start)
    assert ahead.value == pytest.approx(found.value, abs=0.03)
    certain = table.estimate(SpacePose(*table.scenario.target_mm, 1.0, 0.0, 0.0), runs=100)
    assert certain.interval is not None
    assert certain.value == certain.interval[1] == 1.0
    assert 0.95 < certain.interval[0] < 1.0
    with pytest.raises(PoseError):
        table.estimate(start._replace(x_mm=-50.0))


def test_other_programs_read_the_file(file: Path) -> None:
    with h5py.File(file) as content:
        assert content["values"].shape == box_table().shape
        assert AnatomyFile.from_toml(content.attrs["scenario"]) == box_table().scenario.file
        assert content["success"].attrs["units"] == "1/65535"


def test_a_pose_has_one_estimate() -> None:
    rows = np.array([[1.0, 2.0, z, 1.0, 0.0, 0.0, 2000.0, 0.5, 0.4, 0.6] for z in (3.0, 4.0)])
    assert are_estimates(rows)
    other = [*rows[0][:7], 0.6, 0.5, 0.7]
    assert not are_estimates(np.array([*rows, other]))


def test_a_file_has_what_executions_showed_of_its_entries(tmp_path: Path) -> None:
    table, path = SpaceTable(box_table().scenario, box_table().solved), tmp_path / "table.h5"
    best = table.best_entry()
    table.write(path)
    again = SpaceTable.read(path)
    assert np.array_equal(again.estimates.rows(), table.estimates.rows())
    assert len(again.estimates.rows()) >= 1
    assert again.best_entry() == best
    assert len(again.estimates.rows()) == len(table.estimates.rows())  # no entry was executed again
    assert again.estimate(best, runs=table.ranking.runs) == table.estimate(best, runs=table.ranking.runs)
    with h5py.File(path, "r+") as content:
        rows = content["estimates"][()]
        rows[0, 7] = 1.5
        content["estimates"][...] = rows
        content["estimates"].attrs["sha256"] = digest(rows.data)
    body = path.read_bytes()[SEAL_BYTES:]
    path.write_bytes(seal(memoryview(body)) + body)
    with pytest.raises(TableError, match=r"estimates.*success from 0 to 1 in its interval"):
        SpaceTable.read(path)


@pytest.mark.parametrize("place", [SEAL_BYTES + 3000, -5, 40])
def test_a_flipped_bit_is_noticed(file: Path, tmp_path: Path, place: int) -> None:
    data = bytearray(file.read_bytes())
    data[place] ^= 1
    (tmp_path / "flipped.h5").write_bytes(data)
    with pytest.raises((ChecksumError, TableError)):
        SpaceTable.read(tmp_path / "flipped.h5")


def test_a_compressed_file_reads_back_and_is_smaller(file: Path, tmp_path: Path) -> None:
    small = tmp_path / "small.h5"
    box_table().write(small, compressed=True)
    assert small.stat().st_size < 0.6 * file.stat().st_size
    again = SpaceTable.read(small)
    assert again.digest == box_table().digest
    best = box_table().best_entry()
    assert again.lookup(best) == box_table().lookup(best)
    data = bytearray(small.read_bytes())
    data[len(data) // 2] ^= 1
    small.write_bytes(data)
    with pytest.raises(ChecksumError):
        SpaceTable.read(small)


def test_a_truncated_file_is_refused(file: Path, tmp_path: Path) -> None:
    short = tmp_path / "short.h5"
    short.write_bytes(file.read_bytes()[:-1000])
    with pytest.raises(TableError, match="truncated"):
        SpaceTable.read(short)


@pytest.mark.parametrize(
    ("dataset", "value", "message"),
    [
        ("voxels", 7, "from 0 to 3"), ("values", 5.0, "SHA-256"), ("tissues", 3, "numbers of radii_mm"),
        ("target", 2, "SHA-256"), ("estimates", 9.0, "SHA-256"),
        ("target", None, "is missing: an earlier version wrote the file"),
    ],
)  # fmt: skip
def test_a_file_that_was_altered_and_sealed_again_is_refused(
    file: Path, tmp_path: Path, dataset: str, value: float | None, message: str
) -> None:
    path = tmp_path / "resealed.h5"
    path.write_bytes(file.read_bytes())
    with h5py.File(path, "r+") as content:
        if value is None:
            del content[dataset]
        else:
            content[dataset][(0,) * content[dataset].ndim] = value
    body = path.read_bytes()[SEAL_BYTES:]
    path.write_bytes(seal(memoryview(body)) + body)
    with pytest.raises(TableError, match=message):
        SpaceTable.read(path)


def test_a_file_of_the_former_format_opens(file: Path, tmp_path: Path) -> None:
    path = tmp_path / "former.h5"
    path.write_bytes(file.read_bytes())
    with h5py.File(path, "r+") as content:
        content.attrs["anatomy"], content.attrs["axes"] = content.attrs["scenario"], "slice, direction, y, z"
        content["tangents"] = content["direction"]
        for name in ("x_mm", "y_mm", "z_mm", "direction"):
            del content[name]
        del content.attrs["scenario"]
    body = path.read_bytes()[SEAL_BYTES:]
    line = f"needleplan.space-table/2 {len(body)} bytes {digest(body)}\n".encode()
    path.write_bytes(line.ljust(SEAL_BYTES, b"\0") + body)
    assert npl.open(path).digest == SpaceTable.read(file).digest


def test_each_class_reads_its_own_tables(file: Path, table_file: Path) -> None:
    assert type(npl.Table.read(file)) is SpaceTable
    assert type(npl.Table.read(table_file)) is npl.PolicyTable
    with pytest.raises(TableError, match="is a table over x, direction, y, z, and no PolicyTable"):
        npl.PolicyTable.read(file)
    with pytest.raises(TableError, match="is a table over x, y, heading, bevel, and no SpaceTable"):
        SpaceTable.read(table_file)


def test_a_signature_is_verified(tmp_path: Path) -> None:
    path, key = tmp_path / "signed.h5", b"a secret of sixteen bytes"
    box_table().write(path, sign_key=key)
    assert SpaceTable.read(path, verify_key=key).digest == box_table().digest
    with pytest.raises(ChecksumError, match="another key"):
        SpaceTable.read(path, verify_key=b"a different sixteen bytes")


def test_poses_outside_are_refused() -> None:
    table = box_table()
    x, y, z, *_ = table.best_entry().pose
    with pytest.raises(PoseError, match="in the cone"):
        table.lookup(SpacePose(x, y, z, 0.0, 1.0, 0.0))
    with pytest.raises(PoseError, match="in the lattice"):
        table.lookup((x, y + 500, z, 1.0, 0.0, 0.0))
    with pytest.raises(PoseError, match="six finite numbers"):
        table.lookup((x, y, np.nan, 1.0, 0.0, 0.0))


@pytest.mark.parametrize("name", ["lookup", "path", "executions", "rollout", "estimate"])
@pytest.mark.parametrize(
    ("pose", "message"),
    [
        ("abc", "pose = abc: must be six finite numbers"), (None, "pose = None: must be six finite numbers"),
        ([1, 2], "must be six finite numbers"),
        ((0.0, 8.0, 8.0, 2.0, 0.0, 0.0), "must be a tangent of length 1, not 2"),
        ((0.0, 8.0, 8.0, 0.0, 0.0, 0.0), "must be a tangent of length 1, not 0"),
    ],
)  # fmt: skip
def test_what_is_no_pose_is_refused(name: str, pose: Any, message: str) -> None:
    with pytest.raises(PoseError) as caught:
        getattr(box_table(), name)(pose)
    assert message in str(caught.value)


@pytest.mark.parametrize("name", ["executions", "rollout", "estimate"])
@pytest.mark.parametrize(
    ("argument", "value"),
    [
        ("runs", 0), ("runs", -3), ("runs", 10**10), ("runs", 2.5), ("runs", True), ("seed", -1), ("seed", 2**64),
        ("seed", "a"), ("threads", -1), ("threads", 0),
    ],
)  # fmt: skip
def test_runs_seeds_and_threads_are_whole_numbers(name: str, argument: str, value: Any) -> None:
    if argument == "threads" and name != "estimate":
        return
    table = box_table()
    with pytest.raises(PoseError, match=f"{argument} = .*: must be a whole number from"):
        getattr(table, name)(table.best_entry(), **{argument: value})


def test_a_rescaled_scenario_bends_by_the_factor() -> None:
    scenario = box_table(bent=True).scenario
    half = scenario.rescaled(0.5)
    points = np.random.default_rng(1).uniform(0, 40, (20, 3))
    assert np.allclose(half.curvature_per_mm(points), 0.5 * scenario.curvature_per_mm(points))
    assert half.digest != scenario.digest
    assert AnatomyFile.from_toml(half.to_toml()) == half.file
    assert plan_space(half, threads=1).stats.status == "converged"


def test_a_plan_of_the_part_ahead_answers_like_the_whole_plan() -> None:
    table = box_table(bent=True)
    scenario, path = table.scenario, table.path(table.best_entry())
    points = path.points_mm
    for share in (0.2, 0.5, 0.8):
        number = int(share * len(points))
        tangent = points[number + 1] - points[number]
        pose = SpacePose(*points[number].tolist(), *(tangent / np.linalg.norm(tangent)).tolist())
        part = plan_ahead(SpaceTask(scenario, pose), threads=1)
        assert part.stats.states <= table.stats.states
        assert part.lookup(pose) == pytest.approx(table.lookup(pose), abs=1e-3)
        own, whole = part.path(pose).points_mm, table.path(pose).points_mm
        assert np.allclose(own[:-1], whole[: len(own) - 1], atol=1e-9)
        # Rounding decides whether a point on the face of the target is in it.
        assert np.linalg.norm(own[-1] - whole[-1]) < 0.4
        first, second = (each.rollout(pose, 300, seed=2).success for each in (part, table))
        assert first == pytest.approx(second, abs=0.01)
    assert part.stats.states < table.stats.states
    assert not part.contains(table.best_entry().pose)
    with pytest.raises(OutputError, match="whole lattice"):
        part.write("never.h5")


def test_a_tangent_beyond_the_cone_is_turned_to_its_rim() -> None:
    table, cone = box_table(), box_table().scenario.cone_rad
    x, y, z, *_ = table.best_entry().pose
    for angle, around in ((cone + 0.1, 0.3), (cone + 0.05, 4.0)):
        across = np.sin(angle)
        pose = SpacePose(x, y, z, np.cos(angle), across * np.cos(around), across * np.sin(around))
        found = table.clamped(pose)
        assert table.contains(found)
        assert np.dot(found.tangent, pose.tangent) == pytest.approx(np.cos(angle - cone), abs=1e-5)
    assert table.clamped(table.best_entry().pose) == table.best_entry().pose
    assert not table.contains(table.clamped(SpacePose(x, y, z, 0.0, 1.0, 0.0)))
