"""A recording in other formats: what `identify` reads, all channels for MATLAB and pandas, a ROS 2 bag."""

from collections.abc import Callable, Mapping

from needleplan.recording.files import PathLike
from needleplan.recording.mcap.export.ros2 import write_rosbag
from needleplan.recording.mcap.export.tables import write_csv, write_hdf5, write_parquet
from needleplan.recording.mcap.export.trial import trial_of
from needleplan.recording.mcap.recording import Recording

__all__ = ["FORMATS", "trial_of", "write_csv", "write_hdf5", "write_parquet", "write_rosbag"]

FORMATS: Mapping[str, Callable[[Recording, PathLike], tuple[str, ...]]] = {
    "hdf5": write_hdf5,
    "csv": write_csv,
    "parquet": write_parquet,
    "rosbag": write_rosbag,
}
"""The formats by their names; each returns remarks: what was left out, and why."""
