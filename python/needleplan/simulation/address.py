"""Labs by address: `sim://EXPERIMENT[?seed=N]`, where EXPERIMENT is a shipped experiment or the path of a file."""

from __future__ import annotations

from urllib.parse import parse_qsl, unquote, urlsplit

from needleplan.config import suggestion
from needleplan.devices import VirtualClock
from needleplan.errors import ExperimentError, Mistake
from needleplan.simulation.experiment import Experiment
from needleplan.simulation.lab import Lab

__all__ = ["open_lab"]


def open_lab(url: str, clock: VirtualClock | None = None) -> Lab:
    """Open a lab: `sim://insertion`, `sim://folder/mine.toml?seed=3`, `sim:///absolute/mine.toml`.

    Its devices are `stage`, `force_sensor` and `tracker`; the program of the experiment is not run. All three see the
    time of `clock`, or of one of their own. Raises ExperimentError for an address or a file that is wrong.
    """
    parts = urlsplit(url)
    mistakes = []
    name = unquote(parts.netloc + parts.path)
    if parts.scheme != "sim" or not name:
        mistakes.append(Mistake("", url, "must be sim://EXPERIMENT, a shipped experiment or a file"))
    seed: int | None = None
    for key, value in parse_qsl(parts.query, keep_blank_values=True):
        if key != "seed":
            mistakes.append(Mistake(key, value, f"unknown key{suggestion(key, ['seed'])}"))
        elif value.isascii() and value.isdigit():
            seed = int(value)
        else:
            mistakes.append(Mistake("seed", value, "must be a whole number from 0"))
    if mistakes:
        raise ExperimentError(mistakes, url)
    experiment = Experiment.read(name)
    return Lab(experiment.setup, experiment.seed if seed is None else seed, clock)
