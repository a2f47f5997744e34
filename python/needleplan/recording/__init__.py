"""Files of measurements: trials in CSV, HDF5 or MATLAB files, and recordings of a run in MCAP files.

- `Recording.read` opens the recording of a run.
- `Recorder` writes a recording without delaying the run.
- `recover` writes the readable messages of an unfinished or damaged recording to a new recording.
- `read_records` and `write_records` read and write trials.
- `align` interpolates one sensor to the times of another.
"""

import needleplan.extras.lab  # noqa: F401  # raises MissingLibraryError
from needleplan.recording._align import align, resampled
from needleplan.recording._column_map import ColumnMap
from needleplan.recording._data_files import PathLike, parse_records, read_records, write_records
from needleplan.recording._journal import Session
from needleplan.recording._message_kinds import Field, Json, MessageKind, Packed
from needleplan.recording._recorder import Recorder, RecordingChannel
from needleplan.recording._recorder_status import RecorderState, RecorderStatus, WhenFull
from needleplan.recording._recording import RecordedMessage, Recording
from needleplan.recording._recovery import Recovery, recover
from needleplan.recording._sample_kinds import EVENT, FIBRE, FORCE, IMAGE, POSE, STAGE, STATUS

__all__ = [
    "EVENT",
    "FIBRE",
    "FORCE",
    "IMAGE",
    "POSE",
    "STAGE",
    "STATUS",
    "ColumnMap",
    "Field",
    "Json",
    "MessageKind",
    "Packed",
    "PathLike",
    "RecordedMessage",
    "Recorder",
    "RecorderState",
    "RecorderStatus",
    "Recording",
    "RecordingChannel",
    "Recovery",
    "Session",
    "WhenFull",
    "align",
    "parse_records",
    "read_records",
    "recover",
    "resampled",
    "write_records",
]
