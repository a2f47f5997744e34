"""The next motion for a tip's path, after insertions without rotation."""

from __future__ import annotations

import numpy as np
import pytest

from needleplan.diagnosis import Diagnosis, Library, Verdict, diagnose
from needleplan.diagnosis.next_motion import Separating, next_motion
from needleplan.models import simulate
from needleplan.models.effects import effect_named
from needleplan.signals import Motion, Record, Role, lspb
from tests.diagnosis.tip_trials import BASE, NOISE_MM, RATE_HZ

RIVALS = ("entry_rupture", "misalignment", "coil_behind", "curvature_layer")
HIDDEN = effect_named("entry_rupture").apply(BASE, {"size": 3.0, "length_mm": 1.0})


def straight(speed_mm_s: float) -> Motion:
    return lspb([0, 70], [speed_mm_s], dwells_s=[1], rate_hz=RATE_HZ)


def recorded(path: Motion, generator: np.random.Generator, role: Role) -> Record:
    x, y, z = simulate(HIDDEN, path).output + NOISE_MM * generator.standard_normal((3, len(path)))
    columns = {"time_s": path.time_s, "depth_mm": path.depth_mm, "velocity_mm_s": path.velocity_mm_s}
    return Record({**columns, "angle_rad": path.angle_rad, "x_mm": x, "y_mm": y, "z_mm": z}, str(path.time_s[-1]), role)


@pytest.fixture(scope="module")
def trials() -> list[Record]:
    """Return two insertions at one speed and a held-out one at another, all with the bevel to one side."""
    generator = np.random.default_rng(7)
    found = [recorded(straight(5), generator, Role.TRAIN), recorded(straight(5), generator, Role.TRAIN)]
    found.append(recorded(straight(8), generator, Role.HOLDOUT))
    time = np.arange(600) / RATE_HZ
    x, y, z = NOISE_MM * generator.standard_normal((3, 600))
    still = {"time_s": time, "depth_mm": np.zeros(600), "x_mm": x, "y_mm": y, "z_mm": z}
    return [*found, Record(still, "noise", Role.NOISE)]


@pytest.fixture(scope="module")
def library() -> Library:
    return Library([effect_named(name) for name in RIVALS], BASE)


@pytest.fixture(scope="module")
def undecided(trials: list[Record], library: Library) -> Diagnosis:
    found = diagnose(BASE, trials, library=library)
    assert found.verdict is Verdict.AMBIGUOUS
    assert {"entry_rupture", "misalignment"} <= set(found.decision.tied)
    return found


@pytest.mark.slow
def test_it_turns_the_bevel_before_the_entry_and_decides(
    undecided: Diagnosis, trials: list[Record], library: Library
) -> None:
    """A rupture bends to where the bevel looks, a base that is not aligned does not: a bevel turned first tells."""
    proposed = next_motion(undecided)
    assert isinstance(proposed, Separating)
    assert proposed.program.name.startswith("turned")
    assert proposed.resolves > 0.95
    assert proposed.repeated_resolves < 0.05
    assert {each.true for each in proposed.separations} == set(undecided.decision.tied)
    more = recorded(proposed.motion, np.random.default_rng(8), Role.TRAIN)
    after = diagnose(BASE, [more, *trials], library=library)
    assert (after.verdict, after.names) == (Verdict.NAMED, ("entry_rupture",))
