"""Plans for several targets of an anatomy, and the ranking of the entries for all of them.

**Assumption.** There is one insertion for each target, and all begin at the same entry point, each in the best
direction for its target, as with several cores of a biopsy. The needle is pulled out between two insertions, which
leaves the anatomy as it was, and their tip noise is independent.

**What targets share.** Target t has a decision process of its own: values, success p_t and policy depend on the target,
and an insertion does not go on from one target to the next, so nothing couples them. Lattice, blocked voxels, tissues,
distances and entry points are the same for all, and are made once.

**Ranking.** With p_1 ... p_k from an entry point, the expected number of targets that are reached is p_1 + ... + p_k,
and the probability that all are reached p_1 ... p_k.

**Order.** The most certain target first. Let an insertion that fails end the session, as a bleeding does. The expected
number of targets that are reached before is p_1 + p_1 p_2 + ... + p_1 ... p_k. If two neighbours of the order change
places, only one term changes, and it is larger with the larger probability first; so this order has the largest sum.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from needleplan.anatomy import SpaceScenario
from needleplan.artifacts import ShortRepr
from needleplan.errors import InputError, Mistake, ScenarioError
from needleplan.planning._space import EntryMap, SpaceEntry, entry_map
from needleplan.planning._space_limits import LENGTHS, LimitCount
from needleplan.planning._space_plan import plan_space
from needleplan.planning._space_ranking import COMPARED, EQUAL_SUCCESS, ESTIMATE_RUNS, UNREACHABLE, spread_out
from needleplan.planning._success import SuccessSource

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from needleplan.anatomy import Anatomy
    from needleplan.planning._lattice import Progress

__all__ = ["TargetEntry", "TargetMap", "rank_for_targets"]

# Smallest number of executions of an estimate for one of several targets: its standard error is below 1.4 points.
_LEAST_RUNS = 500
# Words that rank by all targets, beside the names of single targets.
EXPECTED, ALL = "expected", "all"


@dataclass(frozen=True)
class TargetEntry(ShortRepr):
    """An entry point for several targets, with one insertion for each.

    Parameters
    ----------
    number : int
        Number of the entry point in the map.
    position_mm : tuple of float
        Entry point in RAS mm.
    targets : dict
        The `SpaceEntry` of each target by its name, in the order of the insertions: the most certain first.
    expected_number, reached_all : float
        Expected number of targets that are reached, and probability that all are reached, from the exact poses.
    expected_interval, all_interval : tuple of float
        Intervals of both numbers, from the ends of the 95 % intervals of the targets. Their coverage is at least 95 %.
    score : float
        Number by which the entry is ranked. It includes an error of the entry, unless the ranking is by the exact pose.
    expected_before_failure : float
        Expected number of targets that are reached before the first insertion that fails.
    """

    number: int
    position_mm: tuple[float, float, float]
    targets: Mapping[str, SpaceEntry]
    expected_number: float
    expected_interval: tuple[float, float]
    reached_all: float
    all_interval: tuple[float, float]
    score: float
    expected_before_failure: float

    def record(self) -> dict[str, Any]:
        """Return the JSON record of the entry."""
        return {
            "position_mm": self.position_mm,
            "score": self.score,
            "expected_number": self.expected_number,
            "expected_number_interval": self.expected_interval,
            "reached_all": self.reached_all,
            "reached_all_interval": self.all_interval,
            "source": str(SuccessSource.EXECUTIONS),
            "expected_before_failure": self.expected_before_failure,
            "order": list(self.targets),
            "targets": {name: target.record() for name, target in self.targets.items()},
        }


@dataclass(frozen=True, eq=False)
class TargetMap(ShortRepr):
    """The entry points of an anatomy with several targets.

    Parameters
    ----------
    maps : dict
        The entry map of each target by its name. All have the same entry points in the same order.
    limits : tuple of LimitCount, optional
        How many entries each limit of the anatomy file leaves. Default: no limits.
    """

    maps: Mapping[str, EntryMap]
    limits: tuple[LimitCount, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the targets, in the order of the anatomy file."""
        return tuple(self.maps)

    @property
    def runs(self) -> int:
        """Number of executions for each target: 2,000 divided by the number of targets, at least 500."""
        return max(ESTIMATE_RUNS // len(self.maps), _LEAST_RUNS)

    @cached_property
    def success(self) -> NDArray[np.float64]:
        """Success by the tables, shape (targets, entry points)."""
        return np.asarray(np.clip([target_map.success for target_map in self.maps.values()], 0.0, 1.0), np.float64)

    @cached_property
    def cost(self) -> NDArray[np.float64]:
        """Sum of the costs for all targets by the tables, shape (entry points,)."""
        return np.asarray(np.sum([target_map.value for target_map in self.maps.values()], 0))

    @property
    def unreached(self) -> list[str]:
        """Names of the targets that no entry reaches in 0.1 % of executions by the table."""
        return [name for name, target_map in self.maps.items() if not target_map.reachable]

    def require_rank(self, rank: str) -> None:
        """Raise InputError unless `rank` is "expected", "all" or the name of a target."""
        if rank not in (EXPECTED, ALL, *self.maps):
            names = ", ".join(self.maps)
            raise InputError(Mistake("rank", rank, f"must be {EXPECTED}, {ALL} or the name of a target: {names}"))

    def scores(self, rank: str = EXPECTED) -> NDArray[np.float64]:
        """Return the score of each entry point by the tables, at its exact pose.

        Parameters
        ----------
        rank : str, default "expected"
            "expected": expected number of targets; "all": probability of all; or the name of a target: its success.

        Returns
        -------
        numpy.ndarray
            Shape (entry points,).

        Raises
        ------
        InputError
            If `rank` is neither.
        """
        self.require_rank(rank)
        return np.asarray(self._score(self.success, rank))

    def best(
        self, count: int, apart_mm: float = 6.0, *, rank: str = EXPECTED, exact: bool = False
    ) -> list[TargetEntry]:
        """Return the best entry points, best first.

        The tables propose at least five candidates by their scores; executions decide between them. Entries whose
        scores are equal to 0.001 are ordered by the smallest clearance and by the sum of the lengths.

        Parameters
        ----------
        count : int
            Number of entry points.
        apart_mm : float, default 6.0
            Smallest distance between two of them (mm).
        rank : str, default "expected"
            As in `scores`.
        exact : bool, default False
            Whether to rank by the exact poses. Default: by the success with an error of the entry.

        Returns
        -------
        list of TargetEntry

        Raises
        ------
        InputError
            If `rank` is neither.
        """
        entries = [
            self.entry(number, rank=rank, exact=exact)
            for number in self._candidates(max(count, COMPARED), apart_mm, rank)
        ]

        def key(entry: TargetEntry) -> tuple[float, float, float]:
            of_targets = entry.targets.values()
            return (
                -round(entry.score / EQUAL_SUCCESS),
                -round(min(one.clearance_mm for one in of_targets), 1),
                sum(one.length_mm for one in of_targets),
            )

        return sorted(entries, key=key)[:count]

    def entry(self, number: int, *, rank: str = EXPECTED, exact: bool = False) -> TargetEntry:
        """Return an entry point, with the success for each target by executions.

        Parameters
        ----------
        number : int
            Number of the entry point.
        rank, exact : optional
            As in `best`.

        Returns
        -------
        TargetEntry
        """
        self.require_rank(rank)
        of_targets = {name: target_map.entry(number, self.runs) for name, target_map in self.maps.items()}
        order = sorted(
            of_targets, key=lambda name: (-round(of_targets[name].success.value, 3), of_targets[name].length_mm)
        )
        intervals = [target.success.interval or (0.0, 1.0) for target in of_targets.values()]
        values = [of_targets[name].success.value for name in order]
        used = [target.success.value if exact else target.expected_success for target in of_targets.values()]
        return TargetEntry(
            number=number,
            position_mm=next(iter(of_targets.values())).position_mm,
            targets={name: of_targets[name] for name in order},
            expected_number=sum(values),
            expected_interval=(sum(low for low, _ in intervals), sum(high for _, high in intervals)),
            reached_all=math.prod(values),
            all_interval=(math.prod(low for low, _ in intervals), math.prod(high for _, high in intervals)),
            score=float(self._score(np.array(used), rank)),
            expected_before_failure=float(np.cumprod(values).sum()),
        )

    def _score(self, chances: NDArray[np.float64], rank: str) -> Any:
        """Return the scores of chances, shape (targets, ...)."""
        if rank in self.maps:
            return chances[self.names.index(rank)]
        return chances.prod(0) if rank == ALL else chances.sum(0)

    def _candidates(self, count: int, apart_mm: float, rank: str) -> list[int]:
        """Return the numbers of the best entry points by the tables, at least `apart_mm` from each other."""
        scores, points = self.scores(rank), next(iter(self.maps.values())).poses[:, :3]
        order = np.lexsort((self.cost, -np.round(scores / EQUAL_SUCCESS)))
        return spread_out(order[scores[order] >= UNREACHABLE].tolist(), points, count, apart_mm)


def rank_for_targets(anatomy: Anatomy, *, threads: int | None = None, progress: Progress | None = None) -> TargetMap:
    """Solve an anatomy for each of its targets, and return the map of its entries.

    Parameters
    ----------
    anatomy : Anatomy
        What is planned in.
    threads : int, optional
        Number of threads. Default: all processors.
    progress : callable, optional
        Called with reports of the solver of each target. Default: none.

    Returns
    -------
    TargetMap

    Raises
    ------
    ScenarioError
        If a target or the entry region is not on the lattice, or the tables do not fit into the memory.
    """
    scenarios = SpaceScenario.of_targets(anatomy)
    tables = {name: plan_space(scenario, threads=threads, progress=progress) for name, scenario in scenarios.items()}
    counts = next(iter(tables.values())).kept_entries.counts
    kept = [frozenset(map(tuple, table.entry_poses[:, :3].tolist())) for table in tables.values()]
    if len(set(kept)) > 1:
        # An entry keeps the limits of length for all targets.
        before = next(count.before for count in counts if count.key in LENGTHS)
        counts = tuple(count for count in counts if count.key not in LENGTHS)
        common = np.array(sorted(frozenset.intersection(*kept)), np.float64).reshape(-1, 3)
        counts += (LimitCount(f"{' and '.join(LENGTHS)} for all targets", len(common), before),)
        if not len(common):
            rule = f"leaves none of {before} entries: from each, the path to a target is longer"
            raise ScenarioError(Mistake(LENGTHS[0], "", rule), anatomy.source)
        tables = {name: replace(table, entry_points_mm=common) for name, table in tables.items()}
    return TargetMap({name: entry_map(table, threads=threads) for name, table in tables.items()}, counts)
