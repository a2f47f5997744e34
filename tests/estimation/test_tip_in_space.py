"""The tip filter and the lab twin in 3D: rotated scenes, and an independent integration of the bicycle model."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from needleplan.devices import PoseSample, StageSample
from needleplan.estimation.registration import Registration
from needleplan.estimation.tip import TipEstimate, TipFilter, TipSettings
from needleplan.models import Torsion
from needleplan.simulation import Effects, Lab, Robot, Setup, SimulatedEntry

RADIUS_MM, COIL_MM = 60.0, 3.0
SETTINGS = TipSettings(heading_sd_rad_sqrt_mm=0.01, roll_sd_rad=0.2)
NOISY = Effects(
    tracker_noise_mm=0.1, tracker_angle_noise_rad=0.01, heading_noise_rad_sqrt_mm=0.01, coil_offset_mm=COIL_MM,
    torsional_friction_n=0.02,
)  # fmt: skip
# Insertions (mm) and the rolls of the base (rad) before each.
PROGRAM = ((15.0, 0.7), (30.0, 2.4), (40.0, -1.0), (60.0, 0.4))


def samples_of(lab: Lab) -> list[StageSample | PoseSample]:
    """Carry out the program, and return all samples of stage and tracker in order."""
    found: list[StageSample | PoseSample] = []

    def until_rest() -> None:
        lab.advance(0.05)
        while lab.plant.moving:
            lab.advance(0.05)
        found.extend(lab.stage.waiting())
        found.extend(lab.tracker.waiting())

    for depth, roll in PROGRAM:
        lab.stage.rotate(roll, 3.0)
        until_rest()
        lab.stage.insert(depth, 10.0)
        until_rest()
    return sorted(found, key=lambda sample: sample.stamp.received_ns)


def a_lab(effects: Effects, heading: float = 0.2, elevation: float = 0.3, seed: int = 0) -> Lab:
    entry = SimulatedEntry(5.0, 20.0, heading, z_mm=12.0, guide_elevation_rad=elevation)
    return Lab(Setup(1 / RADIUS_MM, entry=entry, effects=effects, robot=Robot(servo_hz=400, bandwidth_hz=10.0)), seed)


def filtered(samples: list[StageSample | PoseSample], turn: Rotation) -> TipEstimate:
    """Return the estimate at the end, with the scene turned about the origin of the tracker."""
    x, y, z = turn.apply([5.0, 20.0, 12.0]).tolist()
    entry = np.array([math.cos(0.3) * math.cos(0.2), math.cos(0.3) * math.sin(0.2), math.sin(0.3)])
    a, b, c = turn.apply(entry).tolist()
    w, i, j, k = turn.as_quat(scalar_first=True).tolist()
    registration = Registration(quaternion=(w, i, j, k), coil_offset_mm=COIL_MM)
    tip = TipFilter(registration, (x, y, math.atan2(b, a), z, math.atan2(c, math.hypot(a, b))), 1 / RADIUS_MM, SETTINGS)
    # The roll is measured from the left of the path, which the turn moves: the roll of the base has another zero.
    left, up = Rotation.from_euler("ZY", [0.2, -0.3]).apply([[0, 1, 0], [0, 0, 1]])
    bend = tip_at((x, y, z), (a, b, c)).turn_towards(tuple(turn.apply(left).tolist()))
    assert np.dot(turn.apply(left), turn.apply(up)) == pytest.approx(0)
    for sample in samples:
        if isinstance(sample, StageSample):
            tip.predict(replace(sample, roll_rad=sample.roll_rad + bend))
        else:
            tip.update(sample)
    return tip.tip


def tip_at(place: tuple[float, float, float], tangent: tuple[float, float, float]) -> TipEstimate:
    """Return an estimate at a pose with the roll 0."""
    a, b, c = tangent
    x, y, z = place
    numbers = dict.fromkeys(
        ("x_sd_mm", "y_sd_mm", "z_sd_mm", "heading_sd_rad", "elevation_sd_rad", "roll_sd_rad", "curvature_sd_per_mm",
         "curvature_factor_sd", "depth_mm", "pose_age_s", "curvature_per_mm", "curvature_factor", "roll_rad"), 0.0,
    )  # fmt: skip
    return TipEstimate(time_ns=0, status="tracking", x_mm=x, y_mm=y, z_mm=z, heading_rad=math.atan2(b, a),
                       elevation_rad=math.atan2(c, math.hypot(a, b)), **numbers)  # type: ignore[arg-type]  # fmt: skip


@pytest.mark.parametrize("degrees", [(40, 0, 0), (-90, 0, 0), (180, 0, 0), (70, 20, -10)])
def test_the_estimate_turns_with_the_scene(degrees: tuple[float, float, float]) -> None:
    samples = samples_of(a_lab(NOISY, seed=3))
    turn = Rotation.from_euler("xyz", degrees, degrees=True)
    still, turned = filtered(samples, Rotation.identity()), filtered(samples, turn)
    assert np.allclose(turn.apply(still.position_mm), turned.position_mm, atol=0.05)
    assert np.allclose(turn.apply(still.tangent), turned.tangent, atol=0.01)
    assert np.allclose(turn.apply(still.bend_direction), turned.bend_direction, atol=0.05)
    assert turned.curvature_factor == pytest.approx(still.curvature_factor, abs=0.02)
    sizes = [math.hypot(each.x_sd_mm, each.y_sd_mm, each.z_sd_mm) for each in (still, turned)]
    assert sizes[0] == pytest.approx(sizes[1], rel=0.1)


@pytest.mark.study
def test_the_estimate_is_as_good_as_it_says() -> None:
    """Normalised errors of 12 insertions with a tip noise as large as the filter assumes."""
    apart, aside = [], []
    for seed in range(12):
        lab = a_lab(NOISY, seed=seed)
        tip = filtered(samples_of(lab), Rotation.identity())
        true = lab.plant.tip()
        sd = np.array([tip.x_sd_mm, tip.y_sd_mm, tip.z_sd_mm])
        apart.append((np.array(true.position_mm) - tip.position_mm) / sd)
        aside.append(math.acos(min(float(np.dot(true.tangent, tip.tangent)), 1.0)))
    assert 0.3 < np.sqrt(np.mean(np.square(apart))) < 1.6
    assert np.sqrt(np.mean(np.square(aside))) < 0.06


def test_a_turn_leads_the_bevel_to_its_direction() -> None:
    tip = filtered(samples_of(a_lab(Effects(coil_offset_mm=COIL_MM))), Rotation.identity())
    left = np.cross(tip.bend_direction, tip.tangent)
    assert tip.turn_towards(tip.bend_direction) == pytest.approx(0)
    assert abs(tip.turn_towards((-left[0], -left[1], -left[2]))) == pytest.approx(math.pi / 2)
    turned = replace(tip, roll_rad=tip.roll_rad + tip.turn_towards((left[0], left[1], left[2])))
    assert np.allclose(turned.bend_direction, left)


@pytest.mark.parametrize("friction", [0.0, 0.04])
def test_the_twin_follows_the_bicycle_model(friction: float) -> None:
    """Frenet's equations of the tip with the bevel's roll, integrated by SciPy; the lag is that of `Torsion`."""
    lab = a_lab(Effects(torsional_friction_n=friction))
    samples_of(lab)
    frame = Rotation.from_euler("ZY", [0.2, -0.3])
    state = np.concatenate([[5.0, 20.0, 12.0], frame.apply(np.eye(3)).ravel()])
    shaft = lab.plant.setup.shaft
    torsion = Torsion(shaft.torsional_stiffness_n_mm2, friction)
    begin, roll = 0.0, 0.0
    for depth, base in PROGRAM:
        lag = torsion.lag_rad(shaft.length_mm - begin, begin)
        # The tip follows the base at the distance of the lag, in the direction of the rotation.
        roll = base - math.copysign(lag, base - roll) if abs(base - roll) > lag else roll

        def derivative(_: float, y: np.ndarray, roll: float = roll) -> np.ndarray:
            t, n, b = y[3:].reshape(3, 3)
            bend = (math.cos(roll) * n + math.sin(roll) * b) / RADIUS_MM
            return np.concatenate([t, bend, -(bend @ n) * t, -(bend @ b) * t])

        state = solve_ivp(derivative, (begin, depth), state, rtol=1e-10, atol=1e-10).y[:, -1]
        begin = depth
    true = lab.plant.tip()
    assert lab.plant.tip_roll_rad == pytest.approx(roll, abs=0.01)
    assert np.allclose(true.position_mm, state[:3], atol=0.05)
    assert np.allclose(true.tangent, state[3:6], atol=2e-3)
