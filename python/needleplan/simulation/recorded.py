"""A simulated run as a recording."""

from __future__ import annotations

from needleplan.recording import EVENT, FORCE, POSE, STAGE, PathLike, Recorder, Session, WhenFull
from needleplan.simulation.run import Run

__all__ = ["record_run"]

_NANO = 1e9


def record_run(run: Run, path: PathLike, *, overwrite: bool = False) -> None:
    """Write all samples of a run, and the phases of its program as events. Raises OutputError.

    The time of day in it is that of writing it, plus the simulated time.
    """
    experiment = run.experiment
    digests = {"experiment": experiment.digest}
    if experiment.scenario is not None:
        digests["scenario"] = experiment.scenario.digest
    session = Session(f"{experiment.title or 'experiment'}, seed {run.seed}", digests, monotonic_ns=0)
    with Recorder(path, session, when_full=WhenFull.WAIT, overwrite=overwrite) as recorder:
        events = recorder.channel("/event", EVENT)
        for phase in run.phases:
            events.put(round(phase.begin_s * _NANO), {"name": "phase", "cause": "program", "text": phase.label})
        for topic, kind, samples in (
            ("/stage", STAGE, run.stage),
            ("/force", FORCE, run.forces),
            ("/pose", POSE, run.poses),
        ):
            channel = recorder.channel(topic, kind)
            for sample in samples:
                channel.put(sample.stamp.received_ns, sample)
