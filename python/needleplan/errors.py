"""Every exception that needleplan raises on purpose.

::

    NeedleplanError
    ├── DeviceFault             a device cannot be used: says which, and why
    │   ├── LinkClosed          the way to it is gone
    │   ├── MotionRefused       a command or an order was not carried out, with its causes
    │   └── ProtocolError       it sent bytes that its protocol does not know
    └── InputError              what was supplied is wrong: names the source, the key, the value and the rule
        ├── AddressError        the address of a device
        ├── ConfigurationError  what a device says of itself (units, ports) cannot be used
        ├── ScenarioError       a scenario, or the file it came from
        ├── ExperimentError     a simulated experiment, or the file it came from
        ├── PoseError           a pose outside the table, or not a number
        ├── SafetyError         limits of a run that are no limits
        ├── MdpError            arrays that do not describe a Markov decision process
        ├── ModelError          parameters that a model of the mechanics cannot have
        ├── DataError           measurements that cannot be used as they are
        ├── TableError          not a policy table of this version, or a truncated one
        │   └── ChecksumError   a policy table whose bytes have changed since it was written
        └── OutputError         a file that cannot be written

An `InputError` carries all the mistakes that were found, not the first one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

__all__ = [
    "AddressError",
    "ChecksumError",
    "ConfigurationError",
    "DataError",
    "DeviceFault",
    "ExperimentError",
    "InputError",
    "LinkClosed",
    "MdpError",
    "Mistake",
    "ModelError",
    "MotionRefused",
    "NeedleplanError",
    "OutputError",
    "PoseError",
    "ProtocolError",
    "SafetyError",
    "ScenarioError",
    "TableError",
]

_LONGEST_VALUE = 60


@dataclass(frozen=True)
class Mistake:
    """One mistake: where it is, what stands there, and the rule that it breaks.

    `key` is the path of the key (`workspace.width_mm`) and may be empty; `value` is what stands there as text, empty
    where nothing does; `rule` is a sentence without a full stop.
    """

    key: str
    value: str
    rule: str

    def __str__(self) -> str:
        value = self.value if len(self.value) <= _LONGEST_VALUE else self.value[: _LONGEST_VALUE - 1] + "…"
        subject = f"{self.key} = {value}" if self.key and value else self.key or value
        return f"{subject}: {self.rule}" if subject else self.rule


class NeedleplanError(Exception):
    """Root of all exceptions that needleplan raises on purpose.

    Examples
    --------
    >>> import needleplan as npl
    >>> issubclass(npl.InputError, npl.NeedleplanError)
    True
    """


class DeviceFault(NeedleplanError):
    """A device cannot be used; the message says which and why."""


class LinkClosed(DeviceFault):
    """The way to a device is gone."""


class MotionRefused(DeviceFault):
    """A command or an order was not carried out, and nothing went to the stage; `causes` says why, by name."""

    def __init__(self, what: str, causes: Sequence[str]) -> None:
        self.what, self.causes = what, tuple(causes)
        super().__init__(what, self.causes)

    def __str__(self) -> str:
        return f"{self.what}: refused: {', '.join(self.causes)}"


class ProtocolError(DeviceFault):
    """A device sent bytes that its protocol does not know: cut short, damaged, or another device's."""


class InputError(NeedleplanError):
    """Input is wrong; the exception carries all mistakes that were found.

    Parameters
    ----------
    mistakes : Mistake, sequence of Mistake, or str
        The mistakes, or one rule that was broken.
    source : str, optional
        Name of the file that holds them.

    Examples
    --------
    >>> import needleplan as npl
    >>> try:
    ...     npl.plan("four_obstacle")
    ... except npl.InputError as error:
    ...     error.mistakes[0].rule[:12], error.source
    ('no such file', 'four_obstacle')
    """

    def __init__(self, mistakes: Sequence[Mistake] | Mistake | str, source: str = "") -> None:
        if isinstance(mistakes, str):
            mistakes = Mistake("", "", mistakes)
        if isinstance(mistakes, Mistake):
            mistakes = (mistakes,)
        self.mistakes = tuple(mistakes)
        self.source = source
        super().__init__(self.mistakes, source)

    def __str__(self) -> str:
        prefix = f"{self.source}: " if self.source else ""
        if len(self.mistakes) == 1:
            return f"{prefix}{self.mistakes[0]}"
        return "\n".join([f"{prefix}{len(self.mistakes)} mistakes", *(f"  {each}" for each in self.mistakes)])


class AddressError(InputError):
    """The address of a device is wrong."""


class ConfigurationError(InputError):
    """What a device says of itself cannot be used: units that are not known, a tool that is not there."""


class ScenarioError(InputError):
    """A scenario, or the file that it came from, is wrong."""


class ExperimentError(InputError):
    """A simulated experiment, or the file that it came from, is wrong."""


class PoseError(InputError):
    """A pose lies outside the table or is not a number."""


class SafetyError(InputError):
    """Limits of a run are not limits, or the file that they came from is wrong."""


class MdpError(InputError):
    """The arrays do not describe a Markov decision process."""


class ModelError(InputError):
    """A model of the mechanics cannot have these parameters, or the file that it came from is wrong."""


class DataError(InputError):
    """Measurements cannot be used as they are."""


class TableError(InputError):
    """The file is not a policy table of this version, or not all of one."""


class ChecksumError(TableError):
    """The bytes of a policy table have changed since it was written."""


class OutputError(InputError):
    """A file cannot be written."""
