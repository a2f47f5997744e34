"""What every policy table can do, in the plane and in 3D."""

from __future__ import annotations

import os
from abc import abstractmethod
from pathlib import Path
from typing import TYPE_CHECKING, Any

from needleplan.errors import Mistake, OutputError, TableError
from needleplan.planning._poses import flag
from needleplan.planning._promise import PromisingTable

if TYPE_CHECKING:
    from typing import Self

    import xarray
    from matplotlib.axes import Axes
    from numpy.typing import ArrayLike

    from needleplan.planning._execution import Rollouts
    from needleplan.planning._lookup import Decisions
    from needleplan.planning._poses import Entry

__all__ = ["Table"]


class Table(PromisingTable):
    """A policy table: best action, expected cost and success probability at every pose of the tip.

    `needleplan.plan` and `needleplan.open` return one: a `PolicyTable` in the plane, where a pose has four numbers
    (`Pose`), or a `SpaceTable` in 3D, where it has six (`SpacePose`). Both have `scenario`, `stats` and these methods,
    whose results have the same attributes. A start is a pose, a sequence of its numbers, or an `Entry`.

    Examples
    --------
    >>> import needleplan as npl
    >>> table = npl.plan("four_obstacles")
    >>> entry = table.best_entry()
    >>> table.rollout(entry, runs=500).success > 0.5
    True
    """

    scenario: Any
    stats: Any

    @property
    @abstractmethod
    def digest(self) -> str:
        """SHA-256 of the scenario's digest and the arrays; other files refer to the table by this digest."""

    @abstractmethod
    def start(self, pose: Any) -> Any:
        """Return the pose at which an execution begins.

        Parameters
        ----------
        pose : Entry, Pose, SpacePose or sequence of float
            A pose, in the plane with or without bevel.

        Returns
        -------
        Pose or SpacePose
            The pose, checked and complete.

        Raises
        ------
        PoseError
            If it is no pose of this kind of table, or lies outside.

        Examples
        --------
        >>> import needleplan as npl
        >>> print(npl.plan("four_obstacles").start((0, 28, 0.3)))
        x 0 mm, y 28 mm, heading 17.19 deg, bevel -1
        """

    @abstractmethod
    def lookup(self, pose: Any, /) -> Any:
        """Return the decision at a pose.

        Parameters
        ----------
        pose : Entry, Pose, SpacePose or sequence of float
            Where the tip is; in the plane with bevel.

        Returns
        -------
        Decision or SpaceDecision
            Its `action`, `value` and `success`.

        Raises
        ------
        PoseError
            If it is no pose of this kind of table, or lies outside.

        Examples
        --------
        >>> import needleplan as npl
        >>> print(npl.plan("four_obstacles").lookup((40.0, 36.0, 0.1, -1)).action)
        rotate, then insert
        """

    @abstractmethod
    def lookup_many(self, poses: ArrayLike) -> Decisions:
        """Return the decisions at many poses.

        Parameters
        ----------
        poses : array_like of float, shape (n, 4) or (n, 6)
            Poses, one a row, or a DataFrame with a column for each number of a pose.

        Returns
        -------
        Decisions
            Arrays of the codes of actions, of expected costs and of success probabilities, shape (n,).

        Raises
        ------
        PoseError
            If it is no pose of this kind of table, or lies outside.

        Examples
        --------
        >>> import needleplan as npl
        >>> npl.plan("four_obstacles").lookup_many([(0, 28, 0.3, -1)]).value.shape
        (1,)
        """

    @abstractmethod
    def path(self, start: Any, *, noise_seed: int | None = None) -> Any:
        """Execute the policy once.

        Parameters
        ----------
        start : Entry, Pose, SpacePose or sequence of float
            Where the needle begins; in the plane with or without bevel.
        noise_seed : int, optional
            Seed of the tip noise. Without it, the execution has no noise.

        Returns
        -------
        Path or SpacePath
            Its `poses`, its `turns` (poses before rotations), `length_mm`, `cost`, `outcome`, `start`, `end`, `plot()`.

        Raises
        ------
        PoseError
            If it is no pose of this kind of table, or lies outside.

        Examples
        --------
        >>> import needleplan as npl
        >>> print(npl.plan("four_obstacles").path((0, 28, 0.3)).outcome)
        target
        """

    @abstractmethod
    def rollout(self, start: Any, runs: int = 10_000, seed: int = 0) -> Rollouts[Any]:
        """Execute the policy many times with tip noise.

        Parameters
        ----------
        start : Entry, Pose, SpacePose or sequence of float
            Where the needle begins; in the plane with or without bevel.
        runs : int, default 10_000
            Number of executions.
        seed : int, default 0
            Seed of the tip noise. The same seed gives the same runs on any number of threads.

        Returns
        -------
        Rollouts
            Success with its interval, outcomes, means, the predictions of the table, and some of the executions.

        Raises
        ------
        PoseError
            If it is no pose of this kind of table, or lies outside.

        Examples
        --------
        >>> import needleplan as npl
        >>> runs = npl.plan("four_obstacles").rollout((0, 28, 0.3), runs=500)
        >>> runs.interval[0] < runs.success < runs.interval[1]
        True
        """

    @abstractmethod
    def best_entry(self) -> Entry[Any]:
        """Return the best entry: in the plane of the left edge, in 3D of the entry region.

        Returns
        -------
        Entry
            Its `pose`, `success` and `value`.

        Examples
        --------
        >>> import needleplan as npl
        >>> npl.plan("four_obstacles").best_entry().success > 0.9
        True
        """

    @abstractmethod
    def entries(self, count: int = 5) -> list[Entry[Any]]:
        """Return the best entries that are at least 6 mm apart, best first.

        Parameters
        ----------
        count : int, default 5
            Largest number of entries.

        Returns
        -------
        list of Entry
            The first is `best_entry()`.

        Examples
        --------
        >>> import needleplan as npl
        >>> len(npl.plan("four_obstacles").entries(3))
        3
        """

    @abstractmethod
    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw the success probability with obstacles and target.

        Parameters
        ----------
        ax : matplotlib.axes.Axes, optional
            The axes to draw on. Without them a new pyplot figure is made.

        Returns
        -------
        matplotlib.axes.Axes
            The axes, in mm: of the workspace, or in 3D of the slice across z through the target.

        Examples
        --------
        >>> import needleplan as npl
        >>> from matplotlib.figure import Figure
        >>> npl.plan("four_obstacles").plot(Figure().subplots()).get_ylabel()
        'y (mm)'
        """

    @abstractmethod
    def to_xarray(self) -> xarray.Dataset:
        """Return the table as a labelled xarray dataset.

        Returns
        -------
        xarray.Dataset
            The variables `values`, `policy` and `success`; every coordinate has its unit.

        Raises
        ------
        InputError
            If xarray is not installed.

        Examples
        --------
        >>> import needleplan as npl
        >>> npl.plan("four_obstacles").to_xarray().success.dims
        ('x', 'y', 'heading', 'bevel')
        """

    def write(
        self,
        path: str | os.PathLike[str],
        *,
        sign_key: bytes | None = None,
        compressed: bool = False,
        force: bool = False,
    ) -> None:
        """Write the table to an HDF5 file. If this fails, an existing file is unchanged.

        Parameters
        ----------
        path : str or path
            The file to write.
        sign_key : bytes, optional
            Secret key of at least 16 bytes, with which the file is signed (HMAC-SHA256).
        compressed : bool, default False
            Compress the arrays without loss (gzip), to 0.2 to 0.4 times their size, in 0.1 s per million states.
        force : bool, default False
            Overwrite an existing file.

        Raises
        ------
        OutputError
            If the file exists and `force` is false, the file cannot be written, or the solve was not complete (in 3D).

        Examples
        --------
        >>> import needleplan as npl, tempfile
        >>> from pathlib import Path
        >>> table = npl.plan("four_obstacles")
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     table.write(Path(folder) / "table.h5")
        ...     npl.Table.read(Path(folder) / "table.h5").digest == table.digest
        True
        """
        if not flag("force", force) and isinstance(path, str | os.PathLike) and Path(path).is_file():
            raise OutputError(Mistake("", "", "exists already; force=True overwrites it"), os.fspath(path))
        self._write(path, sign_key, flag("compressed", compressed))

    @abstractmethod
    def _write(self, path: str | os.PathLike[str], key: bytes | None, compressed: bool) -> None:
        """Write the table; an existing file is replaced."""

    @classmethod
    def read(
        cls,
        path: str | os.PathLike[str],
        *,
        verify_key: bytes | None = None,
        isolated: bool | None = None,
        mapped: bool | None = None,
    ) -> Self:
        """Read a table from its HDF5 file and verify every byte.

        Parameters
        ----------
        path : str or path
            The file to read.
        verify_key : bytes, optional
            Secret key; a table that is not signed with this key is refused.
        isolated : bool, optional
            Whether a child process tries the file first, which takes 0.4 s: a crafted file may crash libhdf5. By
            default, a child process tries every file but those that `verify_key` verifies, and those whose bytes this
            process has written or tried before.
        mapped : bool, optional
            Whether a 3D table is verified in pieces and mapped into memory, so that it may be larger than memory.
            Default: if it needs more than half of the available memory. Its file may then be replaced or removed, but
            not changed in place. Compressed tables are always loaded.

        Returns
        -------
        Table
            The table; `PolicyTable.read` reads tables in the plane only, `SpaceTable.read` those in 3D.

        Raises
        ------
        TableError
            If the file is not a policy table, only part of one, or one of the other kind.
        ChecksumError
            If the file has changed since it was written, or is not signed with `verify_key`.

        Examples
        --------
        >>> import needleplan as npl
        >>> npl.PolicyTable.read("no.h5")
        Traceback (most recent call last):
        needleplan.errors.TableError: no.h5: cannot be read: No such file or directory
        """
        from needleplan.planning._read_table import read_content

        content = read_content(path, verify_key, isolated=isolated, mapped=mapped)
        try:
            tables = [table for kind in (cls, *cls.__subclasses__()) if (table := kind._of(content)) is not None]
        except TableError as error:
            raise TableError(error.mistakes, os.fspath(path)) from None
        if not tables:
            rule = f"is a table over {content.axes}, and no {cls.__name__}: `needleplan.open` opens it"
            raise TableError(rule, os.fspath(path))
        return tables[0]

    @classmethod
    def _of(cls, content: Any) -> Self | None:  # noqa: ARG003
        """Return the table of the content of a file, or None if it is of another class."""
        return None

    def moved_to(self, scenario: Any) -> Table:  # noqa: ARG002
        """Return this table in the frame of a scenario that differs in its curvature.

        Parameters
        ----------
        scenario : Scenario or SpaceScenario
            What is planned. In 3D, the first point of its lattice depends on the curvature.

        Returns
        -------
        Table
            A table whose poses are in the frame of `scenario`.

        Raises
        ------
        TableError
            If the axes or the spacing of the lattice differ.

        Examples
        --------
        >>> import needleplan as npl
        >>> table = npl.plan("four_obstacles")
        >>> table.moved_to(table.scenario) is table
        True
        """
        return self
