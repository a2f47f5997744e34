"""A recording in other formats says the same as the recording."""

import json
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest

from needleplan.devices import Health
from needleplan.errors import DataError, OutputError
from needleplan.recording import EVENT, FORCE, POSE, Recorder, Recording, read_records
from needleplan.recording.export import FORMATS
from tests.recording.samples import SESSION, START_NS, force, pose, write_run


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    return Recording.read(write_run(tmp_path_factory.mktemp("run") / "run.mcap"))


@pytest.mark.parametrize(("name", "file"), [("hdf5", "run.h5"), ("csv", "run.csv")])
def test_identify_reads_it(run: Recording, name: str, file: str, tmp_path: Path) -> None:
    FORMATS[name](run, tmp_path / file)
    (record,) = read_records(tmp_path / file)
    assert record.trial == "run"
    assert len(record) == 396  # 200 Hz, as far as the tracker goes
    np.testing.assert_allclose(record["time_s"], np.arange(396) / 200, atol=1e-12)
    np.testing.assert_allclose(record["depth_mm"], 5 * record["time_s"], atol=1e-9)
    np.testing.assert_allclose(record["force_n"], 0.1 * record["depth_mm"], atol=1e-12)
    np.testing.assert_allclose(record["x_mm"], record["depth_mm"], atol=1e-9)
    np.testing.assert_allclose(record["torque_n_mm"], -3.0)
    np.testing.assert_allclose(record["angle_rad"], 0.25)


def test_hdf5_has_all_channels_as_recorded(run: Recording, tmp_path: Path) -> None:
    FORMATS["hdf5"](run, tmp_path / "run.h5")
    with h5py.File(tmp_path / "run.h5") as file:
        channels = file["trial_0001/channels"]
        assert channels["stage/depth_mm"].shape == (2000,)
        assert channels["force/force_z_n"][10] == -0.1 * 0.25
        assert channels["tracker/notes"].asstr()[0] == "a; b"
        assert json.loads(channels["events/json"].asstr()[1]) == {"name": "end", "cause": "depth", "value": None}
        assert file.attrs["recording"].startswith("sha256:")


def test_parquet(run: Recording, tmp_path: Path) -> None:
    parquet = pytest.importorskip("pyarrow.parquet", reason="pyarrow is not installed")
    FORMATS["parquet"](run, tmp_path / "run")
    table = parquet.read_table(tmp_path / "run" / "stage.parquet")
    assert table.num_rows == 2000
    assert table["depth_mm"][1999].as_py() == 0.005 * 1999
    assert table["sequence"][7].as_py() == 7
    assert {each.stem for each in (tmp_path / "run").iterdir()} == {each.strip("/") for each in run.counts}
    with pytest.raises(OutputError, match="is there already"):
        FORMATS["parquet"](run, tmp_path / "run")
    (tmp_path / "run" / "stage.parquet").write_bytes(b"")
    (tmp_path / "run" / "other").write_text("kept")
    FORMATS["parquet"](run, tmp_path / "run", overwrite=True)
    assert parquet.read_table(tmp_path / "run" / "stage.parquet").num_rows == 2000
    assert (tmp_path / "run" / "other").read_text() == "kept"
    assert [each.name for each in tmp_path.iterdir()] == ["run"]


def test_ros_bag(run: Recording, tmp_path: Path) -> None:
    pytest.importorskip("rosbags", reason="rosbags is not installed")
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    FORMATS["rosbag"](run, tmp_path / "bag")
    with AnyReader([tmp_path / "bag"], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
        found = {
            each.topic: [(time_ns, reader.deserialize(raw, each.msgtype)) for each, time_ns, raw in
                         reader.messages([each])] for each in reader.connections
        }  # fmt: skip
    assert {topic: len(messages) for topic, messages in found.items()} == dict(run.counts)
    time_ns, wrench = found["/force"][10]
    assert time_ns == SESSION.wall_ns + 50_000_000
    assert (wrench.header.stamp.sec, wrench.header.stamp.nanosec) == (SESSION.wall_ns // 10**9, 50_000_000)
    assert (wrench.wrench.force.z, wrench.wrench.torque.y) == (-0.1 * 0.25, 0.002)
    _, tracked = found["/tracker"][40]
    assert (tracked.pose.position.x, tracked.pose.orientation.w) == (pytest.approx(0.005), 1.0)
    _, joints = found["/stage"][1000]
    assert (joints.name, joints.position[0], joints.velocity[0]) == (["insertion", "roll"], 0.005, 0.005)
    assert found["/events"][0][1].name == "start"
    (_, end) = found["/events"][1]
    assert (end.name, end.cause, end.numbers[0].key) == ("end", "depth", "value")
    assert np.isnan(end.numbers[0].value)


@pytest.mark.parametrize(("name", "module"), [("parquet", "pyarrow"), ("rosbag", "rosbags.rosbag2")])
def test_a_missing_library_is_named(
    run: Recording, name: str, module: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(OutputError, match=r"pip install needleplan\[export\]"):
        FORMATS[name](run, tmp_path / "out")
    assert not list(tmp_path.iterdir())


def test_samples_that_are_not_good_are_missing_and_counted(tmp_path: Path) -> None:
    with Recorder(tmp_path / "run.mcap", SESSION) as recorder:
        tracker = recorder.channel("/tracker", POSE)
        for number in range(20):
            health = Health.SUSPECT if number == 5 else Health.GOOD
            time_ns = START_NS + 25_000_000 * (number - (number == 9))  # one comes with the time of the one before
            tracker.put(time_ns, pose(number, time_ns, float(number), health))
    trial = Recording.read(tmp_path / "run.mcap").trial()
    assert np.flatnonzero(np.isnan(trial["x_mm"])).tolist() == [5]
    assert len(trial) == 19
    assert "/tracker: samples that are not good became missing numbers: 1" in trial.notes
    assert "/tracker: 1 samples with repeated or decreasing time were left out" in trial.notes


def test_a_recording_without_samples_has_no_trial(tmp_path: Path) -> None:
    with Recorder(tmp_path / "run.mcap", SESSION) as recorder:
        recorder.channel("/events", EVENT).put(START_NS, {"name": "alone"})
        recorder.channel("/force", FORCE).put(START_NS, force(1))
    with pytest.raises(DataError, match="holds no samples"):
        FORMATS["csv"](Recording.read(tmp_path / "run.mcap"), tmp_path / "run.csv")
