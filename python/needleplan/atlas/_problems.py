"""What a sweep varies: a scenario in a plane, or an anatomy in space."""

from __future__ import annotations

import hashlib
import os
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from needleplan.anatomy import Anatomy, AnatomyFile, SpaceScenario
from needleplan.artifacts import digest
from needleplan.config import build, raw_toml, read_toml
from needleplan.errors import Mistake, ScenarioError
from needleplan.planning import space_of
from needleplan.scenario import Scenario

__all__ = ["FileProblems", "PlaneProblem", "SpaceProblem", "SweptProblem"]


class SweptProblem(ABC):
    """The problem whose keys vary."""

    def of(self, values: Mapping[str, Any]) -> SweptProblem:  # noqa: ARG002
        """Return the problem of a point with these values by name of the parameter: this one, if one file varies."""
        return self

    @property
    @abstractmethod
    def raw(self) -> dict[str, Any]:
        """Contents of the file, without the schema; default values are written out."""

    @property
    @abstractmethod
    def states(self) -> int:
        """Number of states of a table."""

    @abstractmethod
    def changed(self, raw: Mapping[str, Any]) -> Scenario | AnatomyFile:
        """Return the problem with other contents. Raises Violation if they break a rule."""

    @abstractmethod
    def identity(self, changed: Scenario | AnatomyFile) -> str:
        """Return a text that is the same for equal problems on all machines."""


@dataclass(frozen=True)
class PlaneProblem(SweptProblem):
    """A scenario."""

    scenario: Scenario

    @cached_property
    def raw(self) -> dict[str, Any]:
        """Contents of the scenario file, without the schema."""
        return _raw(self.scenario.to_toml())

    @property
    def states(self) -> int:
        """Number of states of a table."""
        return self.scenario.states

    def changed(self, raw: Mapping[str, Any]) -> Scenario:
        """Return the scenario with these contents. Raises Violation if they break a rule."""
        return build(Scenario, raw)

    def identity(self, changed: Scenario | AnatomyFile) -> str:
        """Return the digest of the scenario."""
        return digest(changed.to_toml())


class SpaceProblem(SweptProblem):
    """An anatomy file. Names of other files are made absolute, so that workers find them."""

    def __init__(self, path: str | os.PathLike[str]) -> None:
        """Read the file. Raises ScenarioError if it is wrong or a file that it names cannot be read."""
        self._path = Path(path)
        Anatomy.read(path)  # for the mistakes of the volume, before anything is solved
        self._raw = _raw(read_toml(path, AnatomyFile).to_toml())
        self._digests: dict[str, str] = {}

    @property
    def raw(self) -> dict[str, Any]:
        """Contents of the anatomy file, without the schema."""
        return self._raw

    @cached_property
    def states(self) -> int:
        """Number of states of a table; the volume is read for it."""
        slices, directions, ny, nz = space_of(SpaceScenario.of(Anatomy.read(self._path))).shape
        return int(slices * directions * ny * nz)

    def changed(self, raw: Mapping[str, Any]) -> AnatomyFile:
        """Return the anatomy file with these contents. Raises Violation if they break a rule."""
        regions = dict(raw["anatomy"])
        for key in ("file", "labels"):
            if isinstance(regions.get(key), str) and regions[key]:
                regions[key] = os.path.abspath(self._path.parent / regions[key])  # noqa: PTH100  links stay
        return build(AnatomyFile, {**raw, "anatomy": regions})

    def identity(self, changed: Scenario | AnatomyFile) -> str:
        """Return the digest of the settings and of the contents of volume and colour table, wherever they are."""
        assert isinstance(changed, AnatomyFile)
        files = [changed.anatomy.file, *([changed.anatomy.labels] if changed.anatomy.labels else [])]
        contents = [self._digest(file) for file in files]
        settings = changed.to_toml()
        for file, content in zip(files, contents, strict=True):
            settings = settings.replace(file, content)
        return digest(settings)

    def _digest(self, file: str) -> str:
        if file not in self._digests:
            try:
                with Path(file).open("rb") as stream:
                    self._digests[file] = hashlib.file_digest(stream, "sha256").hexdigest()
            except OSError as error:
                rule = f"cannot be read: {error.strerror}"
                raise ScenarioError(Mistake("anatomy.file", file, rule), os.fspath(self._path)) from None
        return self._digests[file]


class FileProblems(SweptProblem):
    """Several files, one for each value of a parameter; without values, the first one.

    Parameters
    ----------
    title : str
        Name of the parameter.
    problems : dict
        Problem of each file name.
    """

    def __init__(self, title: str, problems: Mapping[str, SweptProblem]) -> None:
        self._title, self._problems = title, problems

    def of(self, values: Mapping[str, Any]) -> SweptProblem:
        """Return the problem of the file that the values name."""
        return self._problems[values[self._title]]

    @property
    def raw(self) -> dict[str, Any]:
        """Contents of the first file."""
        return self._first.raw

    @property
    def states(self) -> int:
        """Number of states of a table of the first file."""
        return self._first.states

    def changed(self, raw: Mapping[str, Any]) -> Scenario | AnatomyFile:
        """Return the problem of the first file with other contents. Raises Violation if they break a rule."""
        return self._first.changed(raw)

    def identity(self, changed: Scenario | AnatomyFile) -> str:
        """Return the identity of a problem of the first file."""
        return self._first.identity(changed)

    @property
    def _first(self) -> SweptProblem:
        return next(iter(self._problems.values()))


def _raw(text: str) -> dict[str, Any]:
    raw = raw_toml(text, ScenarioError)
    raw.pop("schema")
    return raw
