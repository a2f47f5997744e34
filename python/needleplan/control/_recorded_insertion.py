"""The samples of a recorded insertion by a 3D table, for identification and diagnosis."""

from __future__ import annotations

from typing import TYPE_CHECKING

from needleplan.control._options import RunSetup
from needleplan.control._replay import recorded_samples
from needleplan.devices import PoseSample, StageSample
from needleplan.errors import DataError, Mistake
from needleplan.identification.space_curvature import SpaceInsertion
from needleplan.recording import Recording

if TYPE_CHECKING:
    from needleplan.anatomy import SpaceScenario

__all__ = ["recorded_coil_mm", "recorded_insertion"]


def recorded_coil_mm(recording: Recording) -> float | None:
    """Return the distance of the coil behind the tip in a recorded insertion.

    Parameters
    ----------
    recording : Recording
        The recording.

    Returns
    -------
    float or None
        Distance (mm); None for a recording without a registration.

    Raises
    ------
    DataError
        If the registration in the recording is invalid.
    """
    texts = recording.session.texts
    if "registration.toml" not in texts:
        return None
    return RunSetup.from_texts(texts, str(recording.path)).registration.coil_offset_mm


def recorded_insertion(file: str, scenario: SpaceScenario) -> SpaceInsertion:
    """Read the samples of stage and tracker of a recorded insertion, its registration and its zeros.

    Parameters
    ----------
    file : str
        The recording (.mcap).
    scenario : SpaceScenario
        What the insertion was planned for.

    Returns
    -------
    SpaceInsertion

    Raises
    ------
    DataError
        If the file cannot be read, is not the recording of an insertion, or the insertion was by the plan of another
        lattice.
    """
    recording = Recording.read(file)
    setup = RunSetup.from_texts(recording.session.texts, file)
    if recording.session.texts.get("frame.json") != scenario.grid.frame.to_json():
        rule = "must be that of this anatomy: the insertion was by another plan, or the lattice has changed since"
        raise DataError(Mistake("frame.json", "", rule), file)
    samples = [sample for _, sample in recorded_samples(recording) if isinstance(sample, StageSample | PoseSample)]
    zeros = setup.options.entry_depth_mm, setup.options.roll_left_rad
    return SpaceInsertion(file, samples, setup.registration, setup.tip_settings, *zeros)
