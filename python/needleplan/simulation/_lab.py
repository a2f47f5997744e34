"""The lab twin: a plant with its sensors, accessible as three devices.

Time is simulated. Time advances when a program advances the clock of the lab, sleeps on this clock, or waits for a
sample: `read` returns the oldest unread sample; if there is no sample, time advances until there is one, at most by
`timeout_s`. All devices share the clock. Each device keeps the unread samples of the last two seconds. The next sample
contains the number of older samples that were lost.
"""

from __future__ import annotations

from collections import deque
from dataclasses import replace
from typing import Generic, TypeVar
from urllib.parse import parse_qsl, unquote, urlsplit

from needleplan.config import suggestion
from needleplan.devices import (
    Device,
    FibreSample,
    ForceSample,
    ForceSensor,
    ImageSample,
    PoseSample,
    Stage,
    StageSample,
    Stamp,
    Tracker,
    VirtualClock,
)
from needleplan.errors import DeviceFault, Mistake, SimulationError
from needleplan.simulation._plant import Plant
from needleplan.simulation._sensors import FibreReading, ForceReading, ImageReading, TrackerReading
from needleplan.simulation._setup import FIBRE_HZ, FORCE_HZ, IMAGE_HZ, TRACKER_HZ, Setup
from needleplan.simulation._simulation import Simulation

__all__ = [
    "Lab",
    "SimulatedFibre",
    "SimulatedForceSensor",
    "SimulatedStage",
    "SimulatedTracker",
    "SimulatedUltrasound",
    "open_lab",
]

# time (s) for which a device keeps unread samples
_KEPT_S = 2
_NANO = 1_000_000_000

_Sample = TypeVar("_Sample", StageSample, ForceSample, PoseSample, FibreSample, ImageSample)


class Lab(Device):
    """A plant with its sensors on a virtual clock.

    The devices are `stage`, `force_sensor`, `tracker`, `fibre` and `ultrasound`.
    Samples are taken at multiples of their interval, the first sample after one interval. The time of a sample is the
    time at which it was taken; transport takes no time, except for images, whose time is that of their arrival.
    """

    def __init__(self, setup: Setup, seed: int = 0, clock: VirtualClock | None = None) -> None:
        self.clock: VirtualClock = clock or VirtualClock()
        self.plant: Plant = Plant(setup, seed)
        self._begin_ns = self.clock.now_ns()
        self._coil_mm = setup.effects.coil_offset_mm
        self.forces: ForceReading = ForceReading(setup.effects, seed)
        self._poses = TrackerReading(setup.effects, seed)
        self._sensors = setup.fibre
        self._fibres = FibreReading(setup.effects, len(setup.fibre.from_tip_mm) if setup.fibre else 0, seed)
        self._plane = setup.ultrasound
        self._images = ImageReading(setup.effects, self._plane.thickness_mm if self._plane else 0.0, seed)
        self._late: deque[ImageSample] = deque()
        self._delay_s = setup.effects.ultrasound_delay_s
        self._tick_ns = _NANO / setup.robot.servo_hz
        self._due_ns = self._begin_ns + round(self._tick_ns)
        self._force_ticks = setup.robot.servo_hz // FORCE_HZ
        self._tracker_ticks = setup.robot.servo_hz // TRACKER_HZ
        self._fibre_ticks = setup.robot.servo_hz // FIBRE_HZ
        self._image_ticks = setup.robot.servo_hz // IMAGE_HZ
        self.stage: SimulatedStage = SimulatedStage(self)
        self.force_sensor: SimulatedForceSensor = SimulatedForceSensor(self)
        self.tracker: SimulatedTracker = SimulatedTracker(self)
        self.fibre: SimulatedFibre = SimulatedFibre(self)
        self.ultrasound: SimulatedUltrasound = SimulatedUltrasound(self)

    @property
    def exhaled_s(self) -> float:
        """Time (s) of the clock at the end of an exhalation."""
        return self._begin_ns / _NANO + self.plant.exhaled_s

    def catch_up(self) -> None:
        """Advance the plant to the time of the clock."""
        now_ns = self.clock.now_ns()
        while self._due_ns <= now_ns:
            self._tick()

    def advance(self, seconds: float) -> None:
        """Advance the clock and the plant by `seconds`."""
        self.clock.advance(seconds)
        self.catch_up()

    def wait(self, limit_ns: int) -> bool:
        """Advance to the next tick, but at most to the time `limit_ns`; return whether there was a tick."""
        due_ns, now_ns = self._due_ns, self.clock.now_ns()
        self.clock.advance((min(due_ns, limit_ns) - now_ns) / _NANO)
        self.catch_up()
        return due_ns <= limit_ns

    def close(self) -> None:
        """Close the devices."""
        for each in (self.stage, self.force_sensor, self.tracker, self.fibre, self.ultrasound):
            each.close()

    def _tick(self) -> None:
        plant = self.plant
        plant.step()
        ticks, now_s, now_ns = plant.ticks, plant.now_s, self._due_ns
        self._due_ns = self._begin_ns + round((ticks + 1) * self._tick_ns)
        axis = plant.insertion
        self.stage.put(
            StageSample(
                Stamp(now_ns, ticks, 0, now_s), axis.measured, axis.measured_velocity, plant.roll.measured, plant.moving
            )
        )
        if ticks % self._force_ticks == 0:
            stamp = Stamp(now_ns, ticks // self._force_ticks, 0, now_s)
            self.force_sensor.put(self.forces.sample(stamp, plant.felt_n, plant.torque_n_mm, now_s))
        if ticks % self._tracker_ticks == 0:
            stamp = Stamp(now_ns, ticks // self._tracker_ticks, 0, now_s)
            self.tracker.put(self._poses.sample(stamp, plant.seen_behind(self._coil_mm)))
        if self._sensors and ticks % self._fibre_ticks == 0:
            stamp, gauge = Stamp(now_ns, ticks // self._fibre_ticks, 0, now_s), self._sensors.gauge_mm
            curvatures = [plant.curvature_behind(behind, gauge) for behind in self._sensors.from_tip_mm]
            self.fibre.put(self._fibres.sample(stamp, curvatures))
        if self._plane and ticks % self._image_ticks == 0:
            arrival_ns = now_ns + round(self._delay_s * _NANO)
            stamp = Stamp(arrival_ns, ticks // self._image_ticks, 0, now_s + self._delay_s)
            self._late.append(self._images.sample(stamp, self._plane.seen(plant.tip().position_mm)))
        while self._late and self._late[0].stamp.received_ns <= now_ns:
            self.ultrasound.put(self._late.popleft())


class _SampleQueue(Generic[_Sample]):
    """Queue of the unread samples of one device."""

    def __init__(self, lab: Lab, rate_hz: float) -> None:
        self._lab = lab
        self._waiting: deque[_Sample] = deque(maxlen=max(int(_KEPT_S * rate_hz), 1))
        self._lost = 0
        self._open = True

    def put(self, sample: _Sample) -> None:
        """Append a sample, and drop the oldest sample if the queue is full."""
        if not self._open:
            return
        self._lost += len(self._waiting) == self._waiting.maxlen
        self._waiting.append(sample)

    def read(self, timeout_s: float) -> _Sample | None:
        """Return the oldest unread sample; if there is none, advance the time to the next one, at most by `timeout_s`.

        Returns None if there is still no sample. Raises DeviceFault if the device is closed.
        """
        self.require_open()
        lab = self._lab
        lab.catch_up()
        if not self._waiting and timeout_s > 0:
            limit_ns = lab.clock.now_ns() + round(timeout_s * _NANO)
            while not self._waiting and lab.wait(limit_ns):
                pass
        if not self._waiting:
            return None
        sample = self._waiting.popleft()
        if not self._lost:
            return sample
        lost, self._lost = self._lost, 0
        stamp = sample.stamp
        return replace(sample, stamp=replace(stamp, lost=lost))

    def waiting(self) -> list[_Sample]:
        """Remove and return all unread samples, without advancing the time."""
        found = list(self._waiting)
        self._waiting.clear()
        return found

    def require_open(self) -> None:
        """Raise DeviceFault if the device is closed."""
        if not self._open:
            raise DeviceFault(f"{type(self).__name__}: is closed")

    def close(self) -> None:
        """Close the device and discard its samples."""
        self._open = False
        self._waiting.clear()


class SimulatedStage(_SampleQueue[StageSample], Stage):
    """Stage that moves the two axes of the simulated robot, with one sample per servo tick."""

    def __init__(self, lab: Lab) -> None:
        super().__init__(lab, lab.plant.setup.robot.servo_hz)

    def insert(self, depth_mm: float, velocity_mm_s: float) -> None:
        """Begin to move to a depth at a speed. Raises DeviceFault if the stage is closed or refuses the values."""
        self.require_open()
        self._lab.catch_up()
        self._lab.plant.insert(depth_mm, velocity_mm_s)

    def rotate(self, roll_rad: float, velocity_rad_s: float) -> None:
        """Begin to rotate the base to a roll angle (rad) at a positive speed (rad/s).

        Raises DeviceFault if the stage is closed or refuses the values.
        """
        self.require_open()
        self._lab.catch_up()
        self._lab.plant.rotate(roll_rad, velocity_rad_s)

    def stop(self) -> None:
        """Stop both axes with the deceleration of their profiles."""
        self._lab.catch_up()
        self._lab.plant.stop()

    def close(self) -> None:
        """Stop and close the stage."""
        if self._open:
            self.stop()
        super().close()


class SimulatedForceSensor(_SampleQueue[ForceSample], ForceSensor):
    """Simulated force sensor; its z axis is along the needle, and a positive force resists insertion."""

    def __init__(self, lab: Lab) -> None:
        super().__init__(lab, FORCE_HZ)

    def bias(self) -> None:
        """Set the zero to the last measured force and torque; without a sample, first advance the time by at most 1 s.

        Unread samples, which have the old zero, are dropped and counted as lost. Raises DeviceFault if the sensor is
        closed.
        """
        self.require_open()
        lab = self._lab
        lab.catch_up()
        limit_ns = lab.clock.now_ns() + _NANO
        while not lab.forces.measured and lab.wait(limit_ns):
            pass
        lab.forces.bias()
        self._lost += len(self.waiting())


class SimulatedTracker(_SampleQueue[PoseSample], Tracker):
    """Simulated tracker; the z axis of its coil is along the needle."""

    def __init__(self, lab: Lab) -> None:
        super().__init__(lab, TRACKER_HZ)


class SimulatedFibre(_SampleQueue[FibreSample], Device):
    """Simulated curvature sensors along the needle; without sensors in the setup there are no samples."""

    def __init__(self, lab: Lab) -> None:
        super().__init__(lab, FIBRE_HZ)


class SimulatedUltrasound(_SampleQueue[ImageSample], Device):
    """Simulated detections of the tip in images; without an image plane in the setup there are no samples."""

    def __init__(self, lab: Lab) -> None:
        super().__init__(lab, IMAGE_HZ)


def open_lab(url: str, clock: VirtualClock | None = None) -> Lab:
    """Open a simulated lab by its address.

    The devices of the lab are `stage`, `force_sensor` and `tracker`; the program of the simulation is not run.

    Parameters
    ----------
    url : str
        `sim://insertion`, `sim://folder/mine.toml?seed=3` or `sim:///absolute/mine.toml`. Without `seed`, the seed is
        that of the simulation.
    clock : VirtualClock, optional
        Clock of the lab. Default: an own clock.

    Returns
    -------
    Lab

    Raises
    ------
    SimulationError
        The address or the file is invalid.
    """
    parts = urlsplit(url)
    mistakes = []
    name = unquote(parts.netloc + parts.path)
    if parts.scheme != "sim" or not name:
        mistakes.append(Mistake("", url, "must be sim://SIMULATION, a shipped simulation or a file"))
    seed: int | None = None
    for key, value in parse_qsl(parts.query, keep_blank_values=True):
        if key != "seed":
            mistakes.append(Mistake(key, value, f"unknown key{suggestion(key, ['seed'])}"))
        elif value.isascii() and value.isdigit():
            seed = int(value)
        else:
            mistakes.append(Mistake("seed", value, "must be a whole number from 0"))
    if mistakes:
        raise SimulationError(mistakes, url)
    simulation = Simulation.read(name)
    return Lab(simulation.setup, simulation.seed if seed is None else seed, clock)
