"""Two simulated drives on a CAN bus, and the time that passes for them."""

from __future__ import annotations

import threading

from needleplan.devices.cia402.bus import CanBus
from needleplan.devices.cia402.setup import DrivesSetup
from needleplan.devices.cia402.simulated_drive import SimulatedDrive
from needleplan.devices.clock import Clock, SystemClock
from needleplan.devices.closing import Closing

__all__ = ["SimulatedDrives"]

_TICK_S = 0.002


class SimulatedDrives(Closing):
    """Two drives on a bus; a context manager. The bus is one inside this process unless `interface` says otherwise."""

    def __init__(
        self, setup: DrivesSetup, channel: str, interface: str = "virtual", clock: Clock | None = None
    ) -> None:
        self.channel, self.interface = channel, interface
        self.bus = CanBus(channel, interface, SystemClock() if clock is None else clock)
        self.insertion = SimulatedDrive(self.bus, setup.insertion)
        self.roll = SimulatedDrive(self.bus, setup.roll)
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    @property
    def address(self) -> str:
        """The address of the bus, to which a client adds the file with its setup."""
        return f"canopen://{self.channel}?interface={self.interface}"

    def close(self) -> None:
        """Switch them off."""
        if not self._stopping.is_set():
            self._stopping.set()
            self._thread.join()
            self.bus.close()

    def _run(self) -> None:
        while not self._stopping.wait(_TICK_S):
            for drive in (self.insertion, self.roll):
                drive.tick()
