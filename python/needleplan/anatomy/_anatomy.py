"""An anatomy: the file, its volume, and the voxels of its regions, with every label checked."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from needleplan.anatomy._breathing import TissueMotion
from needleplan.anatomy._file import AnatomyFile, AnatomyRegions, Region, Sphere
from needleplan.anatomy._labels import label_number, read_color_table, read_volume
from needleplan.anatomy._volume import labels_present
from needleplan.artifacts import ShortRepr
from needleplan.config import read_toml
from needleplan.errors import Mistake, ScenarioError

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from needleplan.anatomy._volume import LabelVolume

__all__ = ["Anatomy"]


@dataclass(frozen=True, eq=False)
class Anatomy(ShortRepr):
    """A segmented volume, the meaning of its labels, and the settings of the plan.

    Parameters
    ----------
    file : AnatomyFile
        The settings.
    volume : LabelVolume
        The volume.
    names : dict
        Numbers of labels by name.
    source : str, optional
        Name of the anatomy file in messages. Default: no name.
    motion : TissueMotion, optional
        Motion of the tissue by breathing. Default: the tissue is at rest.
    exhaled : Anatomy, optional
        The anatomy at the end of an exhalation, as in the file. Default: this anatomy.
    balls : dict, optional
        The ball at this level of inspiration for each ball of the file that has moved. Default: no ball has moved.

    Raises
    ------
    ScenarioError
        If a label is unknown, has no voxel or contradicting meanings, a region lies outside the volume, target or
        entry region is an obstacle, or neither a thickness nor a margin keeps the needle from obstacles.
    """

    file: AnatomyFile
    volume: LabelVolume
    names: dict[str, int]
    source: str = ""
    motion: TissueMotion | None = None
    exhaled: Anatomy | None = None
    balls: Mapping[Sphere, Sphere] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.exhaled is not None:
            return  # it was checked
        mistakes: list[Mistake] = []
        regions = self.regions
        aims = zip(regions.aim_keys, ((aim.region,) for aim in regions.aims), strict=True)
        listed: list[tuple[str, tuple[Region, ...]]] = [
            ("obstacles", regions.obstacles), ("outside", regions.outside), *aims,
            *((key, (entrance.region,)) for key, entrance in regions.entrances.items()),
            ("curvature.label", tuple(tissue.label for tissue in regions.curvature)),
        ]  # fmt: skip
        present = {int(label) for label in labels_present(self.volume.labels)}
        for key, labels in listed:
            for label in labels:
                if isinstance(label, Sphere):
                    if not self.inside(label).any():
                        within = self.volume.voxels(label.center_mm)
                        is_outside = ((within < -0.5) | (within > np.array(self.volume.labels.shape) - 0.5)).any()
                        where = "lies outside of the volume, in RAS mm" if is_outside and regions.targets else ""
                        rule = where or "no voxel has its centre in this ball"
                        mistakes.append(Mistake(f"anatomy.{key}", str(label), rule))
                    continue
                try:
                    number = label_number(label, self.names, f"anatomy.{key}")
                except ScenarioError as error:
                    mistakes += error.mistakes
                    continue
                # A label of the table without voxels is no mistake for obstacles: this patient may have none.
                if number not in present and (key.startswith(("target", "entry")) or isinstance(label, int)):
                    mistakes.append(Mistake(f"anatomy.{key}", str(label), "no voxel of the volume has this label"))
        if not mistakes:
            mistakes = [*self._twice(), *self._overlaps()]
        if regions.obstacles and self.file.needle.thickness_mm is None and regions.largest_margin_mm == 0:
            rule = "is required where obstacles have no margin: set it or needle.gauge; 0 plans with a line"
            mistakes.append(Mistake("needle.diameter_mm", "", rule))
        if mistakes:
            raise ScenarioError(mistakes, self.source)

    @classmethod
    def read(cls, path: str | os.PathLike[str]) -> Anatomy:
        """Read an anatomy file, its volume and its colour table.

        Parameters
        ----------
        path : str or path
            The anatomy file (TOML). The names of the other files are relative to its folder.

        Returns
        -------
        Anatomy

        Raises
        ------
        ScenarioError
            If a file cannot be read or is damaged, or with the mistakes of the anatomy file.
        """
        return cls.of(read_toml(path, AnatomyFile), Path(path).parent, os.fspath(path))

    @classmethod
    def of(cls, file: AnatomyFile, folder: str | os.PathLike[str] = ".", source: str = "") -> Anatomy:
        """Read the volume and the colour table of an anatomy file.

        Parameters
        ----------
        file : AnatomyFile
            Contents of the anatomy file.
        folder : str or path, default "."
            Folder that the file names in `file` are relative to.
        source : str, optional
            Name of the anatomy file in messages.

        Returns
        -------
        Anatomy

        Raises
        ------
        ScenarioError
            A file cannot be read or is invalid, as in `read`.
        """
        folder = Path(folder)
        volume = read_volume(folder / file.anatomy.file)
        names = dict(volume.names)
        if file.anatomy.labels:
            names |= read_color_table(folder / file.anatomy.labels)
        if file.breathing is None:
            return cls(file, volume, names, source)
        try:
            motion = TissueMotion.read(file.breathing, names, folder)
        except ScenarioError as error:
            raise ScenarioError(error.mistakes, error.source or source) from None
        exhaled = cls(file, volume, names, source, motion)
        return exhaled.inspired(file.breathing.level)._required() if file.breathing.level else exhaled

    @cached_property
    def regions(self) -> AnatomyRegions:
        """The regions of the file; balls are where they are at this level of inspiration."""
        regions = self.file.anatomy

        def moved(region: Any) -> Any:
            return self.balls.get(region, region) if isinstance(region, Sphere) else region

        targets = tuple(replace(aim, region=moved(aim.region)) for aim in regions.targets)
        entries = tuple(replace(each, region=moved(each.region)) for each in regions.entries)
        target, entry = moved(regions.target), moved(regions.entry)
        return replace(regions, target=target, entry=entry, targets=targets, entries=entries)

    def inspired(self, level: float, near_mm: NDArray[np.float64] | None = None) -> Anatomy:
        """Return the anatomy at a level of inspiration, from 0 at the end of an exhalation to 1.

        Parameters
        ----------
        level : float
            Level of inspiration.
        near_mm : numpy.ndarray, optional
            Points in RAS (mm), shape (n, 3). The volume is cropped to their surroundings. Default: the whole volume.

        Returns
        -------
        Anatomy
        """
        assert self.motion is not None
        exhaled = self.exhaled or self
        regions = exhaled.file.anatomy
        named = [aim.region for aim in regions.aims] + [entrance.region for entrance in regions.entrances.values()]
        balls = [region for region in named if isinstance(region, Sphere)]
        centers = [ball.center_mm for ball in balls]
        volume, places = self.motion.moved(exhaled.volume, level, centers, near_mm)
        moved = {ball: replace(ball, center_mm=place) for ball, place in zip(balls, places, strict=True)}
        return replace(exhaled, volume=volume, exhaled=exhaled, balls=moved)

    def numbers(self, labels: tuple[str | int, ...]) -> list[int]:
        """Return the numbers of labels."""
        return [label_number(label, self.names, "anatomy") for label in labels]

    def inside(self, region: Region, *, touched: bool = False) -> NDArray[np.bool_]:
        """Return which voxels belong to a region.

        Parameters
        ----------
        region : str, int or Sphere
            Name or number of a label, or a ball in the coordinates of the volume (mm).
        touched : bool, default False
            If true, a ball contains every voxel that it may touch. By default, it contains the voxels with their centre
            in it.

        Returns
        -------
        numpy.ndarray
            Boolean, of the shape of the volume.
        """
        if not isinstance(region, Sphere):
            return np.asarray(self.volume.labels == label_number(region, self.names, "anatomy"))
        within = np.zeros(self.volume.labels.shape, bool)
        center = self.volume.voxels(region.center_mm)
        radius_mm = region.radius_mm + (float(np.linalg.norm(self.volume.sizes_mm)) / 2 if touched else 0.0)
        reach = radius_mm / self.volume.sizes_mm
        low = np.clip(np.floor(center - reach), 0, within.shape).astype(int)
        high = np.clip(np.ceil(center + reach) + 1, 0, within.shape).astype(int)
        box = tuple(slice(a, b) for a, b in zip(low, high, strict=True))
        indices = np.stack(np.meshgrid(*[np.arange(a, b) for a, b in zip(low, high, strict=True)], indexing="ij"), -1)
        far = np.linalg.norm(self.volume.world(indices) - np.array(region.center_mm), axis=-1)
        within[box] = far <= radius_mm
        return within

    def inside_entries(self, *, touched: bool = False) -> NDArray[np.bool_]:
        """Return which voxels belong to an entry region.

        Parameters
        ----------
        touched : bool, default False
            As for `inside`.

        Returns
        -------
        numpy.ndarray
            Boolean, of the shape of the volume.
        """
        parts = (self.inside(entrance.region, touched=touched) for entrance in self.regions.entrances.values())
        return np.asarray(np.logical_or.reduce(list(parts)))

    def entry_name(self, position_mm: ArrayLike) -> str:
        """Return the name of the entry region that is nearest to a point.

        Parameters
        ----------
        position_mm : array_like
            Entry point in RAS (mm), shape (3,).

        Returns
        -------
        str
        """

        def away_mm(region: Region) -> float:
            return float(np.linalg.norm(self.points(region) - np.asarray(position_mm), axis=-1).min())

        return min(self.regions.entrances.values(), key=lambda entrance: away_mm(entrance.region)).name

    def points(self, region: Region) -> NDArray[np.float64]:
        """Return the centres of the voxels of a region in RAS mm, shape (n, 3)."""
        return self.volume.world(np.argwhere(self.inside(region)))

    def _required(self) -> Anatomy:
        """Return this anatomy. Raises ScenarioError if breathing has moved a region out of the volume or of reach."""
        assert self.file.breathing is not None
        if mistakes := self._overlaps():
            listed = ", ".join(dict.fromkeys(f"{each.key} ({each.rule})" for each in mistakes))
            rule = f"moves a region away: {listed}"
            raise ScenarioError(Mistake("breathing.level", f"{self.file.breathing.level:g}", rule), self.source)
        return self

    def _twice(self) -> Iterator[Mistake]:
        """Yield the mistakes of labels that are named twice, by name and by number, with different meanings."""
        regions = self.regions
        first: dict[int, int] = {}
        for place, tissue in enumerate(regions.curvature, start=1):
            (number,) = self.numbers((tissue.label,))
            if first.setdefault(number, place) != place:
                rule = f"is the label of [[anatomy.curvature]] {first[number]} too"
                yield Mistake(f"anatomy.curvature {place}.label", str(tissue.label), rule)
        known: dict[int, str] = {}
        for key, aim in zip(regions.aim_keys, regions.aims, strict=True):
            if not isinstance(aim.region, Sphere):
                (number,) = self.numbers((aim.region,))
                if known.setdefault(number, aim.name) != aim.name:
                    rule = f'is the label of the target "{known[number]}" too'
                    yield Mistake(f"anatomy.{key}", str(aim.region), rule)
        closed = self.numbers(regions.obstacles)
        for label, number in zip(regions.outside, self.numbers(regions.outside), strict=True):
            if number in closed:
                yield Mistake("anatomy.outside", str(label), "is in anatomy.obstacles too")

    def _overlaps(self) -> list[Mistake]:
        """Return the mistakes of a target or entry region that lies in obstacles or outside."""
        regions, mistakes = self.regions, []
        for kind, labels in (("obstacles", regions.obstacles), ("outside", regions.outside)):
            closed = self.numbers(labels)
            aims = zip(regions.aim_keys, (aim.region for aim in regions.aims), strict=True)
            entrances = ((key, entrance.region) for key, entrance in regions.entrances.items())
            for key, region in (*aims, *entrances):
                labels_within = self.volume.labels[self.inside(region)]
                if np.isin(labels_within, closed).all():
                    rule = f"all of its voxels belong to anatomy.{kind}"
                    rule = rule if labels_within.size else "no voxel is left in the volume"
                    mistakes.append(Mistake(f"anatomy.{key}", str(region), rule))
        return mistakes
