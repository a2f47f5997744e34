"""The experiment file, `needleplan.experiment/1`: text to parts."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import MISSING, fields
from typing import Any

from needleplan.errors import InputError, Mistake, ModelError
from needleplan.models import Channel, Model, ModelFile
from needleplan.models.friction import AveragedLuGre, LuGre, LumpedLuGre
from needleplan.scenario import Scenario
from needleplan.scenario.document import document
from needleplan.scenario.parts import checked
from needleplan.scenario.rules import Integer, Refused, Text, shown, suggestion
from needleplan.simulation.effects import Effects
from needleplan.simulation.modelled import require_simulated
from needleplan.simulation.parts import Entry, Layer, Move, Robot, Setting, Shaft, Tissue
from needleplan.simulation.setup import Setup, disagreements

__all__ = ["SCHEMA", "parse", "unfit_moves"]

SCHEMA = "needleplan.experiment/1"

_TABLES: dict[str, type[Setting]] = {
    "entry": Entry, "tissue": Tissue, "shaft": Shaft, "robot": Robot, "effects": Effects,
}  # fmt: skip
_KEYS = ("schema", "title", "seed", "scenario", "model", *_TABLES, "layer", "friction", "move")
_FRICTIONS: dict[str, type[LuGre]] = {each.name: each for each in (LumpedLuGre, AveragedLuGre)}
_MOST_MOVES = 1000


def parse(text: str) -> tuple[dict[str, Any], list[Mistake]]:
    """Return what makes an experiment, named as its fields, and all mistakes; with mistakes only those count."""
    given, mistakes = document(text, SCHEMA, _KEYS)
    if given is None:
        return {}, mistakes
    parts: dict[str, Any] = {}
    for name, rule, default in (("title", Text(), ""), ("seed", Integer(0, 2**32 - 1), 0)):
        try:
            parts[name] = rule.read(given.get(name, default))
        except Refused as refused:
            mistakes.append(Mistake(name, shown(given[name]), str(refused)))
    parts["scenario"] = _scenario(given.get("scenario"), mistakes)
    tables = {name: _part(kind, given.get(name, {}), name, mistakes) for name, kind in _TABLES.items()}
    layers = _rows(Layer, given.get("layer", []), "layer", mistakes)
    moves = _rows(Move, given.get("move", []), "move", mistakes)
    if "move" not in given:
        mistakes.append(Mistake("move", "", "is missing: an experiment has at least one [[move]]"))
    friction = _friction(given.get("friction"), mistakes)
    tissue = tables["tissue"]
    models = _models(given.get("model", []), mistakes)
    path = models.get(Channel.TIP)
    mistakes += _two_curvatures(path, tissue, layers, planned="scenario" in given)
    made: Any = tables
    mistakes += disagreements(made["entry"], [each for each in layers if each], made["shaft"], made["robot"])
    mistakes += unfit_moves(moves, made["robot"])
    if not mistakes:
        scenario = parts["scenario"]
        plan = 1 / scenario.needle.curvature_radius_mm if scenario else made["tissue"].curvature_per_mm
        if plan is None and path:
            plan = path.values()["curvature_per_mm"]
        parts["moves"] = tuple(moves)
        parts["setup"] = Setup(
            plan,
            layers=tuple(each for each in layers if each),
            friction=friction,
            scenario=scenario,
            path=path,
            force=models.get(Channel.FORCE),
            **made,
        )
    return parts, mistakes


def unfit_moves(moves: Sequence[Move | None], robot: Robot | None) -> list[Mistake]:
    """Return the mistakes of moves, by themselves and for the robot; those that could not be read are None."""
    found: list[Mistake] = []
    for number, move in enumerate(moves, start=1):
        if move:
            found += _unfit(move, f"move {number}", robot)
    return found


def _unfit(move: Move, key: str, robot: Robot | None) -> Iterator[Mistake]:
    kinds = ("insert_to_mm", "rotate_to_rad", "dwell_s")
    given = [name for name in kinds if getattr(move, name) is not None]
    if len(given) != 1:
        yield Mistake(key, ", ".join(given), f"must have exactly one of {', '.join(kinds)}")
        return
    speeds = {"insert_to_mm": "velocity_mm_s", "rotate_to_rad": "velocity_rad_s"}
    for kind, name in speeds.items():
        speed = getattr(move, name)
        if kind != given[0] and speed is not None:
            yield Mistake(f"{key}.{name}", f"{speed:g}", f"must not be there with {given[0]}")
        elif kind == given[0] and speed is None:
            yield Mistake(f"{key}.{name}", "", f"is missing: {kind} needs a speed")
        elif kind == given[0] and robot and speed > (top := getattr(robot, name.replace("velocity", "top_velocity"))):
            yield Mistake(f"{key}.{name}", f"{speed:g}", f"must be at most the robot's top speed, {top:g}")
    depth = move.insert_to_mm
    if robot and depth is not None and not robot.shallowest_mm <= depth <= robot.deepest_mm:
        rule = f"must be where the robot can be, {robot.shallowest_mm:g} to {robot.deepest_mm:g}"
        yield Mistake(f"{key}.insert_to_mm", f"{depth:g}", rule)


def _scenario(raw: object, mistakes: list[Mistake]) -> Scenario | None:
    if raw is None:
        return None
    if not isinstance(raw, str):
        mistakes.append(Mistake("scenario", shown(raw), "must be the name of a scenario, or of its file"))
        return None
    try:
        return Scenario.read(raw)
    except InputError as error:
        mistakes += [
            Mistake(f"scenario {each.key}".strip(), each.value or shown(raw), each.rule) for each in error.mistakes
        ]
        return None


def _models(raw: object, mistakes: list[Mistake]) -> dict[Channel, Model]:
    """Return the models of model files by what they are of: a path of a tip, an axial force."""
    files = [raw] if isinstance(raw, str) else raw
    if not isinstance(files, list) or not all(isinstance(each, str) for each in files):
        mistakes.append(Mistake("model", shown(raw), "must be the name of a model file, or a list of some"))
        return {}
    found: dict[Channel, Model] = {}
    for file in files:
        try:
            model = ModelFile.read(file).model
            require_simulated(model, model.channel)
        except InputError as error:
            mistakes += [Mistake(f"model {each.key}".strip(), each.value or file, each.rule) for each in error.mistakes]
            continue
        if model.channel in found:
            mistakes.append(Mistake("model", file, f"must not be a second one of the {model.channel}"))
        found[model.channel] = model
    return found


def _two_curvatures(
    path: Model | None, tissue: Tissue | None, layers: Sequence[Layer | None], *, planned: bool
) -> Iterator[Mistake]:
    """Yield the mistakes of a curvature that nothing says, or that tissue and model say both."""
    if tissue and tissue.curvature_per_mm is None and not path and not planned:
        rule = "is missing: it is needed where there is neither scenario nor a model of the path"
        yield Mistake("tissue.curvature_per_mm", "", rule)
    named = {"tissue": tissue} | {f"layer {number}": each for number, each in enumerate(layers, start=1)}
    for name, part in named.items():
        if path and part and part.curvature_per_mm is not None:
            rule = "must not be there: the model says how the path bends"
            yield Mistake(f"{name}.curvature_per_mm", f"{part.curvature_per_mm:g}", rule)


def _part(kind: type[Setting], raw: object, key: str, mistakes: list[Mistake]) -> Any:
    if not isinstance(raw, dict):
        mistakes.append(Mistake(key, shown(raw), f"must be a table, [{key.split()[0]}]"))
        return None
    values, found = checked(kind, raw, key)
    mistakes += found
    return None if found else kind(**values)


def _rows(kind: type[Setting], raw: object, key: str, mistakes: list[Mistake]) -> list[Any]:
    if not isinstance(raw, list) or len(raw) > _MOST_MOVES:
        mistakes.append(
            Mistake(key, shown(raw), f"must be tables, each below its own [[{key}]], at most {_MOST_MOVES}")
        )
        return []
    return [_part(kind, each, f"{key} {number}", mistakes) for number, each in enumerate(raw, start=1)]


def _friction(raw: object, mistakes: list[Mistake]) -> LuGre | None:
    if raw is None:
        return None
    if not isinstance(raw, dict):
        mistakes.append(Mistake("friction", shown(raw), "must be a table, [friction]"))
        return None
    values: Mapping[str, Any] = {name: value for name, value in raw.items() if name != "kind"}
    kind = _FRICTIONS.get(raw.get("kind", LumpedLuGre.name))
    if kind is None:
        rule = f"must be one of {', '.join(_FRICTIONS)}{suggestion(raw.get('kind'), _FRICTIONS)}"
        mistakes.append(Mistake("friction.kind", shown(raw.get("kind")), rule))
        return None
    known = {each.name: each for each in fields(kind)}
    found = [
        Mistake(f"friction.{name}", "", f"unknown key{suggestion(name, known)}") for name in values if name not in known
    ]
    found += [
        Mistake(f"friction.{name}", "", "is missing")
        for name, each in known.items()
        if name not in values and each.default is MISSING
    ]
    if not found:
        try:
            return kind(**values)
        except ModelError as error:
            found = [Mistake(f"friction.{each.key}", each.value, each.rule) for each in error.mistakes]
    mistakes += found
    return None
