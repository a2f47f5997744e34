"""What a sweep varies: a scenario in a plane, or an anatomy in 3D."""

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

__all__ = ["PlaneProblem", "SpaceProblem", "SweptProblem", "SweptProblems"]


class SweptProblem(ABC):
    """A problem whose keys vary."""

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
        """Number of states of a table. The first access reads the volume from its file."""
        slices, directions, ny, nz = space_of(SpaceScenario.of(Anatomy.read(self._path))).shape
        return int(slices * directions * ny * nz)

    def changed(self, raw: Mapping[str, Any]) -> AnatomyFile:
        """Return the anatomy file with these contents. Raises Violation if they break a rule."""
        regions = dict(raw["anatomy"])
        for key in ("file", "labels"):
            if isinstance(regions.get(key), str) and regions[key]:
                regions[key] = self._absolute(regions[key])
        parts = {**raw, "anatomy": regions}
        if isinstance(breathing := raw.get("breathing"), Mapping) and (field := breathing.get("field")):
            names = [field] if isinstance(field, str) else field
            parts["breathing"] = {**breathing, "field": [self._absolute(name) for name in names]}
        return build(AnatomyFile, parts)

    def _absolute(self, file: str) -> str:
        return os.path.abspath(self._path.parent / file)  # noqa: PTH100  links stay

    def identity(self, changed: Scenario | AnatomyFile) -> str:
        """Return the digest of the settings and of the contents of volume and colour table, wherever they are."""
        assert isinstance(changed, AnatomyFile)
        fields = changed.breathing.field if changed.breathing else ()
        named = (changed.anatomy.file, changed.anatomy.labels, *fields)
        files = [file for file in named if file]
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


@dataclass(frozen=True)
class SweptProblems:
    """The problem that a sweep varies, or several: one for each value of a parameter that holds files.

    `by_file` maps the values of the parameter `title` to problems; one problem alone has an empty title and value.
    """

    by_file: Mapping[str, SweptProblem]
    title: str = ""

    @classmethod
    def one(cls, problem: SweptProblem) -> SweptProblems:
        """Return the problems of a sweep without a parameter that holds files."""
        return cls({"": problem})

    def of(self, values: Mapping[str, Any]) -> SweptProblem:
        """Return the problem of a point with these values by name of the parameter."""
        return self.by_file[values[self.title] if self.title else ""]

    @property
    def all(self) -> tuple[SweptProblem, ...]:
        """The problems, in the order of the files."""
        return tuple(self.by_file.values())

    @property
    def states(self) -> int:
        """Number of states of the largest table, before parameters change it."""
        return max(problem.states for problem in self.all)


def _raw(text: str) -> dict[str, Any]:
    raw = raw_toml(text, ScenarioError)
    raw.pop("schema")
    return raw
