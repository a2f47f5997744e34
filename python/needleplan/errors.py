"""The public exceptions of needleplan; other modules define subclasses of them for special cases.

::

    NeedleplanError
    ├── DeviceFault             a device cannot be used; the message names the device and the reason
    │   ├── LinkClosed          the connection to a device is closed
    │   ├── MotionRefused       a motion command was not executed; carries the causes
    │   └── ProtocolError       a device sent bytes that violate its protocol
    └── InputError              an input is wrong; the message names the source, the key, the value and the rule
        ├── AddressError        the address of a device is wrong
        ├── ConfigurationError  the configuration of a device (units, tools, setup file) cannot be used
        ├── ScenarioError       a scenario or its file is wrong
        ├── SimulationError     a simulation or its file is wrong
        ├── PoseError           a pose lies outside the policy table, or is not finite
        ├── SafetyError         safety limits or their file are wrong
        ├── MdpError            arrays do not describe a Markov decision process
        ├── ModelError          a mechanical model does not permit its parameters, or its file is wrong
        ├── DataError           measurements cannot be used
        ├── TableError          a file is not a policy table of this version, or is truncated
        │   └── ChecksumError   the bytes of a policy table have changed since the file was written
        ├── SweepError          a sweep, a table set or its cluster cannot be used
        ├── OutputError         a file cannot be written
        └── MissingLibraryError a library is not installed; the message names the extra that installs it

An `InputError` carries all mistakes that were found, not only the first. Wrong calls of internal functions raise
Python's own exceptions, such as TypeError.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

__all__ = [
    "AddressError",
    "ChecksumError",
    "ConfigurationError",
    "DataError",
    "DeviceFault",
    "InputError",
    "LinkClosed",
    "MdpError",
    "MissingLibraryError",
    "Mistake",
    "ModelError",
    "MotionRefused",
    "NeedleplanError",
    "OutputError",
    "PoseError",
    "ProtocolError",
    "SafetyError",
    "ScenarioError",
    "SimulationError",
    "SweepError",
    "TableError",
    "reading",
]

# Largest number of characters of a wrong value in a message; a longer value is cut off and ends in "…".
_LONGEST_VALUE = 60


@dataclass(frozen=True)
class Mistake:
    """One mistake in an input: the key, the wrong value, and the rule that the value violates.

    - `key` is the path of the key, such as `workspace.width_mm`; it may be empty.
    - `value` is the wrong value as text; it is empty if the value is missing.
    - `rule` is a sentence without a full stop.
    """

    key: str
    value: str
    rule: str

    def __str__(self) -> str:
        value = self.value if len(self.value) <= _LONGEST_VALUE else self.value[: _LONGEST_VALUE - 1] + "…"
        subject = f"{self.key} = {value}" if self.key and value else self.key or value
        return f"{subject}: {self.rule}" if subject else self.rule


class NeedleplanError(Exception):
    """Root of the public exceptions of needleplan.

    Examples
    --------
    >>> import needleplan as npl
    >>> issubclass(npl.InputError, npl.NeedleplanError)
    True
    """


class DeviceFault(NeedleplanError):
    """A device cannot be used; the message names the device and the reason."""


class LinkClosed(DeviceFault):
    """The connection to a device is closed."""


class MotionRefused(DeviceFault):
    """A motion command was refused before it was sent to the stage.

    `what` describes the motion; `causes` holds the names of the causes.
    """

    what: str
    causes: tuple[str, ...]

    def __init__(self, what: str, causes: Sequence[str]) -> None:
        self.what, self.causes = what, tuple(causes)
        super().__init__(what, self.causes)

    def __str__(self) -> str:
        return f"{self.what}: refused: {', '.join(self.causes)}"


class ProtocolError(DeviceFault):
    """A device sent bytes that violate its protocol: truncated, damaged, or sent by another kind of device."""


class InputError(NeedleplanError):
    """An input is wrong; the exception carries all mistakes that were found.

    Parameters
    ----------
    mistakes : Mistake, sequence of Mistake, or str
        The mistakes, or the text of one violated rule.
    source : str, optional
        Name of the file that contains the mistakes.

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
        self.mistakes: tuple[Mistake, ...] = tuple(mistakes)
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
    """The configuration of a device cannot be used, for example because of an unknown unit or a missing tool."""


class ScenarioError(InputError):
    """A scenario or its file is wrong."""


class SimulationError(InputError):
    """A simulation or its file is wrong."""


class PoseError(InputError):
    """A pose lies outside the policy table, or is not finite."""


class SafetyError(InputError):
    """Safety limits or their file are wrong."""


class MdpError(InputError):
    """The arrays do not describe a Markov decision process."""


class ModelError(InputError):
    """A mechanical model does not permit its parameters, or its file is wrong."""


class DataError(InputError):
    """Measurements cannot be used."""


class TableError(InputError):
    """A file is not a policy table of this version, or is truncated."""


class ChecksumError(TableError):
    """The bytes of a policy table have changed since the file was written."""


class SweepError(InputError):
    """A sweep, a table set or its cluster cannot be used."""


class OutputError(InputError):
    """A file cannot be written."""


class MissingLibraryError(InputError, ImportError):
    """A library that a part of needleplan needs is not installed; the message names the extra that installs it."""


@contextmanager
def reading(path: str | os.PathLike[str], error: type[InputError] = InputError) -> Iterator[None]:
    """Name the file in the error of a block that reads it.

    Parameters
    ----------
    path : str or path
        The file.
    error : type
        Class of the error that is raised.

    Returns
    -------
    context manager

    Raises
    ------
    InputError
        The block raised OSError or ValueError. The class is `error`.
    """
    try:
        yield
    except (OSError, ValueError) as wrong:
        raise error(f"cannot be read: {getattr(wrong, 'strerror', None) or wrong}", os.fspath(path)) from wrong
