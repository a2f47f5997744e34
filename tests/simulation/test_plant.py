"""The plant against closed forms, where its effects are absent, and one effect at a time."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from needleplan.models import Torsion, arc_step, simulate
from needleplan.models.friction import Profile
from needleplan.models.tissue import LumpedOnTissue, NeedlePush
from needleplan.scenario import EntryPose, Needle, Scenario
from needleplan.scenario import Layer as ScenarioLayer
from needleplan.signals import Array, Motion, lspb
from needleplan.simulation import Effects, Plant, Robot, Setup, Shaft, SimulatedEntry, SimulatedLayer, SimulatedTissue
from needleplan.simulation._axis import Trapezoid
from needleplan_thesis.chapter3.published import model_ii

FRICTION = replace(model_ii(1), profile=Profile.ISOSCELES, thickness_mm=150.0)


def inserted(setup: Setup, depth_mm: float = 60.0, velocity_mm_s: float = 20.0, seed: int = 0) -> Plant:
    plant = Plant(setup, seed)
    plant.insert(depth_mm, velocity_mm_s)
    settle(plant)
    return plant


def settle(plant: Plant, after_s: float = 0.3) -> None:
    while plant.moving:
        plant.step()
    for _ in range(round(after_s / plant.interval_s)):
        plant.step()


def driven(plant: Plant, seconds: float) -> tuple[Motion, Array]:
    """Return the true motion of the base and the force on it, tick by tick."""
    rows = []
    for _ in range(round(seconds / plant.interval_s)):
        plant.step()
        rows.append((plant.now_s, plant.insertion.position, plant.insertion.velocity, plant.force_n))
    time, depth, velocity, force = np.array(rows).T
    return Motion.sampled(time, depth, velocity), force


@pytest.mark.parametrize("roll", [0.0, math.pi])
def test_without_effects_the_tip_is_on_the_exact_arc(roll: float) -> None:
    entry = SimulatedEntry(x_mm=1.0, y_mm=30.0, heading_rad=0.2, depth_mm=-5.0, roll_rad=roll)
    plant = inserted(Setup(1 / 40, entry=entry), 80.0)
    x, y, heading = arc_step(1.0, 30.0, 0.2, math.cos(roll) / 40, plant.insertion.position)
    tip = plant.tip()
    assert tip.position_mm == pytest.approx((float(x), float(y), 0.0), abs=1e-9)
    assert tip.tangent == pytest.approx((math.cos(heading), math.sin(heading), 0.0), abs=1e-10)
    assert plant.insertion.position == pytest.approx(80.0, abs=1e-6)


def test_a_turn_on_the_way_makes_two_arcs() -> None:
    plant = inserted(Setup(1 / 40), 30.0)
    plant.rotate(math.pi, 6.0)
    settle(plant)
    turned = plant.insertion.position
    plant.insert(60.0, 20.0)
    settle(plant)
    first = arc_step(0.0, 0.0, 0.0, 1 / 40, turned)
    x, y, _ = arc_step(*first, -1 / 40, plant.insertion.position - turned)
    # Some micrometres of overshoot are cut before the turn.
    assert plant.tip().position_mm == pytest.approx((float(x), float(y), 0.0), abs=1e-3)


def test_the_profile_is_that_of_lspb() -> None:
    motion = lspb([0.0, 40.0], [10.0], blend_s=0.1, rate_hz=1000.0)
    trapezoid = Trapezoid.to(40.0, 10.0, 100.0, begin_s=0.0, position=0.0, velocity=0.0)
    for time, depth, velocity in zip(motion.time_s, motion.depth_mm, motion.velocity_mm_s, strict=True):
        assert trapezoid.at(time)[:2] == pytest.approx((depth, velocity), abs=1e-9)


@given(goal=st.floats(-50, 50), top=st.floats(0.5, 40), velocity=st.floats(-40, 40), acceleration=st.floats(5, 200))
def test_a_profile_ends_at_rest_at_its_goal_within_its_limits(
    goal: float, top: float, velocity: float, acceleration: float
) -> None:
    made = Trapezoid.to(goal, top, acceleration, begin_s=1.0, position=0.0, velocity=velocity)
    times = np.linspace(1.0, made.end_s + 0.1, 2000)
    x, v, a = np.array([made.at(time) for time in times]).T
    assert x[0] == pytest.approx(0, abs=1e-9)
    assert v[0] == pytest.approx(velocity, abs=1e-6)
    assert x[-1] == pytest.approx(goal, abs=1e-9)
    assert v[-1] == 0
    assert np.abs(a).max() <= acceleration * (1 + 1e-12)
    assert np.abs(v).max() <= max(top, abs(velocity)) * (1 + 1e-9)
    # Continuous: no step is longer than the largest speed allows.
    assert np.abs(np.diff(x)).max() <= max(top, abs(velocity)) * (times[1] - times[0]) * (1 + 1e-6) + 1e-9


def test_the_servo_follows_its_profile() -> None:
    for effects, bound in ((Effects(), 0.001), (Effects(encoder_step_mm=0.001, reaction_mm_s2_n=500.0), 0.004)):
        plant = Plant(Setup(1 / 40, friction=FRICTION, effects=effects))
        plant.insert(40.0, 10.0)
        motion = lspb([0.0, 40.0], [10.0], blend_s=0.1, rate_hz=1000.0)
        base, _ = driven(plant, 4.0)
        assert np.abs(base.depth_mm - motion.depth_mm[1:4001]).max() < bound


def test_the_force_is_that_of_the_friction_model() -> None:
    plant = Plant(Setup(0.0, friction=FRICTION))
    plant.insert(40.0, 10.0)
    motion, force = driven(plant, 5.0)
    model = simulate(FRICTION, motion).output
    # 0.1 mN: the normal force is looked up every 0.01 mm, where it grows by 40 uN.
    assert np.abs(force - model).max() < 1e-4
    assert force.max() > 0.1


def test_on_tissue_that_gives_way_as_well() -> None:
    friction = model_ii(1)
    effects = Effects(tissue_compliance_mm_n=4.0, tissue_relaxation_s=0.2)
    plant = Plant(Setup(0.0, friction=friction, effects=effects, entry=SimulatedEntry(depth_mm=0.0)))
    plant.insert(40.0, 10.0)
    motion, force = driven(plant, 4.0)
    values = {name: getattr(friction, name) for name in friction.parameters()}
    model = LumpedOnTissue(**values, stiffness=0.25, damping=0.05)
    slow = simulate(model, motion)
    assert np.abs(force - slow.output).max() < 0.01 * np.abs(slow.output).max()
    assert plant.tissue_mm == pytest.approx(float(slow.states[1, -1]), rel=0.01)
    assert plant.path_mm == pytest.approx(plant.insertion.position - plant.tissue_mm, abs=1e-2)


def test_layers_bend_cut_and_burst() -> None:
    setup = Setup(
        0.0,
        tissue=SimulatedTissue(curvature_per_mm=0.01, cutting_n=0.2),
        layers=(SimulatedLayer(20.0, curvature_per_mm=0.0, cutting_n=0.5, puncture_n=1.0, stretch_mm=2.0),),
    )
    plant = Plant(setup)
    plant.insert(40.0, 10.0)
    motion, force = driven(plant, 4.5)
    before = force[(motion.depth_mm > 1) & (motion.depth_mm < 20.0)]
    assert before == pytest.approx(np.full(before.size, 0.2), abs=1e-9)
    peak = int(np.argmax(force))
    assert force[peak] == pytest.approx(1.5, abs=0.02)
    assert motion.depth_mm[peak] == pytest.approx(22.0, abs=0.05)
    assert force[peak + 5] == pytest.approx(0.5, abs=1e-9)
    # The heading is that of an arc to where x = 20 mm, and straight from there on.
    assert math.asin(plant.tip().tangent[1]) == pytest.approx(math.asin(20.0 * 0.01), abs=1e-3)


def test_by_place_it_bends_as_the_scenario_says() -> None:
    scenario = replace(Scenario.read("four_obstacles"), obstacles=(), needle=Needle(40.0, (ScenarioLayer(30.0, 80.0),)))
    plant = inserted(Setup(1 / 40, scenario=scenario, entry=SimulatedEntry(y_mm=10.0)), 50.0)
    # 40 mm radius to x = 30 mm, then 80 mm.
    turned = math.asin(30.0 / 40.0)
    heading = turned + (plant.insertion.position - 40.0 * turned) / 80.0
    assert math.atan2(*plant.tip().tangent[1::-1]) == pytest.approx(heading, abs=0.25 / 80)


def test_drawn_back_it_returns_along_its_channel_and_a_turned_bevel_leaves_it() -> None:
    plant = inserted(Setup(1 / 40, effects=Effects(heading_noise_rad_sqrt_mm=0.01)), 40.0, seed=5)
    ahead = plant.frame_behind(20.0).position_mm
    end = plant.tip().position_mm
    plant.insert(20.0, 20.0)
    settle(plant)
    assert plant.tip().position_mm == pytest.approx(ahead, abs=1e-4)
    plant.insert(40.0, 20.0)
    settle(plant)
    assert plant.tip().position_mm == pytest.approx(end, abs=1e-4)
    plant.insert(20.0, 20.0)
    settle(plant)
    plant.rotate(math.pi, 6.0)
    settle(plant)
    plant.insert(40.0, 20.0)
    settle(plant)
    assert plant.frame_behind(20.0).position_mm == pytest.approx(ahead, abs=1e-3)
    assert plant.tip().position_mm[1] < end[1] - 5


def test_the_tip_lags_behind_the_base_by_what_torsion_says() -> None:
    shaft = Shaft(torsional_stiffness_n_mm2=1.5e4, length_mm=200.0)
    plant = inserted(Setup(1 / 40, shaft=shaft, effects=Effects(torsional_friction_n=0.05)))
    plant.rotate(math.pi, 6.0)
    settle(plant)
    lag = Torsion(1.5e4, 0.05).lag_rad(140.0, 60.0)
    # The servo overshoots by a fraction of a milliradian, and comes back without the tip.
    assert plant.roll.position - plant.tip_roll_rad == pytest.approx(lag, abs=6e-4)
    assert plant.torque_n_mm == pytest.approx(0.05 * 60.0, rel=0.02)


def test_insertion_releases_the_twist() -> None:
    shaft = Shaft(torsional_stiffness_n_mm2=1.5e4, length_mm=200.0)
    for release, kept in ((0.0, 1.0), (2.0, math.exp(-1))):
        effects = Effects(torsional_friction_n=0.05, torsional_release_mm=release)
        plant = inserted(Setup(1 / 40, shaft=shaft, effects=effects))
        plant.rotate(math.pi, 6.0)
        settle(plant)
        lag = plant.roll.position - plant.tip_roll_rad
        plant.insert(62.0, 20.0)
        settle(plant)
        assert plant.roll.position - plant.tip_roll_rad == pytest.approx(kept * lag, rel=0.03)


def test_the_push_of_the_needle_displaces_the_target() -> None:
    tissue = SimulatedTissue(curvature_per_mm=0.0, cutting_n=0.3)
    plant = inserted(Setup(0.0, tissue=tissue), 60.0)
    assert plant.target_mm((70.0, 3.0, 4.0)) == (70.0, 3.0, 4.0)
    soft = replace(tissue, shear_modulus_n_mm2=0.01)
    plant = inserted(Setup(0.0, tissue=soft, shaft=Shaft(radius_mm=0.5)), 60.0)
    expected = NeedlePush(0.01, 0.5).shift_mm(0.3, 0.0, 60.0, ahead_mm=10.0, aside_mm=5.0)
    assert expected > 0.1
    assert plant.target_mm((70.0, 3.0, 4.0)) == pytest.approx((70.0 + expected, 3.0, 4.0), abs=0.01 * expected)
    # Friction pushes too, and the tissue that it drags carries the target.
    setup = Setup(0.0, tissue=soft, friction=FRICTION, effects=Effects(tissue_compliance_mm_n=2.0))
    plant = Plant(setup)
    plant.insert(60.0, 20.0)
    for _ in range(2000):
        plant.step()
    assert plant.moving
    assert plant.tissue_mm > 0.1
    assert plant.target_mm((70.0, 3.0, 4.0))[0] > 70.0 + expected + 0.9 * plant.tissue_mm
    assert Plant(setup).target_mm((70.0, 3.0, 4.0)) == (70.0, 3.0, 4.0)


@pytest.mark.slow
def test_the_heading_walks_at_random() -> None:
    size, depth = 0.01, 60.0
    effects = Effects(heading_noise_rad_sqrt_mm=size)
    ends = [inserted(Setup(0.0, effects=effects), depth, 50.0, seed).tip().tangent for seed in range(40)]
    spread = np.array([tangent[1:] for tangent in ends]).std()
    # 80 numbers: their standard deviation is known to 8 %, and is within three of those.
    assert spread == pytest.approx(size * math.sqrt(depth), rel=0.25)


def test_breathing_moves_tip_and_target_but_not_the_base() -> None:
    effects = Effects(respiration_across_mm=3.0, respiration_period_s=4.0)
    plant = inserted(Setup(0.0, entry=SimulatedEntry(depth_mm=-1.0), effects=effects))
    rows = []
    for _ in range(4000):
        plant.step()
        rows.append((plant.tip().position_mm[1], plant.breath_mm[1], plant.insertion.position))
    tip, breath, base = np.array(rows).T
    assert np.ptp(tip) == pytest.approx(6.0, rel=1e-3)
    assert np.ptp(tip - breath) < 1e-9
    assert np.ptp(base) < 1e-6


@pytest.mark.parametrize("seed", [0, 1])
def test_half_the_servo_step_changes_little(seed: int) -> None:
    effects = Effects(
        curvature_scatter=0.1, heading_noise_rad_sqrt_mm=0.005, torsional_friction_n=0.02,
        tissue_compliance_mm_n=1.0, respiration_along_mm=1.0, reaction_mm_s2_n=500.0,
    )  # fmt: skip
    ends = []
    for rate in (1000, 2000):
        setup = Setup(
            1 / 40, friction=FRICTION, robot=Robot(servo_hz=rate), effects=effects, entry=SimulatedEntry(depth_mm=-2)
        )
        plant = inserted(setup, 40.0, 20.0, seed)
        ends.append(plant.tip().position_mm)
    assert math.dist(*ends) < 0.002


def test_the_entry_of_the_needle_scatters_around_its_pose_relative_to_the_guide() -> None:
    needle = EntryPose(heading_rad=0.05, offset_mm=0.4, heading_sd_rad=0.01, offset_sd_mm=0.2, side=1)
    entry = SimulatedEntry(0.0, 20.0, 0.1, depth_mm=-3.0, needle=needle, elevation_sd_rad=0.02)
    frames = []
    for seed in range(200):
        plant = Plant(Setup(0.01, entry=entry), seed)
        plant.step()
        assert plant.tip().tangent == pytest.approx((math.cos(0.1), math.sin(0.1), 0.0))
        frames.append(plant._path.start)
    heading = np.array([math.atan2(each.tangent[1], each.tangent[0]) for each in frames])
    aside = np.array(
        [(each.position_mm[1] - 20.0) * math.cos(0.1) - each.position_mm[0] * math.sin(0.1) for each in frames]
    )
    raised = np.array([math.asin(each.tangent[2]) for each in frames])
    for values, mean, sd in ((heading, 0.15, 0.01), (aside, 0.4, 0.2), (raised, 0.0, 0.02)):
        assert values.mean() == pytest.approx(mean, abs=4 * sd / math.sqrt(200))
        assert values.std() == pytest.approx(sd, rel=0.2)
    mirrored = SimulatedEntry(roll_rad=math.pi, needle=EntryPose(heading_rad=0.05)).tip_frame([0.0, 0.0, 0.0])
    assert mirrored.tangent[1] == pytest.approx(-math.sin(0.05))
