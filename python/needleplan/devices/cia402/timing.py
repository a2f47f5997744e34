"""How long drives and the one who controls them believe in each other."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["DriveTiming"]


@dataclass(frozen=True)
class DriveTiming:
    """How long each side believes in the other."""

    sync_s: float = 0.005
    """The drives are asked where they are so often."""

    heartbeat_s: float = 0.01
    """Both sides say that they live so often."""

    watchdog_s: float = 0.04
    """A drive that does not hear us for so long stops by itself."""

    silence_s: float = 0.04
    """We give the drives up where they do not say where they are for so long."""

    answer_s: float = 0.3
    """A drive has so long to answer a question."""

    change_s: float = 0.5
    """A change of state, or taking a new target, may take so long."""

    slack_s: float = 0.3
    """A motion may begin so late, or rest so long on its way."""
