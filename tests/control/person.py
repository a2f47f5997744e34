"""A person who interrupts a run, for tests of the loop."""

from collections.abc import Callable

from needleplan.control import ExecutedStep, Insertion, Listener, RunCommand
from needleplan.control.safety import GuardedStage, Order
from needleplan.devices import Sample
from needleplan.simulation import Lab


class Person(Listener):
    """Interrupts the run at a step, and resumes it after `absent_s`; notes how far in the needle is meanwhile."""

    def __init__(self, lab: Lab, absent_s: float, interrupt: Callable[[GuardedStage], object]) -> None:
        self.lab, self.absent_s, self.interrupt = lab, absent_s, interrupt
        self.insertion: Insertion | None = None
        self.asked = False
        self.began_ns = 0
        self.depths_mm: list[float] = []
        self.states: set[str] = set()
        self.commands: list[RunCommand] = []
        self.order = Order.RESUME

    def step(self, step: ExecutedStep) -> None:
        self.asked |= step.number == 3

    def sample(self, sample: Sample) -> None:
        assert self.insertion is not None
        guard = self.insertion.guard
        if self.asked and not self.began_ns and self.lab.plant.moving:
            self.began_ns = sample.stamp.received_ns
            self.interrupt(guard)
        if not self.asked or not self.began_ns:
            return
        self.states.add(str(guard.state.operating))
        self.depths_mm.append(self.lab.plant.insertion.position)
        if (sample.stamp.received_ns - self.began_ns) * 1e-9 > self.absent_s:
            self.asked = False
            guard.order(self.order, "anna")

    def command(self, command: RunCommand) -> None:
        self.commands.append(command)
