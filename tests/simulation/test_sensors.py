import math
from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest

from needleplan.devices import Health, PoseSample
from needleplan.models.deflection import FibreSensors
from needleplan.models.path import ImagePlane
from needleplan.signals import Array
from needleplan.simulation import Effects, Lab, Setup, SimulatedEntry, SimulatedTissue
from needleplan.simulation._sensors import from_z_to
from needleplan_thesis.chapter3.published import model_ii

SETUP = Setup(
    1 / 100,
    entry=SimulatedEntry(depth_mm=-1.0),
    friction=model_ii(1),
    tissue=SimulatedTissue(cutting_n=0.2),
    fibre=FibreSensors((2.5, 8.0)),
    ultrasound=ImagePlane(thickness_mm=40.0),
)
SIZES: dict[str, tuple[float, set[str]]] = {
    "curvature_error": (0.2, {"image", "position", "direction", "fibre"}),
    "curvature_scatter": (0.1, {"image", "position", "direction", "fibre"}),
    "curvature_speed_power": (0.5, {"image", "position", "direction", "fibre"}),
    "pre_bend_per_mm": (0.002, {"image", "position", "direction", "fibre"}),
    "sag_per_mm": (0.002, {"image", "position", "direction", "fibre"}),
    "heading_noise_rad_sqrt_mm": (0.01, {"image", "position", "direction", "fibre"}),
    "torsional_friction_n": (0.1, {"image", "position", "direction", "torque", "fibre"}),
    "tissue_compliance_mm_n": (2.0, {"image", "position", "direction", "force", "fibre"}),
    "respiration_along_mm": (2.0, {"image", "position", "direction", "force", "fibre"}),
    "respiration_across_mm": (2.0, {"image", "position"}),
    "encoder_step_mm": (0.01, {"depth", "image", "position", "direction", "force", "fibre"}),
    "encoder_step_rad": (0.01, {"roll", "image", "position", "direction", "fibre"}),
    "reaction_mm_s2_n": (500.0, {"depth", "image", "position", "direction", "force", "fibre"}),
    "force_noise_n": (0.01, {"force"}),
    "force_offset_n": (0.1, {"force"}),
    "force_drift_n_s": (0.01, {"force"}),
    "force_gain_error": (0.05, {"force"}),
    "tracker_noise_mm": (0.1, {"position"}),
    "tracker_wander_mm": (0.1, {"position"}),
    "tracker_distortion_mm": (1.0, {"position"}),
    "tracker_angle_noise_rad": (0.02, {"direction"}),
    "tracker_dropout": (0.2, {"seen"}),
    "fibre_noise_per_mm": (1e-3, {"fibre"}),
    "fibre_bias_per_mm": (1e-3, {"fibre"}),
    "ultrasound_noise_mm": (1.0, {"image"}),
    "ultrasound_missed": (0.5, {"image"}),
    "ultrasound_outliers": (0.5, {"image"}),
    "ultrasound_delay_s": (0.2, {"image"}),
    "coil_offset_mm": (5.0, {"position", "direction"}),
}


def heard(effects: Effects, seed: int = 4) -> dict[str, Array]:
    """Everything that the devices say of an insertion with a turn."""
    with Lab(replace(SETUP, effects=effects), seed) as lab:
        lab.stage.insert(20.0, 20.0)
        lab.advance(0.6)
        lab.stage.rotate(1.0, 6.0)
        lab.advance(1.2)
        stage, forces, poses = lab.stage.waiting(), lab.force_sensor.waiting(), lab.tracker.waiting()
        fibre, images = lab.fibre.waiting(), lab.ultrasound.waiting()
    return {
        "depth": np.array([each.depth_mm for each in stage]),
        "roll": np.array([each.roll_rad for each in stage]),
        "force": np.array([each.force_n for each in forces]),
        "torque": np.array([each.torque_n_mm for each in forces]),
        "position": np.array([each.position_mm for each in poses]),
        "direction": np.array([each.quaternion for each in poses]),
        "fibre": np.array([each.curvatures_per_mm for each in fibre]),
        "image": np.nan_to_num([(each.u_mm, each.v_mm) for each in images]),
        "seen": np.array([each.health is Health.GOOD for each in poses]),
    }


@pytest.fixture(scope="module")
def quiet() -> dict[str, Array]:
    return heard(Effects())


def test_every_effect_is_tried_and_absent_by_default() -> None:
    scales = {
        "torsional_release_mm",
        "tissue_relaxation_s",
        "respiration_period_s",
        "respiration_rest",
        "sag_fading_mm",
        "tracker_wander_s",
        "tracker_distortion_length_mm",
        "ultrasound_outlier_mm",
    }
    assert {each.name for each in fields(Effects)} == {*SIZES, *scales, "tracker_dropout_s"}
    assert not any(getattr(Effects(), name) for name in SIZES)
    assert Effects().torsional_release_mm == 0


@pytest.mark.parametrize("name", SIZES)
def test_an_effect_changes_what_it_must_and_nothing_else(name: str, quiet: dict[str, Array]) -> None:
    size, must = SIZES[name]
    values: dict[str, Any] = {name: size}
    found = heard(Effects(**values))
    seen = found["seen"]
    changed = set()
    for what, was in quiet.items():
        now = found[what]
        if what in ("position", "direction"):
            was, now = was[seen], now[seen]
        if not np.array_equal(was, now):
            changed.add(what)
    assert changed == must


def test_the_same_seed_says_the_same_and_another_one_does_not() -> None:
    effects = Effects(heading_noise_rad_sqrt_mm=0.01, force_noise_n=0.01, tracker_noise_mm=0.1, tracker_dropout=0.1)
    one, again, other = heard(effects), heard(effects), heard(effects, 5)
    assert all(np.array_equal(one[what], again[what], equal_nan=True) for what in one)
    assert not np.array_equal(one["force"], other["force"])
    assert np.array_equal(one["depth"], other["depth"])


def test_one_noise_does_not_change_another() -> None:
    alone = heard(Effects(tracker_noise_mm=0.1))
    both = heard(Effects(tracker_noise_mm=0.1, force_noise_n=0.1))
    assert np.array_equal(alone["position"], both["position"])


def at_rest(effects: Effects, seconds: float, seed: int = 0) -> tuple[Array, list[PoseSample]]:
    forces, poses = [], []
    with Lab(Setup(0.0, effects=effects), seed) as lab:
        for _ in range(round(seconds)):
            lab.advance(1.0)
            lab.stage.waiting()
            forces += [each.force_n[2] for each in lab.force_sensor.waiting()]
            poses += lab.tracker.waiting()
    return np.array(forces), poses


def test_noise_has_its_size_offset_its_value_and_drift_its_slope() -> None:
    force, _ = at_rest(Effects(force_noise_n=0.05, force_offset_n=0.3, force_drift_n_s=0.01), 30.0)
    time = np.arange(1, force.size + 1) / 200
    slope, level = np.polyfit(time, force, 1)
    # White noise averaged over five samples; 6000 of them are worth 1200.
    sd = 0.05 / math.sqrt(5)
    assert level == pytest.approx(0.3, abs=4 * 2 * sd / math.sqrt(1200))
    assert slope == pytest.approx(0.01, abs=4 * math.sqrt(12) * sd / math.sqrt(1200) / 30)
    assert (force - level - slope * time).std() == pytest.approx(sd, rel=0.1)


def test_white_and_slow_errors_of_the_tracker() -> None:
    _, poses = at_rest(Effects(tracker_noise_mm=0.1, tracker_wander_mm=0.2, tracker_wander_s=0.1), 40.0)
    places = np.array([each.position_mm for each in poses])
    assert places.std(axis=0) == pytest.approx(math.hypot(0.1, 0.2) * np.ones(3), rel=0.2)
    ahead = np.mean(places[4:] * places[:-4])
    assert ahead == pytest.approx(0.2**2 * math.exp(-4 / 40 / 0.1), abs=0.005)


def test_dropouts_are_missing_frames_with_their_number() -> None:
    _, poses = at_rest(Effects(tracker_dropout=0.05, tracker_dropout_s=0.1), 30.0)
    missing = [each for each in poses if each.health is Health.MISSING]
    assert 0.05 < len(missing) / len(poses) < 0.5
    assert all(math.isnan(each.position_mm[0]) and math.isnan(each.quaternion[0]) for each in missing)
    assert [each.stamp.sequence for each in poses] == list(range(1, len(poses) + 1))


@pytest.mark.parametrize("axis", [(1, 0, 0), (0, 1, 0), (0, 0, 1), (0, 0, -1), (0.6, -0.48, 0.64)])
def test_the_quaternion_takes_z_along_the_needle(axis: tuple[float, float, float]) -> None:
    w, x, y, z = from_z_to(*axis)
    assert w * w + x * x + y * y + z * z == pytest.approx(1)
    turned = (2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y))
    assert turned == pytest.approx(axis)


def test_the_coil_sits_behind_the_tip_on_the_arc() -> None:
    with Lab(Setup(1 / 40, effects=Effects(coil_offset_mm=5.0))) as lab:
        lab.stage.insert(30.0, 20.0)
        lab.advance(3.0)
        pose = lab.tracker.waiting()[-1]
        turn = (lab.plant.insertion.position - 5.0) / 40
    assert pose.position_mm == pytest.approx((40 * math.sin(turn), 40 * (1 - math.cos(turn)), 0), abs=1e-6)
