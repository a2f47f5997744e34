"""The table set: policy tables over the values of scenario keys, read from a store."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

from needleplan.anatomy import AnatomyFile
from needleplan.artifacts import CallRepr, short_html
from needleplan.config import plain, shown, suggestion
from needleplan.errors import InputError, Mistake, SweepError
from needleplan.planning import Table
from needleplan.scenario import Scenario
from needleplan.sweep._points import scenario_with
from needleplan.sweep._store import StoredPoint, TableSetStore
from needleplan.sweep._sweep import Design, Keep, Sweep
from needleplan.sweep._swept_parameter import record_unit, values_text, words_and_unit

if TYPE_CHECKING:
    import pandas
    import xarray

__all__ = ["TableSet", "TableSetEntry"]

# Relative difference up to which two numbers are the same value of a parameter.
_SAME = 1e-9


@dataclass(frozen=True)
class TableSetEntry(CallRepr):
    """One point of a table set: the values of its parameters, and the record of its table.

    Attributes
    ----------
    values : dict
        Value of each parameter.
    record : dict or None
        Numbers of the table, or None if the table is not made yet or has failed: `success`, `cost`, `entry_x_mm`,
        `entry_y_mm`, `entry_heading_rad` and `entry_bevel` of the best entry; `reached`, `length_mm`, `rotations` and
        `clearance_mm` of the path from there without noise; `start_success` and `start_cost` of the fixed pose of the
        sweep; `status`, `states`, `seconds`, `digest`, `bytes`.
    """

    values: dict[str, Any]
    record: dict[str, Any] | None
    _store: TableSetStore = field(repr=False)
    _point: StoredPoint = field(repr=False)

    @property
    def why(self) -> str:
        """The rule that the values break, so that there is no table; empty if they break none."""
        return self._point.why

    def table(self) -> Table:
        """Read the policy table. Raises SweepError if there is none, and TableError if its file is damaged."""
        file = self._store.table_path(self._point.address) if self._point.address else None
        if file is None or not file.exists():
            kept = self._store.sweep.keep is Keep.TABLES
            missing = "it is not made yet, or its solve failed: `needleplan sweep` makes it, or says why it cannot"
            why = self.why or (missing if kept else "the sweep keeps records only")
            raise SweepError(
                f"the table for {values_text(self.values)} is not there: {why}", os.fspath(self._store.folder)
            )
        return Table.read(file)


@dataclass(frozen=True, repr=False)
class TableSet(Sequence[TableSetEntry]):
    """Policy tables over the values of scenario keys; a sequence of `TableSetEntry`.

    Parameters
    ----------
    sweep : Sweep
        The sweep of the table set.
    entries : sequence of TableSetEntry
        The points of the table set, or of a selection.

    Examples
    --------
    >>> import tempfile
    >>> import needleplan as npl
    >>> from needleplan.sweep import Engine, Sweep, SweptParameter, make_table_set
    >>> radius = SweptParameter("needle.curvature_radius_mm", values=[35.0, 45.0])
    >>> grid = SweptParameter("grid.spacing_mm", values=[[4.0, 4.0]])
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     report = make_table_set(Sweep("four_obstacles", [radius, grid]), folder, Engine(workers=0))
    ...     table_set = npl.TableSet.open(folder)
    ...     table = table_set.table(curvature_radius_mm=45.0)
    ...     damaged = table_set.damaged()
    >>> damaged
    {}
    >>> table_set
    <TableSet: 2 of 2 tables over curvature_radius_mm, spacing_mm>
    >>> table.scenario.needle.curvature_radius_mm
    45.0
    >>> next(table_set.scenarios()).needle.curvature_radius_mm
    35.0
    >>> len(table_set.select(curvature_radius_mm=(30.0, 40.0)))
    1
    >>> table_set.to_pandas().columns[:3].tolist()
    ['curvature_radius_mm', 'spacing_mm', 'table']
    >>> rotation = SweptParameter("objective.rotation", values=[2.0, 8.0])
    >>> sweep = Sweep("four_obstacles", [radius, rotation, SweptParameter("grid.spacing_mm.x", values=[4.0])])
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     report = make_table_set(sweep, folder, Engine(workers=0))
    ...     dict(npl.TableSet.open(folder).to_xarray().sizes)
    {'curvature_radius_mm': 2, 'rotation': 2, 'x': 1}
    """

    sweep: Sweep
    entries: tuple[TableSetEntry, ...]

    @classmethod
    def open(cls, folder: str | os.PathLike[str]) -> TableSet:
        """Open the folder of a table set, also while tables are added; tables that are added later are not seen.

        Parameters
        ----------
        folder : str or path
            A folder that `needleplan sweep` has made.

        Returns
        -------
        TableSet

        Raises
        ------
        SweepError
            If the folder is no table set.
        """
        store = TableSetStore.open(folder)
        records, there = store.records(), store.there()
        if store.sweep.keep is Keep.TABLES:
            records = {address: record for address, record in records.items() if address in there}
        entries = (TableSetEntry(point.values, records.get(point.address), store, point) for point in store.points)
        return cls(store.sweep, tuple(entries))

    def __len__(self) -> int:
        return len(self.entries)

    def __getitem__(self, index: Any) -> Any:
        return self.entries[index]

    def __iter__(self) -> Iterator[TableSetEntry]:
        return iter(self.entries)

    _repr_html_ = short_html

    def __repr__(self) -> str:
        made = sum(entry.record is not None for entry in self.entries)
        name = f' "{self.sweep.title}"' if self.sweep.title else ""
        return f"<TableSet{name}: {made} of {len(self)} tables over {', '.join(self.parameters)}>"

    @cached_property
    def parameters(self) -> tuple[str, ...]:
        """Names of the parameters."""
        return tuple(parameter.title for parameter in self.sweep.parameters)

    def select(self, *, nearest: bool = False, **values: Any) -> TableSet:
        """Return the part of the table set with given values.

        Parameters
        ----------
        nearest : bool, default False
            For each number, take the nearest value of the table set instead of exactly this one.
        **values
            Values by the name of the parameter: a value, or a pair (low, high) of numbers as a tuple for a range.

        Returns
        -------
        TableSet
            Empty if no point has these values.

        Raises
        ------
        SweepError
            If there is no parameter of a name, a parameter of numbers gets another value, or a range is empty.
        """
        unknown = [name for name in values if name not in self.parameters]
        if unknown:
            rule = f"is no parameter of this table set ({', '.join(self.parameters)})"
            raise SweepError([Mistake(name, "", rule + suggestion(name, self.parameters)) for name in unknown])
        entries: Sequence[TableSetEntry] = self.entries
        wrong = {name: self._wrong(name, value) for name, value in values.items()}
        if any(wrong.values()):
            raise SweepError([Mistake(name, shown(values[name]), rule) for name, rule in wrong.items() if rule])
        for name, value in values.items():
            if nearest and plain(value) is not None:
                value = self._nearest(name, float(value))
            entries = [entry for entry in entries if _matches(entry.values[name], value)]
        return TableSet(self.sweep, tuple(entries))

    def table(self, **values: Any) -> Table:
        """Read the one policy table with given values.

        Parameters
        ----------
        **values
            As for `select`.

        Returns
        -------
        Table

        Raises
        ------
        SweepError
            If the values select no table or several tables.
        TableError
            If the file of the table is damaged.
        """
        selection = self.select(**values)
        if len(selection) != 1:
            given = ", ".join(f"{name} = {shown(value)}" for name, value in values.items()) or "no values"
            rule = f"selects {len(selection)} tables, not 1; the parameters are {', '.join(self.parameters)}"
            raise SweepError(Mistake("", given, rule))
        entry: TableSetEntry = selection[0]
        return entry.table()

    def damaged(self, progress: Callable[[int, int], None] = lambda *_: None) -> dict[str, str]:
        """Read all tables that are made, and return what is wrong with the damaged ones.

        Parameters
        ----------
        progress : callable, optional
            Called with the number of tables that were read and that of all tables.

        Returns
        -------
        dict of str
            Why a table cannot be used, by its values as text; empty if all tables are whole.
        """
        wrong: dict[str, str] = {}
        made = [] if self.keeps_records_only else [entry for entry in self.entries if entry.record]
        for number, entry in enumerate(made, start=1):
            try:
                if entry.table().digest != (entry.record or {}).get("digest"):
                    wrong[values_text(entry.values)] = "the table is not the one that was recorded"
            except InputError as error:
                wrong[values_text(entry.values)] = str(error)
            progress(number, len(made))
        return wrong

    @property
    def keeps_records_only(self) -> bool:
        """Whether the sweep stores records without tables."""
        return self.sweep.keep is Keep.RECORDS

    def scenarios(self) -> Iterator[Scenario | AnatomyFile | None]:
        """Yield the scenario, or the anatomy file, of each point; None if its values break a rule.

        Returns
        -------
        iterator of Scenario, AnatomyFile or None

        Raises
        ------
        ScenarioError
            If the file of the sweep cannot be read any more.
        """
        problems = self.sweep.problems()
        for entry in self.entries:
            yield scenario_with(problems, self.sweep, entry.values)

    def to_pandas(self) -> pandas.DataFrame:
        """Return the values and records of all points as a pandas data frame, one row per point.

        Returns
        -------
        pandas.DataFrame
            The parameters, then the numbers of the records; missing ones are NaN.

        Raises
        ------
        InputError
            If pandas is not installed.
        """
        try:
            import pandas
        except ImportError:
            raise SweepError(Mistake("to_pandas", "", "needs pandas: `pip install pandas`")) from None
        return pandas.DataFrame([{**entry.values, **(entry.record or {})} for entry in self.entries])

    def to_xarray(self) -> xarray.Dataset:
        """Return the records as a labelled xarray dataset over the parameters.

        Returns
        -------
        xarray.Dataset
            One dimension per parameter for the design "product", else the dimension `point`. Missing numbers are NaN.
            Values that are lists, such as those of `grid.spacing_mm`, become texts. Units are in the attribute `units`.

        Raises
        ------
        SweepError
            If xarray is not installed.
        """
        try:
            import xarray
        except ImportError:
            rule = "needs xarray: install it with `pip install needleplan[xarray]`"
            raise SweepError(Mistake("to_xarray", "", rule)) from None
        names = sorted(
            {name for entry in self.entries for name, value in (entry.record or {}).items() if _number(value)}
        )
        columns = {name: [_float((entry.record or {}).get(name)) for entry in self.entries] for name in names}
        values_of = {name: [_coordinate(entry.values[name]) for entry in self.entries] for name in self.parameters}
        levels = {name: list(dict.fromkeys(values)) for name, values in values_of.items()}
        shape = tuple(map(len, levels.values()))
        if self.sweep.design is Design.PRODUCT and math.prod(shape) == len(self.entries):
            import numpy as np

            data = xarray.Dataset(
                {name: (tuple(levels), np.reshape(values, shape)) for name, values in columns.items()}, coords=levels
            )
        else:
            coordinates = {name: ("point", values) for name, values in values_of.items()}
            data = xarray.Dataset({name: ("point", values) for name, values in columns.items()}, coords=coordinates)
        self._describe(data)
        return data

    def _describe(self, data: xarray.Dataset) -> None:
        """Give the dataset its title, and its variables their units."""
        data.attrs["title"] = self.sweep.title
        units = {name: record_unit(str(name)) for name in data.data_vars}
        units |= {parameter.title: words_and_unit(parameter)[1] for parameter in self.sweep.parameters}
        for name, unit in units.items():
            if unit:
                data[name].attrs["units"] = unit

    def _wrong(self, name: str, value: Any) -> str:
        """Return why no point can have a value of a parameter, or an empty text."""
        if any(plain(entry.values[name]) is None for entry in self.entries):  # texts, lists, true and false
            return ""
        if isinstance(value, tuple) and len(value) == 2 and all(plain(limit) is not None for limit in value):
            return "" if value[0] <= value[1] else "must be a range from a lower to a higher number"
        return "" if plain(value) is not None else "must be a number, or a pair of numbers as a tuple for a range"

    def _nearest(self, name: str, value: float) -> Any:
        known = [entry.values[name] for entry in self.entries if plain(entry.values[name]) is not None]
        return min(known, key=lambda candidate: abs(candidate - value), default=value)


def _matches(value: Any, wanted: Any) -> bool:
    """Return whether a value of a parameter equals the wanted one, or lies in the wanted range (a tuple of numbers)."""
    if _number(value) and isinstance(wanted, tuple) and len(wanted) == 2:
        return bool(wanted[0] <= value <= wanted[1])
    if _number(value) and plain(wanted) is not None:
        return math.isclose(value, float(wanted), rel_tol=_SAME, abs_tol=0.0)
    return bool(value == wanted or (isinstance(value, list) and tuple(value) == wanted))


def _coordinate(value: Any) -> Any:
    return str(list(value)) if isinstance(value, list | tuple) else value


def _number(value: Any) -> bool:
    return isinstance(value, int | float)


def _float(value: Any) -> float:
    return float(value) if _number(value) else math.nan
