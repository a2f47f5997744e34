"""The lab twin and the models have one catalogue of effects: the same names, ranges and equations."""

import math
from dataclasses import fields

import numpy as np
import pytest

from needleplan.errors import SimulationError
from needleplan.models import SpatialBicycle, simulate
from needleplan.models.effects import LAB_EFFECTS, AddedEffect, known_effects, speed_factor, with_effect
from needleplan.signals import Motion
from needleplan.simulation import Effects, Robot, Setup
from needleplan.simulation._plant import Plant

CURVATURE_PER_MM = 1 / 100


def test_the_table_of_effects_is_the_catalogue() -> None:
    keys = [key for each in LAB_EFFECTS for key in each.keys]
    assert sorted(each.name for each in fields(Effects)) == sorted(keys)
    assert len({each.name for each in LAB_EFFECTS}) == len(LAB_EFFECTS)
    assert all(each.equation and what.about for each in LAB_EFFECTS for what in each.keys.values())


def test_an_effect_that_models_have_is_in_their_catalogue() -> None:
    known = known_effects()
    for each in LAB_EFFECTS:
        assert not each.same_law or each.model_effect == each.name
        assert not each.model_effect or each.model_effect in known
        assert each.model_effect or each.name not in known


def test_units_and_ranges_are_those_of_the_models() -> None:
    known = known_effects()
    for name, key in (("bias", "force_offset_n"), ("drift", "force_drift_n_s"), ("gain_error", "force_gain_error")):
        size = known[name].parameters["size"]
        Effects(**{key: size.upper})
        with pytest.raises(SimulationError, match=f"at most {size.upper:g}"):
            Effects(**{key: 1.01 * size.upper})


@pytest.mark.parametrize(
    ("effects", "name", "values"),
    [
        (Effects(pre_bend_per_mm=0.002), "pre_bend", {"size": 0.002, "direction_rad": math.pi / 2}),
        (Effects(sag_per_mm=0.0015, sag_fading_mm=60.0), "gravity", {"size": 0.0015, "fading_mm": 60.0}),
        (Effects(sag_per_mm=0.0015), "gravity", {"size": 0.0015, "fading_mm": 200.0}),
    ],
)
def test_the_path_of_the_twin_is_that_of_a_model_with_the_effect(
    effects: Effects, name: str, values: dict[str, float]
) -> None:
    """The needle goes in at 5 mm/s, turns by 2 rad at 20 mm, and goes on."""
    plant = Plant(Setup(CURVATURE_PER_MM, effects=effects, robot=Robot(servo_hz=400)))
    plant.insert(20.0, 5.0)
    rows = []
    for tick in range(400 * 16):
        if tick == 400 * 6:
            plant.rotate(2.0, 6.0)
        if tick == 400 * 8:
            plant.insert(50.0, 5.0)
        plant.step()
        rows.append((plant.now_s, plant.path_mm, plant.insertion.velocity, plant.roll.position))
    time, depth, velocity, angle = np.array(rows).T
    motion = Motion(time, depth, velocity, np.sign(velocity), angle)
    model = with_effect(SpatialBicycle(curvature_per_mm=CURVATURE_PER_MM), AddedEffect(name, values))
    modelled = simulate(model, motion).output[:, -1]
    plain = simulate(SpatialBicycle(curvature_per_mm=CURVATURE_PER_MM), motion).output[:, -1]
    tip = np.array(plant.tip().position_mm)
    assert np.abs(plain - modelled).max() > 0.5
    # In 3D the twin projects the weight on the frame of the tip; here the path stays close to the plane.
    assert np.abs(tip - modelled).max() < (0.04 if name == "gravity" else 0.01)
    assert np.linalg.norm(tip - modelled) < 0.03 * np.linalg.norm(plain - modelled)


def test_the_power_of_the_twin_and_the_slope_of_the_models_are_one_law() -> None:
    speeds = np.array([0.5, 2.0, 5.0, 10.0, 20.0])
    np.testing.assert_allclose(speed_factor(speeds, -0.25, -0.25), (speeds / 5) ** -0.25, rtol=1e-14)
    np.testing.assert_allclose(speed_factor(speeds, -0.25), 1 - 0.25 * (speeds / 5 - 1), rtol=1e-14)
    near = [(speed_factor(5 + 1e-4, 0.3, power) - 1) / (1e-4 / 5) for power in (0.3, 1.0)]
    np.testing.assert_allclose(near, 0.3, rtol=1e-4)
