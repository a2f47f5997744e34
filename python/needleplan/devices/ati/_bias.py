"""Detection of a bias command that another client has sent to the box.

RDT does not acknowledge a bias command, and the box obeys any sender. A bias under load shows in two ways:

- *In the stream.* Before the command, at least one axis is loaded and all axes are quiet; with the next sample, all six
  axes are zero within their noise, and stay there. The force on a needle does not vanish within one sample: tissue
  relaxes, friction reverses and a hand lets go over several samples. `BiasWatch` looks for this step.
- *In the configuration page.* `setbias` of the page is the bias of the box, and changes with every bias command, also
  without load. `Poll` reads the page regularly, in a thread of its own.
"""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable, Sequence

from needleplan.devices._base import Closing
from needleplan.errors import ConfigurationError, DeviceFault

__all__ = ["BiasWatch", "Poll"]

_AXES = 6
_FLOORS = (0.005,) * 3 + (0.5,) * 3  # smallest noise that is assumed of each axis, N and N mm
_LOADS = (0.1,) * 3 + (10.0,) * 3  # load of each axis (N, N mm) below which a bias is not noticed in the stream
_LOADED, _ZERO = 10.0, 6.0  # multiples of the noise above which an axis is loaded, and below which it is zero
_ZEROS = 4  # number of samples in succession that must be zero
_MEMORY = 50  # number of samples over which the noise is averaged
_NOISE_OF_STEP = 0.886  # standard deviation of Gaussian noise / mean absolute difference of two samples: sqrt(pi) / 2


class BiasWatch:
    """Detects the bias of another client: with a load, all six axes step to zero within one sample."""

    def __init__(self) -> None:
        self._steps = [0.0] * _AXES
        self._count = 0
        self.forget()

    def forget(self) -> None:
        """Forget the last sample, so that the next one may differ by any amount; keep the noise."""
        self._last: Sequence[float] | None = None
        self._quiet = False
        self._zeros = 0

    def see(self, values: Sequence[float]) -> bool:
        """Record three forces (N) and three torques (N mm); return whether a bias is seen with this sample."""
        last, self._last = self._last, values
        if last is None:
            return False
        noise = [max(_NOISE_OF_STEP * step, floor) for step, floor in zip(self._steps, _FLOORS, strict=True)]
        zero = all(abs(value) <= _ZERO * sd for value, sd in zip(values, noise, strict=True))
        loaded = self._quiet and any(
            abs(value) > max(_LOADED * sd, load) for value, sd, load in zip(last, noise, _LOADS, strict=True)
        )
        self._quiet = all(
            abs(value - before) <= _ZERO * sd for value, before, sd in zip(values, last, noise, strict=True)
        )
        if zero and (self._zeros or loaded):
            self._zeros += 1
            return self._zeros == _ZEROS
        if self._zeros:
            self._zeros = 0
            return False
        self._count = min(self._count + 1, _MEMORY)
        for axis, (value, before) in enumerate(zip(values, last, strict=True)):
            self._steps[axis] += (abs(value - before) - self._steps[axis]) / self._count
        return False


class Poll(Closing):
    """Calls `check` every `period_s` in a thread of its own until it is closed; the errors of devices are ignored.

    `check` itself stores its result.
    """

    def __init__(self, check: Callable[[], object], period_s: float) -> None:
        self._check, self._period_s = check, period_s
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._run, name="configuration of the force sensor", daemon=True)
        self._thread.start()

    def _run(self) -> None:
        while not self._closing.wait(self._period_s):
            with contextlib.suppress(DeviceFault, ConfigurationError):
                self._check()

    def close(self) -> None:
        """End the thread. Closing twice is harmless."""
        self._closing.set()
        if self._thread is not threading.current_thread():
            self._thread.join()
