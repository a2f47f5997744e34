"""Hidden effects between needle and tissue."""

from dataclasses import dataclass, replace
from typing import ClassVar, Self

import numpy as np
from scipy.special import expit

from tests.blind.base import Scene
from tests.blind.contact import CENTRES_MM, ELEMENTS, Compliance
from tests.blind.effect import Effect, ForceName, PlainEffect
from tests.blind.motions import STEP_S, Array


@dataclass(frozen=True)
class Puncture(Effect):
    """A membrane dents over rise_mm, bursts at depth_mm and lets go within release_mm; once, and only on the way in."""

    NAME: ClassVar = ForceName.PUNCTURE
    UNIT: ClassVar = "N"
    LARGEST: ClassVar = 3.0
    FIRST: ClassVar = 0.2
    depth_mm: float
    rise_mm: float
    release_mm: float

    @classmethod
    def drawn(cls, rng: np.random.Generator, reach_mm: float) -> Self:
        return cls(0.0, reach_mm * rng.uniform(0.25, 0.75), rng.uniform(2.5, 4.5), rng.uniform(0.3, 0.6))

    def load_n(self, scene: Scene, friction_n: Array, cutting_n: Array) -> Array:
        del friction_n, cutting_n
        behind = scene.tip_mm - self.depth_mm
        dent = np.clip(1.0 + behind / self.rise_mm, 0.0, 1.0) ** 1.5
        burst = np.exp(-np.maximum(scene.deepest_mm - self.depth_mm, 0.0) / self.release_mm)
        return self.size * dent * burst * scene.loaded


@dataclass(frozen=True)
class FrictionLayer(Effect):
    """More friction beyond depth_mm, over a soft edge."""

    NAME: ClassVar = ForceName.FRICTION_LAYER
    UNIT: ClassVar = "N/mm"
    LARGEST: ClassVar = 0.04
    FIRST: ClassVar = 0.005
    depth_mm: float
    edge_mm: float

    @classmethod
    def drawn(cls, rng: np.random.Generator, reach_mm: float) -> Self:
        return cls(0.0, reach_mm * rng.uniform(0.25, 0.65), rng.uniform(0.3, 0.8))

    def load_n(self, scene: Scene, friction_n: Array, cutting_n: Array) -> Array:
        del friction_n, cutting_n
        more = self.size * expit((CENTRES_MM - self.depth_mm) / self.edge_mm)
        return np.einsum("trn,trn,n->tr", scene.contact.covered_mm, scene.contact.bristle, more)


@dataclass(frozen=True)
class CuttingLayer(Effect):
    """More, or less, cutting force beyond depth_mm, over a soft edge."""

    NAME: ClassVar = ForceName.CUTTING_LAYER
    UNIT: ClassVar = "N"
    LARGEST: ClassVar = 1.2
    FIRST: ClassVar = 0.1
    depth_mm: float
    edge_mm: float

    @classmethod
    def drawn(cls, rng: np.random.Generator, reach_mm: float) -> Self:
        return cls(0.0, reach_mm * rng.uniform(0.25, 0.7), rng.uniform(0.2, 0.5))

    def load_n(self, scene: Scene, friction_n: Array, cutting_n: Array) -> Array:
        del friction_n, cutting_n
        return self.size * expit((scene.tip_mm - self.depth_mm) / self.edge_mm) * scene.loaded


@dataclass(frozen=True)
class FreshCutting(PlainEffect):
    """What has been cut needs less cutting: size is the share that falls away where the tip has been before."""

    NAME: ClassVar = ForceName.FRESH_CUTTING
    UNIT: ClassVar = "1"
    LARGEST: ClassVar = 1.0
    FIRST: ClassVar = 0.5

    def load_n(self, scene: Scene, friction_n: Array, cutting_n: Array) -> Array:
        del friction_n
        return -self.size * cutting_n * -np.expm1(-(scene.deepest_mm - scene.tip_mm) / 0.15)


@dataclass(frozen=True)
class CuttingDepth(PlainEffect):
    """The cutting force grows with the depth, a little less than in proportion."""

    NAME: ClassVar = ForceName.CUTTING_DEPTH
    UNIT: ClassVar = "N/mm"
    LARGEST: ClassVar = 0.03
    FIRST: ClassVar = 0.003

    def load_n(self, scene: Scene, friction_n: Array, cutting_n: Array) -> Array:
        del friction_n, cutting_n
        depth = np.maximum(scene.tip_mm, 0.0)
        return self.size * depth / (1.0 + depth / 400.0) * scene.loaded


@dataclass(frozen=True)
class Stribeck(Effect):
    """More friction at low speed: each element by its own slip."""

    NAME: ClassVar = ForceName.STRIBECK
    UNIT: ClassVar = "1"
    LARGEST: ClassVar = 2.0
    FIRST: ClassVar = 0.2
    speed_mm_s: float

    @classmethod
    def drawn(cls, rng: np.random.Generator, reach_mm: float) -> Self:
        del reach_mm
        return cls(0.0, rng.uniform(1.5, 4.0))

    def load_n(self, scene: Scene, friction_n: Array, cutting_n: Array) -> Array:
        del friction_n, cutting_n
        contact = scene.contact
        more = 1.0 / (1.0 + (scene.slip_mm_s / self.speed_mm_s) ** 2) ** 1.5
        density = scene.specimen.friction_n_mm
        return self.size * np.einsum("trn,trn,trn,rn->tr", more, contact.covered_mm, contact.bristle, density)


@dataclass(frozen=True)
class Bristle(Effect):
    """Bristles are longer than the base's by size on average; each element has its own length."""

    NAME: ClassVar = ForceName.BRISTLE
    UNIT: ClassVar = "mm"
    LARGEST: ClassVar = 4.0
    FIRST: ClassVar = 0.3
    LINEAR: ClassVar = False
    shares: tuple[float, ...]

    @classmethod
    def drawn(cls, rng: np.random.Generator, reach_mm: float) -> Self:
        del reach_mm
        return cls(0.0, tuple(rng.uniform(0.7, 1.3, ELEMENTS + 1).tolist()))

    def compliance(self, usual: Compliance) -> Compliance:
        return replace(usual, bristle_mm=usual.bristle_mm + self.size * np.array(self.shares))


@dataclass(frozen=True)
class TissueMotion(Effect):
    """The tissue is dragged along by the needle, by size at full friction, and lags behind it."""

    NAME: ClassVar = ForceName.TISSUE_MOTION
    UNIT: ClassVar = "mm"
    LARGEST: ClassVar = 6.0
    FIRST: ClassVar = 0.5
    LINEAR: ClassVar = False
    lag_s: float

    @classmethod
    def drawn(cls, rng: np.random.Generator, reach_mm: float) -> Self:
        del reach_mm
        return cls(0.0, rng.uniform(0.2, 0.8))

    def compliance(self, usual: Compliance) -> Compliance:
        if self.size == 0.0:
            return usual
        return replace(usual, give_mm=usual.give_mm + self.size, lag_s=self.lag_s)


@dataclass(frozen=True)
class Viscous(PlainEffect):
    """A drag in proportion to slip and covered length."""

    NAME: ClassVar = ForceName.VISCOUS
    UNIT: ClassVar = "N s/mm2"
    LARGEST: ClassVar = 0.006
    FIRST: ClassVar = 0.0003

    def load_n(self, scene: Scene, friction_n: Array, cutting_n: Array) -> Array:
        del friction_n, cutting_n
        return self.size * np.einsum("trn,trn->tr", scene.contact.covered_mm, scene.slip_mm_s)


@dataclass(frozen=True)
class Relaxation(Effect):
    """In a hold a share of the force is lost, on two times; it is back after some slip."""

    NAME: ClassVar = ForceName.RELAXATION
    UNIT: ClassVar = "1"
    LARGEST: ClassVar = 0.9
    FIRST: ClassVar = 0.2
    fast_s: float
    slow_s: float
    back_mm: float = 0.15

    @classmethod
    def drawn(cls, rng: np.random.Generator, reach_mm: float) -> Self:
        del reach_mm
        return cls(0.0, rng.uniform(0.3, 0.6), rng.uniform(1.5, 4.0))

    def load_n(self, scene: Scene, friction_n: Array, cutting_n: Array) -> Array:
        moved = np.abs(np.diff(scene.tip_mm, axis=0, prepend=scene.tip_mm[:1]))
        back = np.exp(-moved / self.back_mm)
        resting = moved < 0.05 * STEP_S
        lost = np.zeros_like(moved)
        for time_s, share in ((self.fast_s, 0.4), (self.slow_s, 0.6)):
            keep = np.exp(-STEP_S / time_s)
            value = np.zeros(moved.shape[1])
            for k in range(1, len(moved)):
                value = np.where(resting[k], keep * value + (1.0 - keep), back[k] * value)
                lost[k] += share * value
        return -self.size * lost * (friction_n + cutting_n)


@dataclass(frozen=True)
class Respiration(Effect):
    """The tissue moves along the path as a breathing patient's: long rests, short breaths. size: peak to peak."""

    NAME: ClassVar = ForceName.RESPIRATION
    UNIT: ClassVar = "mm"
    LARGEST: ClassVar = 15.0
    FIRST: ClassVar = 1.0
    LINEAR: ClassVar = False
    period_s: float
    phase_rad: float

    @classmethod
    def drawn(cls, rng: np.random.Generator, reach_mm: float) -> Self:
        del reach_mm
        return cls(0.0, rng.uniform(3.0, 5.0), rng.uniform(0, np.pi))

    def tissue_mm(self, time_s: Array) -> Array | None:
        if self.size == 0.0:
            return None
        return self.size * np.cos(np.pi * time_s / self.period_s + self.phase_rad) ** 4


@dataclass(frozen=True)
class PathDamage(PlainEffect):
    """Each element loses friction with the slip that it has seen, by a share of size in the end."""

    NAME: ClassVar = ForceName.PATH_DAMAGE
    UNIT: ClassVar = "1"
    LARGEST: ClassVar = 0.8
    FIRST: ClassVar = 0.2

    def load_n(self, scene: Scene, friction_n: Array, cutting_n: Array) -> Array:
        del friction_n, cutting_n
        contact = scene.contact
        seen = np.cumsum(np.abs(contact.slip_mm) * (contact.covered_mm > 0.0), axis=0)
        lost = -self.size * -np.expm1(-seen / 60.0)
        density = scene.specimen.friction_n_mm
        return np.einsum("trn,trn,trn,rn->tr", lost, contact.covered_mm, contact.bristle, density)


@dataclass(frozen=True)
class Bumps(Effect):
    """Air bubbles or knots at the same places in every pass, in both directions."""

    NAME: ClassVar = ForceName.BUMPS
    UNIT: ClassVar = "N"
    LARGEST: ClassVar = 1.5
    FIRST: ClassVar = 0.1
    depths_mm: tuple[float, ...]
    shares: tuple[float, ...]
    width_mm: float

    @classmethod
    def drawn(cls, rng: np.random.Generator, reach_mm: float) -> Self:
        count = int(rng.integers(2, 5))
        places = np.sort(reach_mm * rng.uniform(0.15, 0.85, count))
        shares = rng.uniform(0.5, 1.0, count) * rng.choice([-1.0, 1.0], count)
        return cls(0.0, tuple(places.tolist()), tuple(shares.tolist()), rng.uniform(1.2, 1.8))

    def load_n(self, scene: Scene, friction_n: Array, cutting_n: Array) -> Array:
        del friction_n, cutting_n
        bumps = sum(
            share / np.cosh((scene.tip_mm - place) / self.width_mm) ** 2
            for place, share in zip(self.depths_mm, self.shares, strict=True)
        )
        return self.size * bumps * scene.contact.tip
