"""Running simulations: the samples of all devices, as a record for identification and as a recording file."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from needleplan.artifacts import ShortRepr
from needleplan.devices import FibreSample, ForceSample, ImageSample, PoseSample, StageSample
from needleplan.errors import OutputError
from needleplan.models import TipFrame
from needleplan.recording import EVENT, FIBRE, FORCE, IMAGE, POSE, STAGE, Packed, PathLike, Recorder, Session, WhenFull
from needleplan.signals import IMAGE_COLUMNS, Array, FrameName, Record, RecordFrame
from needleplan.simulation._lab import Lab
from needleplan.simulation._setup import AVERAGED, FORCE_HZ, Move
from needleplan.simulation._simulation import Simulation

__all__ = ["Run", "RunPhase", "record_run", "run_simulation"]

# Frame of the records: the tracker of the lab measures in the frame of the plan.
_FRAME = RecordFrame(FrameName.PLAN, "plan", "lab twin")
# simulated time (s) between two readings of the devices; must be shorter than the time for which they keep samples
_AT_ONCE_S = 0.25
_NANO = 1e9
# time (s) that is recorded after the last move
_SETTLING_S = 0.25


@dataclass(frozen=True)
class RunPhase:
    """One move of the program, with the simulated time (s) at which it begins."""

    begin_s: float
    label: str


@dataclass(frozen=True)
class Run(ShortRepr):
    """Result of a simulation: all samples of the devices, phases of the program, and true final tip frame."""

    simulation: Simulation
    seed: int
    stage: tuple[StageSample, ...]
    forces: tuple[ForceSample, ...]
    poses: tuple[PoseSample, ...]
    phases: tuple[RunPhase, ...]
    tip: TipFrame
    fibre: tuple[FibreSample, ...] = ()
    images: tuple[ImageSample, ...] = ()

    def record(self, trial: str = "") -> Record:
        """Return the run as a record at the rate of the force sensor.

        Depth and angle are the encoder values at the times of the force samples. The columns x, y and z contain the
        positions of the tracker frames, those of the sensors
        along the needle their curvatures, those of the images the detected positions at the times of their arrival, and
        NaN between the frames. Force and torque are shifted by two samples,
        which compensates the delay of the sensor's moving average; their last two values are NaN.
        """
        time = np.array([each.stamp.device_time_s for each in self.forces], float)
        every = len(self.stage) // len(self.forces)
        stage = self.stage[every - 1 :: every][: time.size]
        delay = (AVERAGED - 1) // 2
        force, torque = (np.full(time.size, np.nan) for _ in range(2))
        force[:-delay] = [each.force_n[2] for each in self.forces[delay:]]
        torque[:-delay] = [each.torque_n_mm[2] for each in self.forces[delay:]]
        columns: dict[str, Array] = {
            "time_s": time,
            "depth_mm": np.array([each.depth_mm for each in stage]),
            "force_n": force,
            "torque_n_mm": torque,
            "angle_rad": np.array([each.roll_rad for each in stage]),
        }
        rows = [round((pose.stamp.device_time_s or 0.0) * FORCE_HZ) - 1 for pose in self.poses]
        for axis, name in enumerate(("x_mm", "y_mm", "z_mm")):
            columns[name] = np.full(time.size, np.nan)
            columns[name][rows] = [pose.position_mm[axis] for pose in self.poses]
        rows = [round((each.stamp.device_time_s or 0.0) * FORCE_HZ) - 1 for each in self.fibre]
        sensors = self.simulation.setup.fibre
        for number, name in enumerate(sensors.columns if sensors else ()):
            columns[name] = np.full(time.size, np.nan)
            columns[name][rows] = [each.curvatures_per_mm[number // 2][number % 2] for each in self.fibre]
        images = [each for each in self.images if each.stamp.received_ns <= self.forces[-1].stamp.received_ns]
        rows = [round((each.stamp.device_time_s or 0.0) * FORCE_HZ) - 1 for each in images]
        for name, field in zip(IMAGE_COLUMNS, ("u_mm", "v_mm"), strict=True):
            if self.simulation.setup.ultrasound:
                columns[name] = np.full(time.size, np.nan)
                columns[name][rows] = [getattr(each, field) for each in images]
        begins = [each.begin_s for each in self.phases]
        phase = tuple(self.phases[bisect_left(begins, now) - 1].label for now in time.tolist())
        return Record(columns, trial or f"seed {self.seed}", phase=phase, digest=self.simulation.digest, frame=_FRAME)


def run_simulation(simulation: Simulation, seed: int | None = None) -> Run:
    """Run the program of a simulation in a new lab.

    Parameters
    ----------
    simulation : Simulation
        Simulation with its program and its lab.
    seed : int, optional
        Seed of the noise. Default: the seed of the simulation.

    Returns
    -------
    Run
    """
    chosen = simulation.seed if seed is None else seed
    stage: list[StageSample] = []
    forces: list[ForceSample] = []
    poses: list[PoseSample] = []
    fibre: list[FibreSample] = []
    images: list[ImageSample] = []
    phases: list[RunPhase] = []
    with Lab(simulation.setup, chosen) as lab:

        def pass_time(seconds: float) -> None:
            left = seconds
            while left > 0:
                lab.advance(min(left, _AT_ONCE_S))
                left -= _AT_ONCE_S
                _drain(lab, stage, forces, poses)
                fibre.extend(lab.fibre.waiting())
                images.extend(lab.ultrasound.waiting())

        for move in simulation.moves:
            phases.append(RunPhase(lab.plant.now_s, move.label))
            pass_time(_begin(lab, move))
        pass_time(_SETTLING_S)
        tip = lab.plant.tip()
    return Run(
        simulation, chosen, tuple(stage), tuple(forces), tuple(poses), tuple(phases), tip, tuple(fibre), tuple(images)
    )


def _begin(lab: Lab, move: Move) -> float:
    """Begin a move and return its duration (s), rounded up to a whole number of ticks."""
    if move.insert_to_mm is not None:
        lab.stage.insert(move.insert_to_mm, move.velocity_mm_s or 0.0)
    elif move.rotate_to_rad is not None:
        lab.stage.rotate(move.rotate_to_rad, move.velocity_rad_s or 0.0)
    else:
        return move.dwell_s or 0.0
    plant = lab.plant
    end_s = max(plant.insertion.end_s, plant.roll.end_s)
    return float(np.ceil((end_s - plant.now_s) / plant.interval_s - 1e-6)) * plant.interval_s


def _drain(lab: Lab, stage: list[StageSample], forces: list[ForceSample], poses: list[PoseSample]) -> None:
    stage += lab.stage.waiting()
    forces += lab.force_sensor.waiting()
    poses += lab.tracker.waiting()


def record_run(run: Run, path: PathLike, *, overwrite: bool = False) -> None:
    """Write a recording with all samples of a run, and with the phases of its program as events.

    The recorded time of day is the time of writing plus the simulated time.

    Parameters
    ----------
    run : Run
        Run, as `run_simulation` returns it.
    path : str or path
        Path of the recording.
    overwrite : bool, default False
        Whether to replace an existing file.

    Raises
    ------
    OutputError
        The file cannot be written completely, or exists and `overwrite` is false.
    """
    simulation = run.simulation
    digests = {"simulation": simulation.digest}
    if simulation.scenario is not None:
        digests["scenario"] = simulation.scenario.digest
    session = Session(f"{simulation.title or 'simulation'}, seed {run.seed}", digests, monotonic_ns=0)
    with Recorder(path, session, when_full=WhenFull.WAIT, overwrite=overwrite) as recorder:
        events = recorder.channel("/event", EVENT)
        for phase in run.phases:
            events.put(round(phase.begin_s * _NANO), {"name": "phase", "cause": "program", "text": phase.label})
        topics: list[tuple[str, Packed, Sequence[Any]]] = [
            ("/stage", STAGE, run.stage),
            ("/force", FORCE, run.forces),
            ("/pose", POSE, run.poses),
            ("/fibre", FIBRE, run.fibre),
            ("/image", IMAGE, run.images),
        ]
        for topic, kind, samples in topics:
            if not samples:
                continue
            channel = recorder.channel(topic, kind)
            for sample in samples:
                channel.put(sample.stamp.received_ns, sample)
    if not recorder.status.ok:
        rule = f"the recording is incomplete: {recorder.status.missing}"
        raise OutputError(rule, str(recorder.file or recorder.partial))
