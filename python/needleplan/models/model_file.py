"""The model file, `needleplan.model/1`: an identified model as TOML.

::

    schema = "needleplan.model/1"
    kind = "bicycle"
    title = ""
    made_by = "needleplan 0.1.0"

    [parameters.curvature_per_mm]
    value = 0.00083
    unit = "1/mm"
    sd = 2e-5                 # sd, low, high, identified: only if the parameter was identified
    low = 0.00079
    high = 0.00087
    identified = true
    between_sd = 3e-5         # standard deviation of the fitted values of the recordings

    [options]                 # choices of the model that are not parameters
    profile = "constant"

    [fibre]                   # only of a needle with curvature sensors
    from_tip_mm = [10, 30]    # distances of the sensors from the tip, the nearest first

    [[parent]]                # data from which the model was identified
    name = "trial 3"
    digest = "sha256:..."
    file = "data.csv"         # relative to the folder of this file; may lack

    [[effect]]                # an effect that was added to the model
    name = "puncture"
    version = "1"
    found_by = "sha256:..."   # digest of the diagnosis that found the effect; empty if a person added it
    [effect.parameters.size]  # same keys as the parameters of the model
    value = 0.31
    unit = "N"

A parameter that is missing in the file has the model's default value; a parameter without a default must be present.
`unit` must be the unit that the model declares.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping
from dataclasses import MISSING, dataclass, field, fields, replace
from enum import StrEnum
from functools import cached_property
from pathlib import Path
from typing import Any, get_type_hints

from needleplan.artifacts import Parent, ShortRepr, digest, relative_path, version, write_whole
from needleplan.config import (
    Choice,
    ConfigTable,
    Flag,
    Given,
    Integer,
    Keyed,
    Maybe,
    Number,
    ParentList,
    Rule,
    Subtable,
    TableList,
    Text,
    Texts,
    Violation,
    parse_toml,
    raw_of,
    ruled,
    text_of,
    toml_text,
    under,
)
from needleplan.errors import Mistake, ModelError
from needleplan.models._base import Model
from needleplan.models._estimates import Estimate
from needleplan.models._kinds import kind_of
from needleplan.models._parameter import Parameter
from needleplan.models.deflection import FibreSensors
from needleplan.models.effects import AddedEffect, AugmentedModel, Effect, effect_named
from needleplan.models.friction import LawCurves

__all__ = ["ModelFile"]

# Rule for all texts, and the rules for options by type.
_TEXT = Text(100_000)
_OPTIONS: dict[Any, Rule] = {
    bool: Flag(), int: Integer(-(2**63), 2**63 - 1), float: Number(), str: _TEXT,
    LawCurves | None: Maybe(Subtable(LawCurves)),
}  # fmt: skip

_Entry = tuple[float, Estimate | None]


@dataclass(frozen=True)
class _ParameterRule:
    """Rule for the table of one parameter: value, unit and, if the parameter was identified, its estimate.

    If `ordered`, an interval that does not contain the value is refused, and so is a negative sd. Effect tables may
    contain both.
    """

    what: Parameter
    ordered: bool = True

    def read(self, value: object) -> _Entry:
        """Return the value and its estimate, which is None if the parameter was not identified. Raises Violation."""
        if not isinstance(value, Mapping):
            raise Violation("must be a table with value and unit", value)
        unit, number = self.what.unit, Number(self.what.unit or "1", finite=False)
        rules: dict[str, Rule] = {
            "unit": Choice({unit: unit}),
            "value": number,
            "sd": number,
            "low": number,
            "high": number,
            "between_sd": number,
        }
        needed = ("value", "sd", "low", "high") if "sd" in value else ("value",)
        required = {"unit": f"must be {rules['unit']}"} | dict.fromkeys(needed, "")
        read = Keyed({**rules, "identified": Flag()}, required).read(value)
        if "sd" not in read:
            return read["value"], None
        low, high = read["low"], read["high"]
        if self.ordered and not (low <= read["value"] <= high and read["sd"] >= 0):
            rule = "must enclose the value, and sd must be 0 or more"
            raise Violation([Mistake("low, high", f"{low:g}, {high:g}", rule)])
        if self.ordered and read.get("between_sd", 0) < 0:
            raise Violation([Mistake("between_sd", f"{read['between_sd']:g}", "must be 0 or more")])
        known, between = read.get("identified", True), read.get("between_sd")
        return read["value"], Estimate(read["value"], read["sd"], low, high, unit, known, between)


@dataclass(frozen=True)
class _NameRule:
    """Rule for the name of a registered object; `find` returns the object or raises ModelError."""

    find: Callable[[str], Any]

    def read(self, value: object) -> Any:
        """Return the object with the name `value`. Raises Violation if there is none."""
        try:
            return self.find(_TEXT.read(value))
        except ModelError as error:
            raise Violation(error.mistakes[0].rule, value) from None


def _parameters_of(kind: type[Model] | Effect) -> Rule:
    """Return the rule for the table of all parameters of a model or an effect."""
    if isinstance(kind, Effect):
        return Keyed({name: _ParameterRule(parameter, ordered=False) for name, parameter in kind.parameters.items()})
    known = kind.parameters()
    return Keyed({name: _ParameterRule(parameter) for name, parameter in known.items()}, _required(kind, known))


def _options_of(kind: type[Model]) -> Rule:
    """Return the rule for the table of a model's options, which are the fields that are not parameters.

    Raises TypeError if a model file cannot hold the type of a field.
    """
    hints = get_type_hints(kind)
    rules: dict[str, Rule] = {}
    for name in _options(kind):
        hint = hints[name]
        enumeration = isinstance(hint, type) and issubclass(hint, StrEnum)
        if not enumeration and hint not in _OPTIONS:
            raise TypeError(f"{kind.__name__}.{name}: a model file cannot hold {hint}")
        rules[name] = Choice(hint) if enumeration else _OPTIONS[hint]
    return Keyed(rules, _required(kind, rules))


def _effect_holds(name: Effect, parameters: dict[str, _Entry]) -> Iterator[Mistake]:
    try:
        AddedEffect(name.name, {key: value for key, (value, _) in parameters.items()})
    except ModelError as error:
        yield from under("parameters", error.mistakes)


def _model_holds(kind: type[Model], parameters: dict[str, _Entry], options: dict[str, Any]) -> Iterator[Mistake]:
    try:
        kind(**{key: value for key, (value, _) in parameters.items()}, **options)
    except ModelError as error:
        yield from under("parameters", error.mistakes)


@dataclass(frozen=True, kw_only=True)
class _EffectTable(ConfigTable, key="effect", between=(_effect_holds,)):
    name: Effect = ruled(_NameRule(effect_named))
    version: str = ruled(_TEXT, "1")
    found_by: str = ruled(_TEXT, "")
    parameters: dict[str, _Entry] = ruled(Given("name", _parameters_of), factory=dict)

    @property
    def made(self) -> AddedEffect:
        """The effect that the table describes."""
        values, estimates = _split(self.parameters)
        return AddedEffect(self.name.name, values, estimates, self.found_by, self.version)


@dataclass(frozen=True, kw_only=True)
class _ModelTable(ConfigTable, error=ModelError, schema="needleplan.model/1", between=(_model_holds,)):
    kind: type[Model] = ruled(_NameRule(kind_of))
    title: str = ruled(_TEXT, "")
    made_by: str = ruled(_TEXT, "")
    remarks: tuple[str, ...] = ruled(Texts(), ())
    parent: tuple[Parent, ...] = ruled(ParentList(partial=True), ())
    parameters: dict[str, _Entry] = ruled(Given("kind", _parameters_of))
    options: dict[str, Any] = ruled(Given("kind", _options_of))
    effect: tuple[_EffectTable, ...] = ruled(TableList(_EffectTable), ())
    fibre: FibreSensors | None = ruled(Maybe(Subtable(FibreSensors)), None)


@dataclass(frozen=True)
class ModelFile(ShortRepr):
    """An identified model with the intervals of its parameters, its parents, and remarks of its identification.

    Parameters
    ----------
    model : Model
        The model, with or without effects.
    estimates : mapping of str to Estimate
        Estimates with intervals, by parameter name.
    parents : tuple of Parent
        Data from which the model was identified.
    remarks : tuple of str
        Remarks of the identification.
    title : str
        Title.
    made_by : str
        Program and version.
    fibre : FibreSensors or None
        Curvature sensors along the needle.
    folder : Path or None
        Folder of the file that was read, from which the files of the parents are named; None if it was not read.

    Examples
    --------
    >>> import needleplan as npl
    >>> written = npl.models.ModelFile(npl.models.Bicycle(curvature_per_mm=0.01), title="soft gel").to_toml()
    >>> npl.models.ModelFile.from_toml(written).model
    Bicycle(curvature_per_mm=0.01, heading_rad=0.0, offset_mm=0.0)
    """

    model: Model
    estimates: Mapping[str, Estimate] = field(default_factory=dict)
    parents: tuple[Parent, ...] = ()
    remarks: tuple[str, ...] = ()
    title: str = ""
    made_by: str = field(default_factory=lambda: f"needleplan {version()}")
    fibre: FibreSensors | None = None
    folder: Path | None = field(default=None, compare=False)

    @classmethod
    def of(cls, model: Model | ModelFile | str | os.PathLike[str]) -> ModelFile:
        """Return a ModelFile: made of a model, unchanged if `model` is a ModelFile, or read if `model` is a path.

        Raises ModelError for an argument of another type, and the errors of `read` for a path.
        """
        if isinstance(model, ModelFile):
            return model
        if isinstance(model, str | os.PathLike):
            return cls.read(model)
        if not isinstance(model, Model):
            rule = "must be a model of needleplan.models, a ModelFile, or the path of a model file"
            raise ModelError(Mistake("model", f"<{type(model).__name__}>", rule))
        return cls(model)

    @classmethod
    def read(cls, path: str | os.PathLike[str]) -> ModelFile:
        """Read a model file. Raises ModelError with every mistake, or if the file cannot be read."""
        file = cls.from_toml(text_of(path, ModelError), os.fspath(path))
        return replace(file, folder=Path(path).resolve().parent)

    def with_files(self, files: Mapping[str, str | os.PathLike[str]], folder: str | os.PathLike[str]) -> ModelFile:
        """Return the model file with the files of its parents.

        Parameters
        ----------
        files : mapping of str to path
            Files by the digest of their content.
        folder : path
            Folder in which the model file will be.

        Returns
        -------
        ModelFile
            With the path of each parent whose digest is known, relative to the folder.
        """
        parents = tuple(
            replace(parent, file=relative_path(files[parent.digest], folder)) if parent.digest in files else parent
            for parent in self.parents
        )
        return replace(self, parents=parents, folder=Path(folder).resolve())

    @classmethod
    def from_toml(cls, text: str, source: str = "") -> ModelFile:
        """Parse the text of a model file.

        Parameters
        ----------
        text : str
            Text of the file.
        source : str, optional
            Name of the text in messages.

        Returns
        -------
        ModelFile

        Raises
        ------
        ModelError
            The text is not TOML, or has mistakes. The error lists all of them.
        """
        read = parse_toml(text, _ModelTable, source)
        values, estimates = _split(read.parameters)
        model: Model = read.kind(**values, **read.options)
        if read.effect:
            model = AugmentedModel(model, tuple(effect.made for effect in read.effect))
        return cls(model, estimates, read.parent, read.remarks, read.title, read.made_by, read.fibre)

    def to_toml(self) -> str:
        """Return the model file as TOML text. `from_toml` of this text gives an equal `ModelFile`."""
        effects = self.model.effects if isinstance(self.model, AugmentedModel) else ()
        model = self.model.base if isinstance(self.model, AugmentedModel) else self.model
        kind = type(model)
        document = {
            "schema": _ModelTable.schema,
            "kind": kind.name,
            "title": self.title,
            "made_by": self.made_by,
            "remarks": self.remarks,
            "parameters": _raw_parameters(kind.parameters(), model.values(), self.estimates),
            "options": _raw_options(model),
            "fibre": raw_of(self.fibre) if self.fibre else {},
            "parent": [_raw_parent(parent) for parent in self.parents],
            "effect": [_raw_effect(effect) for effect in effects],
        }
        return toml_text({key: value for key, value in document.items() if value or key not in _MAY_LACK})

    def write(self, path: str | os.PathLike[str]) -> None:
        """Write the model file to `path`. Raises OutputError if that fails."""
        write_whole(path, self.to_toml().encode())

    @cached_property
    def digest(self) -> str:
        """SHA-256 of the text; files that are made with the model refer to the model by this digest."""
        return digest(self.to_toml())


_MAY_LACK = ("parameters", "options", "fibre", "parent", "effect")
"""Keys that a written file leaves out if their values are empty."""


def _raw_parent(parent: Parent) -> dict[str, str]:
    return {"name": parent.name, "digest": parent.digest} | ({"file": parent.file} if parent.file else {})


def _raw_effect(added: AddedEffect) -> dict[str, Any]:
    parameters = effect_named(added.name).parameters
    texts = {"name": added.name, "version": added.version, "found_by": added.found_by}
    return {**texts, "parameters": _raw_parameters(parameters, added.values, added.estimates)}


def _raw_parameters(
    parameters: Mapping[str, Parameter], values: Mapping[str, float], estimates: Mapping[str, Estimate]
) -> dict[str, dict[str, Any]]:
    raw: dict[str, dict[str, Any]] = {}
    for name, value in values.items():
        raw[name] = {"value": value, "unit": parameters[name].unit}
        if name in estimates:
            estimate = estimates[name]
            raw[name] |= {"sd": float(estimate.sd), "low": float(estimate.low), "high": float(estimate.high)}
            raw[name]["identified"] = bool(estimate.identified)
            if estimate.between_sd is not None:
                raw[name]["between_sd"] = float(estimate.between_sd)
    return raw


def _split(parameters: Mapping[str, _Entry]) -> tuple[dict[str, float], dict[str, Estimate]]:
    """Return the values and the estimates by parameter name; parameters without an estimate are only in the values."""
    values = {name: value for name, (value, _) in parameters.items()}
    return values, {name: each for name, (_, each) in parameters.items() if each}


def _options(kind: type[Model]) -> list[str]:
    return [entry.name for entry in fields(kind) if entry.name not in kind.parameters()]


def _raw_options(model: Model) -> dict[str, Any]:
    values = ((name, getattr(model, name)) for name in _options(type(model)))
    return {name: raw_of(each) if isinstance(each, ConfigTable) else each for name, each in values if each is not None}


def _required(kind: type[Model], names: Mapping[str, object]) -> dict[str, str]:
    """Return the names whose fields have no default, as the argument `required` of `Keyed`."""
    needed = (entry for entry in fields(kind) if entry.default is MISSING and entry.default_factory is MISSING)
    return {entry.name: "" for entry in needed if entry.name in names}
