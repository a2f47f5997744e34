"""`Recording.plot` draws what was recorded, and a recording is shown in one line."""

from pathlib import Path

import numpy as np
import pytest
from matplotlib import pyplot

from needleplan.errors import DataError
from needleplan.recording import EVENT, FORCE, Field, Packed, Recorder, Recording, WhenFull
from tests.recording.samples import SESSION, START_NS, force, write_run


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    return Recording.read(write_run(tmp_path_factory.mktemp("plot") / "run.mcap"))


def test_channels_over_time_and_force_over_depth(recording: Recording) -> None:
    axes = recording.plot()
    assert [each.get_title(loc="left") for each in axes] == ["/stage", "/force", "/tracker", "force over depth"]
    assert [each.get_ylabel() for each in axes] == ["depth (mm)", "force (N)", "position (mm)", "axial force (N)"]
    assert [each.get_xlabel() for each in axes] == ["time (s)"] * 3 + ["depth (mm)"]
    assert axes[0].figure is axes[-1].figure
    assert axes[0].figure.number in pyplot.get_fignums()

    (depth,) = axes[0].lines
    stage = recording.columns("/stage")
    np.testing.assert_array_equal(depth.get_xdata(), stage["time_s"])
    np.testing.assert_array_equal(depth.get_ydata(), stage["depth_mm"])
    assert [line.get_label() for line in axes[1].lines] == ["force_x_n", "force_y_n", "force_z_n"]
    np.testing.assert_allclose(axes[1].lines[2].get_ydata(), recording.columns("/force")["force_z_n"])

    (by_depth,) = axes[-1].lines
    trial = recording.trial()
    np.testing.assert_array_equal(by_depth.get_xdata(), trial["depth_mm"])
    np.testing.assert_array_equal(by_depth.get_ydata(), trial["force_n"])
    np.testing.assert_allclose(np.asarray(by_depth.get_ydata()), 0.1 * np.asarray(by_depth.get_xdata()), atol=1e-9)


def test_only_the_chosen_topics(recording: Recording) -> None:
    (panel,) = recording.plot(["/tracker"])
    assert panel.get_title(loc="left") == "/tracker"
    assert np.asarray(panel.lines[0].get_ydata())[-1] == recording.columns("/tracker")["x_mm"][-1]
    with pytest.raises(DataError, match="must be a topic of packed messages"):
        recording.plot(["/events"])
    with pytest.raises(DataError, match="must be one of /events, /force"):
        recording.plot(["/forces"])
    with pytest.raises(DataError, match="no samples to draw"):
        recording.plot([])


def test_own_kinds_and_a_force_without_depth(tmp_path: Path) -> None:
    tip = Packed("needleplan_msgs/msg/Tip", (Field("x_mm"), Field("count", "int32")))
    with Recorder(tmp_path / "run.mcap", SESSION, when_full=WhenFull.WAIT) as recorder:
        channel, forces = recorder.channel("/tip", tip), recorder.channel("/force", FORCE)
        for number in range(5):
            channel.put(START_NS + number, {"x_mm": 2.0 * number, "count": number})
            forces.put(START_NS + number, force(number, START_NS + number))
        recorder.channel("/event", EVENT).put(START_NS, {"name": "begin"})
    recording = Recording.read(tmp_path / "run.mcap")
    tips, only = recording.plot(["/tip", "/force"])
    (line,) = tips.lines
    assert (tips.get_ylabel(), list(line.get_ydata())) == ("x_mm", [0.0, 2.0, 4.0, 6.0, 8.0])
    assert only.get_xlabel() == "time (s)"


def test_a_recording_is_shown_in_one_line(recording: Recording) -> None:
    assert repr(recording) == "<Recording run.mcap: 5 topics, 2,484 messages, 1.999 s>"
