"""Hidden effects between needle and tissue."""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from scipy.special import expit

from tests.blind.base import Scene
from tests.blind.contact import CENTRES_MM, ELEMENTS, Compliance
from tests.blind.effect import Effect, ForceName
from tests.blind.hidden import REACH, within
from tests.blind.motions import STEP_S, Array


@dataclass(frozen=True)
class Puncture(Effect, name=ForceName.PUNCTURE, unit="N", largest=3.0, first=0.2):
    """A membrane dents over rise_mm, bursts at depth_mm and lets go within release_mm; once, and only on the way in."""

    depth_mm: float = within(0.25, 0.75, of=REACH)
    rise_mm: float = within(2.5, 4.5)
    release_mm: float = within(0.3, 0.6)

    def load_n(self, scene: Scene, friction_n: Array, cutting_n: Array) -> Array:
        del friction_n, cutting_n
        behind = scene.tip_mm - self.depth_mm
        dent = np.clip(1.0 + behind / self.rise_mm, 0.0, 1.0) ** 1.5
        burst = np.exp(-np.maximum(scene.deepest_mm - self.depth_mm, 0.0) / self.release_mm)
        return self.size * dent * burst * scene.loaded


@dataclass(frozen=True)
class FrictionLayer(Effect, name=ForceName.FRICTION_LAYER, unit="N/mm", largest=0.04, first=0.005):
    """More friction beyond depth_mm, over a soft edge."""

    depth_mm: float = within(0.25, 0.65, of=REACH)
    edge_mm: float = within(0.3, 0.8)

    def load_n(self, scene: Scene, friction_n: Array, cutting_n: Array) -> Array:
        del friction_n, cutting_n
        more = self.size * expit((CENTRES_MM - self.depth_mm) / self.edge_mm)
        return np.einsum("trn,trn,n->tr", scene.contact.covered_mm, scene.contact.bristle, more)


@dataclass(frozen=True)
class CuttingLayer(Effect, name=ForceName.CUTTING_LAYER, unit="N", largest=1.2, first=0.1):
    """More, or less, cutting force beyond depth_mm, over a soft edge."""

    depth_mm: float = within(0.25, 0.7, of=REACH)
    edge_mm: float = within(0.2, 0.5)

    def load_n(self, scene: Scene, friction_n: Array, cutting_n: Array) -> Array:
        del friction_n, cutting_n
        return self.size * expit((scene.tip_mm - self.depth_mm) / self.edge_mm) * scene.loaded


@dataclass(frozen=True)
class FreshCutting(Effect, name=ForceName.FRESH_CUTTING, unit="1", largest=1.0, first=0.5):
    """What has been cut needs less cutting: size is the share that falls away where the tip has been before."""

    def load_n(self, scene: Scene, friction_n: Array, cutting_n: Array) -> Array:
        del friction_n
        return -self.size * cutting_n * -np.expm1(-(scene.deepest_mm - scene.tip_mm) / 0.15)


@dataclass(frozen=True)
class CuttingDepth(Effect, name=ForceName.CUTTING_DEPTH, unit="N/mm", largest=0.03, first=0.003):
    """The cutting force grows with the depth, a little less than in proportion."""

    def load_n(self, scene: Scene, friction_n: Array, cutting_n: Array) -> Array:
        del friction_n, cutting_n
        depth = np.maximum(scene.tip_mm, 0.0)
        return self.size * depth / (1.0 + depth / 400.0) * scene.loaded


@dataclass(frozen=True)
class Stribeck(Effect, name=ForceName.STRIBECK, unit="1", largest=2.0, first=0.2):
    """More friction at low speed: each element by its own slip."""

    speed_mm_s: float = within(1.5, 4.0)

    def load_n(self, scene: Scene, friction_n: Array, cutting_n: Array) -> Array:
        del friction_n, cutting_n
        contact = scene.contact
        more = 1.0 / (1.0 + (scene.slip_mm_s / self.speed_mm_s) ** 2) ** 1.5
        density = scene.specimen.friction_n_mm
        return self.size * np.einsum("trn,trn,trn,rn->tr", more, contact.covered_mm, contact.bristle, density)


@dataclass(frozen=True)
class Bristle(Effect, name=ForceName.BRISTLE, unit="mm", largest=4.0, first=0.3, linear=False):
    """Bristles are longer than the base's by size on average; each element has its own length."""

    shares: tuple[float, ...]

    @classmethod
    def drawn(cls, rng: np.random.Generator, reach_mm: float) -> Self:
        del reach_mm
        return cls(0.0, tuple(rng.uniform(0.7, 1.3, ELEMENTS + 1).tolist()))

    def compliance(self, usual: Compliance) -> Compliance:
        return replace(usual, bristle_mm=usual.bristle_mm + self.size * np.array(self.shares))


@dataclass(frozen=True)
class TissueMotion(Effect, name=ForceName.TISSUE_MOTION, unit="mm", largest=6.0, first=0.5, linear=False):
    """The tissue is dragged along by the needle, by size at full friction, and lags behind it."""

    lag_s: float = within(0.2, 0.8)

    def compliance(self, usual: Compliance) -> Compliance:
        if self.size == 0.0:
            return usual
        return replace(usual, give_mm=usual.give_mm + self.size, lag_s=self.lag_s)


@dataclass(frozen=True)
class Viscous(Effect, name=ForceName.VISCOUS, unit="N s/mm2", largest=0.006, first=0.0003):
    """A drag in proportion to slip and covered length."""

    def load_n(self, scene: Scene, friction_n: Array, cutting_n: Array) -> Array:
        del friction_n, cutting_n
        return self.size * np.einsum("trn,trn->tr", scene.contact.covered_mm, scene.slip_mm_s)


@dataclass(frozen=True)
class Relaxation(Effect, name=ForceName.RELAXATION, unit="1", largest=0.9, first=0.2):
    """In a hold a share of the force is lost, on two times; it is back after some slip."""

    fast_s: float = within(0.3, 0.6)
    slow_s: float = within(1.5, 4.0)
    back_mm: float = 0.15

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
class Respiration(Effect, name=ForceName.RESPIRATION, unit="mm", largest=15.0, first=1.0, linear=False):
    """The tissue moves along the path as a breathing patient's: long rests, short breaths. size: peak to peak."""

    period_s: float = within(3.0, 5.0)
    phase_rad: float = within(0, np.pi)

    def tissue_mm(self, time_s: Array) -> Array | None:
        if self.size == 0.0:
            return None
        return self.size * np.cos(np.pi * time_s / self.period_s + self.phase_rad) ** 4


@dataclass(frozen=True)
class PathDamage(Effect, name=ForceName.PATH_DAMAGE, unit="1", largest=0.8, first=0.2):
    """Each element loses friction with the slip that it has seen, by a share of size in the end."""

    def load_n(self, scene: Scene, friction_n: Array, cutting_n: Array) -> Array:
        del friction_n, cutting_n
        contact = scene.contact
        seen = np.cumsum(np.abs(contact.slip_mm) * (contact.covered_mm > 0.0), axis=0)
        lost = -self.size * -np.expm1(-seen / 60.0)
        density = scene.specimen.friction_n_mm
        return np.einsum("trn,trn,trn,rn->tr", lost, contact.covered_mm, contact.bristle, density)


@dataclass(frozen=True)
class Bumps(Effect, name=ForceName.BUMPS, unit="N", largest=1.5, first=0.1):
    """Air bubbles or knots at the same places in every pass, in both directions."""

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
