from dataclasses import replace

import numpy as np
import pytest

from needleplan.models import Channel, SpatialBeam, SpatialBicycle, simulate
from needleplan.models.deflection import ElasticTissue, tip_path_mm
from needleplan.models.effects import SIZE, Effect, Reach, effect_named, effects_of
from needleplan.signals import Motion, lspb
from tests.models.deflection.thesis import NEEDLE

GEL = ElasticTissue(3.87e-3)
FORCE_N = 0.02


def turned() -> Motion:
    motion = lspb([0, 30, 80], [6, 9], dwells_s=[2, 0], rate_hz=50)
    return replace(motion, angle_rad=np.clip(motion.time_s - 5.5, 0, 1) * np.pi)


def test_in_the_plane_it_is_the_law_of_the_path() -> None:
    motion = turned()
    model = SpatialBeam.of(NEEDLE, GEL, FORCE_N)
    reach = motion.depth_mm / model.rise_mm
    push = FORCE_N * np.cos(NEEDLE.bevel_angle_rad) * np.cos(motion.angle_rad) * (1 - (1 + reach) * np.exp(-reach))
    law = tip_path_mm(NEEDLE, GEL, motion.depth_mm, push)
    place = simulate(model, motion).output
    assert np.abs(law).max() > 0.5
    np.testing.assert_allclose(place[1], law, atol=1e-3)
    assert np.abs(np.diff(place[2])).max() > 1e-3  # on the way round it looks aside


def test_as_stiff_as_nothing_it_is_the_bicycle() -> None:
    motion = turned()
    beam = SpatialBeam(1 / 200, heading_y_rad=0.01, felt_mm=0.0, rise_mm=0.01)
    bicycle = SpatialBicycle(1 / 200, heading_y_rad=0.01)
    np.testing.assert_allclose(simulate(beam, motion).output, simulate(bicycle, motion).output, atol=0.01)


@pytest.mark.parametrize("effect", effects_of(Channel.TIP), ids=lambda each: each.name)
def test_effects_are_on_the_beam_too(effect: Effect) -> None:
    motion, beam = turned(), SpatialBeam(1 / 200)
    grid = effect.grid(Reach.of([motion]))
    values = {SIZE: effect.parameters[SIZE].typical, **grid[len(grid) // 2]}
    plain = simulate(beam, motion).output
    assert simulate(effect.apply(beam, {**values, SIZE: 0.0}), motion).output.tobytes() == plain.tobytes()
    assert np.abs(simulate(effect.apply(beam, values), motion).output - plain).max() > 1e-3


def test_a_tilted_beam_begins_at_the_entry() -> None:
    tilted = effect_named("misalignment").apply(SpatialBeam(1 / 200), {SIZE: 0.05, "direction_rad": 1.0})
    np.testing.assert_allclose(simulate(tilted, turned()).output[:, 0], 0.0, atol=1e-12)
