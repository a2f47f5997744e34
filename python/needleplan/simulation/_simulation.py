"""Simulations: setup, program of moves and seed, read from files of the format `needleplan.simulation/1`."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import MISSING, dataclass, fields
from pathlib import Path

from needleplan.artifacts import ShortRepr, digest
from needleplan.config import (
    SEED,
    Choice,
    ConfigTable,
    Keyed,
    Maybe,
    Subtable,
    TableList,
    Text,
    Violation,
    parse_toml,
    ruled,
    shipped_names,
    text_of,
    under,
)
from needleplan.errors import InputError, Mistake, ModelError, SimulationError
from needleplan.models import Channel, Model, ModelFile
from needleplan.models.deflection import FibreSensors
from needleplan.models.friction import AveragedLuGre, LuGre, LumpedLuGre
from needleplan.models.path import ImagePlane
from needleplan.scenario import Scenario
from needleplan.simulation._effects import Effects
from needleplan.simulation._modelled import require_simulated
from needleplan.simulation._setup import (
    BETWEEN,
    Move,
    Robot,
    Setup,
    Shaft,
    SimulatedEntry,
    SimulatedLayer,
    SimulatedTissue,
)

__all__ = ["Simulation", "shipped_simulations"]

_FOLDER = Path(__file__).parent.parent / "simulations"
# Former names of shipped simulations.
_FORMER = {"space": "steering"}
_FRICTIONS: dict[str, type[LuGre]] = {each.name: each for each in (LumpedLuGre, AveragedLuGre)}
_KINDS_OF_MOVE = ("insert_to_mm", "rotate_to_rad", "dwell_s")
# Largest number of layers and largest number of moves in one file.
_MOST_TABLES = 1000

Models = dict[Channel, Model]


class _ScenarioRule:
    """Rule for the name of a shipped scenario or of a scenario file."""

    def read(self, value: object) -> Scenario:
        """Return the scenario. Raises Violation."""
        if not isinstance(value, str):
            raise Violation("must be the name of a scenario, or of its file", value)
        try:
            return Scenario.read(value)
        except InputError as error:
            raise Violation(list(_inside(f'"{value}"', error.mistakes))) from None


class _ModelsRule:
    """Rule for the name of a model file, or a list of such names."""

    def read(self, value: object) -> Models:
        """Return the models, by the channel that each predicts. Raises Violation."""
        files = [value] if isinstance(value, str) else value
        if not isinstance(files, list) or not all(isinstance(each, str) for each in files):
            raise Violation("must be the name of a model file, or a list of such names", value)
        found: Models = {}
        mistakes: list[Mistake] = []
        for file in files:
            try:
                model = ModelFile.read(file).model
                require_simulated(model, model.channel)
            except InputError as error:
                mistakes += _inside(file, error.mistakes)
                continue
            if model.channel in found:
                mistakes.append(Mistake("", file, f"must not be a second model of the {model.channel}"))
            found[model.channel] = model
        if mistakes:
            raise Violation(mistakes)
        return found


class _FrictionRule:
    """Rule for a table with the kind and the parameters of a friction model."""

    def read(self, value: object) -> LuGre:
        """Return the friction model. Raises Violation."""
        kinds = Choice(_FRICTIONS)
        if not isinstance(value, dict):
            raise Violation("must be a table, [friction]", value)
        kind: type[LuGre] = Keyed({"kind": kinds}, others=_Anything()).read(value).get("kind", LumpedLuGre)
        rules = {field.name: _Anything() for field in fields(kind)}
        required = {field.name: "" for field in fields(kind) if field.default is MISSING}
        values = Keyed({"kind": kinds, **rules}, required).read(value)
        try:
            return kind(**{name: each for name, each in values.items() if name != "kind"})
        except ModelError as error:
            raise Violation(error.mistakes) from None


class _Anything:
    """Rule that accepts any value, because the model checks its parameters itself."""

    def read(self, value: object) -> object:
        """Return the value."""
        return value


def _inside(file: str, mistakes: Sequence[Mistake]) -> Iterator[Mistake]:
    """Yield the mistakes of `file` for a message about the referring file; a missing value becomes `file`."""
    for mistake in mistakes:
        yield Mistake(f" {mistake.key}".rstrip(), mistake.value or file, mistake.rule)


def _curvature_is_given_once(
    scenario: Scenario | None, model: Models, tissue: SimulatedTissue, layer: tuple[SimulatedLayer | None, ...]
) -> Iterator[Mistake]:
    path = model.get(Channel.TIP)
    if tissue.curvature_per_mm is None and not path and not scenario:
        rule = "is missing: it is required without a scenario and without a model of the path"
        yield Mistake("tissue.curvature_per_mm", "", rule)
    named = {"tissue": tissue} | {f"layer {number}": each for number, each in enumerate(layer, start=1)}
    for name, part in named.items():
        if path and part and part.curvature_per_mm is not None:
            rule = "must not be given: the model determines the curvature of the path"
            yield Mistake(f"{name}.curvature_per_mm", f"{part.curvature_per_mm:g}", rule)


def _moves_fit(move: Sequence[Move | None], robot: Robot) -> Iterator[Mistake]:
    for number, each in enumerate(move, start=1):
        if each:
            yield from under(f"move {number}", _move_fits(each, robot))


def _move_fits(move: Move, robot: Robot) -> Iterator[Mistake]:
    given = [name for name in _KINDS_OF_MOVE if getattr(move, name) is not None]
    if len(given) != 1:
        yield Mistake("", ", ".join(given), f"must have exactly one of {', '.join(_KINDS_OF_MOVE)}")
        return
    speeds = {"insert_to_mm": "velocity_mm_s", "rotate_to_rad": "velocity_rad_s"}
    for kind, name in speeds.items():
        speed = getattr(move, name)
        if kind != given[0] and speed is not None:
            yield Mistake(name, f"{speed:g}", f"must not be given with {given[0]}")
        elif kind == given[0] and speed is None:
            yield Mistake(name, "", f"is missing: {kind} needs a speed")
        elif kind == given[0] and speed > (top := getattr(robot, name.replace("velocity", "top_velocity"))):
            yield Mistake(name, f"{speed:g}", f"must be at most the robot's top speed, {top:g}")
    depth = move.insert_to_mm
    if depth is not None and not robot.shallowest_mm <= depth <= robot.deepest_mm:
        rule = f"must be within the range of the robot, {robot.shallowest_mm:g} to {robot.deepest_mm:g}"
        yield Mistake("insert_to_mm", f"{depth:g}", rule)


@dataclass(frozen=True, kw_only=True)
class _SimulationTable(
    ConfigTable,
    error=SimulationError,
    schema="needleplan.simulation/1",
    between=(_curvature_is_given_once, *BETWEEN, _moves_fit),
):
    title: str = ruled(Text(), "")
    seed: int = ruled(SEED, 0)
    scenario: Scenario | None = ruled(_ScenarioRule(), None)
    entry: SimulatedEntry = ruled(Subtable(SimulatedEntry), SimulatedEntry())
    tissue: SimulatedTissue = ruled(Subtable(SimulatedTissue), SimulatedTissue())
    shaft: Shaft = ruled(Subtable(Shaft), Shaft())
    robot: Robot = ruled(Subtable(Robot), Robot())
    effects: Effects = ruled(Subtable(Effects), Effects())
    layer: tuple[SimulatedLayer, ...] = ruled(TableList(SimulatedLayer, _MOST_TABLES), ())
    move: tuple[Move, ...] = ruled(TableList(Move, _MOST_TABLES))
    friction: LuGre | None = ruled(_FrictionRule(), None)
    model: Models = ruled(_ModelsRule(), factory=dict)
    fibre: FibreSensors | None = ruled(Maybe(Subtable(FibreSensors)), None)
    ultrasound: ImagePlane | None = ruled(Maybe(Subtable(ImagePlane)), None)

    @property
    def setup(self) -> Setup:
        """Setup of the lab twin."""
        path = self.model.get(Channel.TIP)
        plan = 1 / self.scenario.needle.curvature_radius_mm if self.scenario else self.tissue.curvature_per_mm
        if plan is None:
            assert path is not None
            plan = path.values()["curvature_per_mm"]
        return Setup(
            plan, self.entry, self.tissue, self.layer, self.shaft, self.robot, self.effects, self.friction,
            self.scenario, path, self.model.get(Channel.FORCE), fibre=self.fibre,
            ultrasound=self.ultrasound,
        )  # fmt: skip


@dataclass(frozen=True)
class Simulation(ShortRepr):
    """Setup, program of moves and seed of a run of the lab twin.

    `scenario` is the scenario that was planned, or None; `digest` is the digest of the simulation file. Raises
    SimulationError if a move does not fit the robot, or if the seed is negative.
    """

    setup: Setup
    moves: tuple[Move, ...]
    seed: int = 0
    title: str = ""
    scenario: Scenario | None = None
    digest: str = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "moves", tuple(self.moves))
        mistakes = list(_moves_fit(self.moves, self.setup.robot))
        if self.seed < 0:
            mistakes.append(Mistake("seed", f"{self.seed}", "must be a whole number from 0"))
        if mistakes:
            raise SimulationError(mistakes)

    @classmethod
    def read(cls, path: str | os.PathLike[str]) -> Simulation:
        """Read a simulation file, or a shipped simulation by its name, such as `Simulation.read("insertion")`.

        Raises SimulationError with every mistake of the file.
        """
        path = _FORMER.get(os.fspath(path), path)
        return cls.from_toml(text_of(path, SimulationError, _FOLDER, "simulation"), os.fspath(path))

    @classmethod
    def from_toml(cls, text: str, source: str = "") -> Simulation:
        """Parse the text of a simulation file.

        Parameters
        ----------
        text : str
            Text of the file.
        source : str, optional
            Name of the text in messages.

        Returns
        -------
        Simulation

        Raises
        ------
        SimulationError
            The text is not TOML, or has mistakes. The error lists all of them.
        """
        read = parse_toml(text, _SimulationTable, source)
        return cls(read.setup, read.move, read.seed, read.title, read.scenario, digest(text))


def shipped_simulations() -> list[str]:
    """Return the names of the shipped simulations. `Simulation.read` accepts a name instead of a path."""
    return shipped_names(_FOLDER)
