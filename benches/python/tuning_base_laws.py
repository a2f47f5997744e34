"""Data sets for tuning with other base laws: the scenes of tests/blind, but another friction and cutting force.

The base of the diagnosis has an even friction along the shaft, and a cutting force that comes up as 1 - exp(-depth /
onset), acts while the tip advances, and does not depend on the speed. Here each of these laws is another one, by seed.
x is the place of a shaft element along the path, s its distance behind the tip, d the depth of the tip, w the onset, F
the axial force, and a the amplitude of the deviation, which differs between trials by up to 30 %.

| friction along the shaft | density, in units of the nominal one |
|---|---|
| even | 1 |
| deeper | (x / 40 mm)^a |
| near the tip | 1 + a exp(-s / length) |
| capstan | 1 + a F / (friction + cutting at 60 mm) while F pushes: a pressed shaft becomes wider |

| cutting force | share of the cutting force deep in the tissue |
|---|---|
| exponential | 1 - exp(-d / w) |
| ramp | min(d / 2w, 1) |
| algebraic | d / (d + w / 2) |
| late | 1 - exp(-(d / w)^2) |

The cutting force also has a power of the speed, averaged over half a millimetre, a power of the share of the load that
the tip carries after it has drawn back, and a part that resists the retraction too. Friction reverses by Dahl's law or
by one of the four of `tuning_foreign`. The nominal base is one of two, with more friction or with more cutting.

The generator for reporting (`second_generator`) was not looked at when these laws were chosen.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from unittest.mock import patch

import numpy as np
from tuning_foreign import LAWS, Scenery

from needleplan.models import ShaftAndTip
from tests.blind import base, force
from tests.blind.base import Scene
from tests.blind.campaign import HETEROGENEITY, LARGEST, LARGEST_OF, NAMEABLE
from tests.blind.contact import CENTRES_MM
from tests.blind.force import ForceSpec, Wanted
from tests.blind.motions import RICH, RICH_HELD_OUT, Array
from tests.blind.outside import TUNING
from tests.blind.recording import DataSet
from tests.blind.truth import Truth

FIRST_SEED = 40_000_000
STRATA = ("null", "single", "pair", "outside")
NOMINALS = (
    ShaftAndTip(friction=0.035, cutting=0.4, onset_mm=base.ONSET_MM, presliding_mm=0.12),
    ShaftAndTip(friction=0.015, cutting=1.0, onset_mm=base.ONSET_MM, presliding_mm=0.12),
)
FRICTION_LAWS = ("even", "deeper", "near the tip", "capstan")
CUTTING_LAWS = ("exponential", "ramp", "algebraic", "late")
_BLOCK = 10  # data sets in a row that share a nominal base
_SMALLEST = 0.5  # size of an effect, noise RMS
_DEPTH_MM, _FORCE_DEPTH_MM = 40.0, 60.0  # depth at which the friction is nominal; depth of the force of `capstan`
_SPEED_MM_S, _SPEED_TRAVEL_MM = 5.0, 0.5  # speed at which the cutting force is nominal; travel that averages it
_TRIAL_SHARE, _TRIALS = 0.3, 12  # difference between trials, as a share of the deviation; most trials


@dataclass(frozen=True)
class BaseLaw:
    """What a seed decides: the laws of friction and cutting, with their deviations by trial."""

    nominal: ShaftAndTip
    friction: str
    amplitude: Array
    """Amplitude a of the friction law by trial."""

    length_mm: float
    cutting: str
    speed_power: Array
    """Exponent of the speed by trial."""

    load_power: float
    wedge: float
    """Share of the cutting force that resists the retraction too."""

    scenery: Scenery

    @classmethod
    def drawn(cls, seed: int) -> BaseLaw:
        """Return the laws of a seed."""
        rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(10,)))
        friction = FRICTION_LAWS[seed % 4]
        low, high = {"even": (0.0, 0.0), "deeper": (-0.15, 0.25), "near the tip": (-0.3, 0.5), "capstan": (0.05, 0.25)}[
            friction
        ]
        each = 1 + _TRIAL_SHARE * rng.uniform(-1, 1, (2, _TRIALS))
        scenery = replace(Scenery.drawn(seed), law=("dahl", *LAWS)[seed % 5])
        return cls(
            NOMINALS[seed // _BLOCK % 2], friction, rng.uniform(low, high) * each[0], rng.uniform(5.0, 25.0),
            CUTTING_LAWS[seed // 4 % 4], rng.uniform(-0.04, 0.08) * each[1], rng.uniform(0.7, 1.5),
            rng.uniform(0.0, 0.1), scenery,
        )  # fmt: skip

    def force_n(self, scene: Scene) -> tuple[Array, Array]:
        """Return friction and cutting force as `tests.blind.base.base_force_n` does, with these laws."""
        contact, tissue = scene.contact, scene.specimen
        trials = scene.tip_mm.shape[1]
        a = self.amplitude[:trials]
        load = contact.covered_mm * contact.bristle * tissue.friction_n_mm
        if self.friction == "deeper":
            load = load * (np.maximum(CENTRES_MM, 0.5) / _DEPTH_MM) ** a[:, None]
        if self.friction == "near the tip":
            behind = np.maximum(scene.tip_mm[..., None] - CENTRES_MM, 0.0)
            load = load * (1 + a[:, None] * np.exp(-behind / self.length_mm))
        friction = load.sum(axis=2)
        local = np.stack(
            [np.interp(scene.tip_mm[:, r], CENTRES_MM, each) for r, each in enumerate(tissue.cutting_n)], axis=1
        )
        loaded = np.maximum(scene.loaded, 0.0) ** self.load_power
        cutting = local * self._onset(scene.tip_mm) * (loaded - self.wedge * (1 - loaded))
        cutting = cutting * (_smooth_speed(scene) / _SPEED_MM_S) ** self.speed_power[:trials]
        if self.friction == "capstan":
            usual = self.nominal.friction * _FORCE_DEPTH_MM + self.nominal.cutting
            friction = friction * (1 + a * np.maximum(friction + cutting, 0.0) / usual)
        return friction, cutting

    def _onset(self, tip_mm: Array) -> Array:
        depth = np.maximum(tip_mm, 0.0) / self.nominal.onset_mm
        return {
            "exponential": -np.expm1(-depth), "ramp": np.minimum(depth / 2, 1.0),
            "algebraic": depth / (depth + 0.5), "late": -np.expm1(-(depth**2)),
        }[self.cutting]  # fmt: skip


def _smooth_speed(scene: Scene) -> Array:
    """Return the speed averaged over the travel, (T, R): in a hold it stays what it was before."""
    speed = np.maximum(np.abs(scene.velocity_mm_s), 0.2)
    keep = np.exp(-np.abs(np.diff(scene.tip_mm, axis=0)) / _SPEED_TRAVEL_MM)
    found = np.full(speed.shape, _SPEED_MM_S)
    for k in range(1, len(found)):
        found[k] = keep[k - 1] * found[k - 1] + (1 - keep[k - 1]) * speed[k]
    return found


@contextmanager
def _installed(law: BaseLaw) -> Iterator[None]:
    """Let tests/blind generate with these laws and nominal numbers."""
    keep = force.NOISE_KEEP ** (law.scenery.every / 2)
    plain = base.specimen

    def specimen(*given: object) -> base.Specimen:
        found = plain(*given)  # type: ignore[arg-type]
        compliance, nominal = found.compliance, law.nominal
        longer = nominal.presliding_mm / base.PRESLIDING_MM
        return replace(
            found, friction_n_mm=found.friction_n_mm * nominal.friction / base.FRICTION_N_MM,
            cutting_n=found.cutting_n * nominal.cutting / base.CUTTING_N,
            compliance=replace(compliance, bristle_mm=compliance.bristle_mm * longer, give_mm=0.0 * compliance.give_mm),
        )  # fmt: skip

    force._known.clear()
    with (
        patch.object(force, "touch", law.scenery.touch), patch.object(force, "specimen", specimen),
        patch.object(force, "base_force_n", law.force_n), patch.object(force, "EVERY", law.scenery.every),
        patch.object(force, "NOISE_KEEP", keep), patch.object(force, "COLOUR", replace(force.COLOUR, keep=keep)),
    ):  # fmt: skip
        yield
    force._known.clear()


def spec(stratum: str, index: int) -> ForceSpec:
    """Return the specification of a data set; singles go through the effects of tests/blind, as do those outside."""
    seed = FIRST_SEED + 100_000 * STRATA.index(stratum) + index
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(3,)))
    names = {
        "null": (), "single": (NAMEABLE[index % len(NAMEABLE)],), "outside": (TUNING[index % len(TUNING)].NAME,),
        "pair": tuple(NAMEABLE[i] for i in rng.choice(len(NAMEABLE), 2, replace=False)),
    }[stratum]  # fmt: skip
    wanted = tuple(
        Wanted(name, float(np.exp(rng.uniform(np.log(_SMALLEST), np.log(LARGEST_OF.get(name, LARGEST))))))
        for name in names
    )
    return ForceSpec(seed, wanted, HETEROGENEITY[index // 3 % 3], RICH, RICH_HELD_OUT)


def generate(given: ForceSpec) -> tuple[DataSet, Truth]:
    """Return recordings and the truth about them."""
    with _installed(BaseLaw.drawn(given.seed)):
        return force.generate(given)


def nominal(given: ForceSpec) -> ShaftAndTip:
    """Return the base model that an analyst is given."""
    return BaseLaw.drawn(given.seed).nominal


def rate_hz(given: ForceSpec) -> int:
    """Return the sampling rate of a data set."""
    return 100 // BaseLaw.drawn(given.seed).scenery.every
