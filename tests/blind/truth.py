"""What was hidden in a data set. It is written to another folder than the data, or not at all."""

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any


@dataclass(frozen=True)
class HiddenEffect:
    """Its contribution to the training data: RMS and largest in the truth's unit, and the RMS in that of the noise.

    absorbed is the share that calibrating the base again would take up, noncentrality what is left of it against the
    sensor's noise: the size as an analyst can see it at best.
    """

    name: str
    parameters: dict[str, Any]
    rms: float
    largest: float
    noise_multiple: float
    absorbed: float
    noncentrality: float


@dataclass(frozen=True)
class Truth:
    channel: str
    seed: int
    heterogeneity: float
    noise_rms: float
    unit: str
    effects: tuple[HiddenEffect, ...]

    def write(self, folder: Path, data: Path) -> Path:
        """truth.json in folder, which must lie outside of the folder of the data.

        Raises ValueError otherwise: who diagnoses the data must not come across it.
        """
        if folder.resolve().is_relative_to(data.resolve()):
            raise ValueError(f"{folder}: the truth would lie with the data in {data}")
        folder.mkdir(parents=True, exist_ok=True)
        path = folder / "truth.json"
        path.write_text(json.dumps(asdict(self), indent=1), encoding="utf-8")
        return path
