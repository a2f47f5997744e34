"""The shape of a needle in layered tissue, by published numbers and by an integration that shares no code with ours."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares

from needleplan.errors import DataError, ModelError
from needleplan.models import LayeredShape, Model, ModelFile, SpatialBicycle, simulate
from needleplan.models.deflection import fit_shape
from needleplan.signals import Array, Motion

PUBLISHED = Path(__file__).parents[4] / "shared" / "data" / "needle_shape" / "shape_stuff.json"
TWO_LAYERS = LayeredShape(
    0.002, start_n_per_mm=0.0031, start_b_per_mm=-0.0018, start_twist_per_mm=0.0034, second_per_mm=0.011,
    boundary_mm=70.0,
)  # fmt: skip
SENSORS = (10.0, 35.0, 70.0, 100.0)


def integrated(model: LayeredShape, length: float, places: Array) -> tuple[Array, Array]:
    """Positions, (k, 3), and omega, (k, 3), by an adaptive method, in the axes of the papers: the needle along z.

    Written from the papers: omega' = omega_0' - B^-1 (omega x B (omega - omega_0)), R' = R [omega], r' = R e3, and the
    intrinsic curvature of Lezcano et al. for one and two layers as they print it.
    """
    stiffness = np.array([1.0, 1.0, model.torsion_ratio])
    first, second, boundary = model.intrinsic_per_mm, model.second_per_mm, model.boundary_mm
    one = boundary >= length

    def intrinsic(s: float) -> tuple[float, float]:
        if one or s > boundary:
            kappa = first if one else second
            return kappa * (1 - s / length) ** 2, -2 * kappa / length * (1 - s / length)
        rest = 1 - boundary / length
        curvature = first * ((boundary - s) / length) ** 2 + second * rest * (1 + boundary / length - 2 * s / length)
        return curvature, -2 * first / length**2 * (boundary - s) - 2 * second / length * rest

    def rates(s: float, y: Array) -> Array:
        omega, frame = y[:3], y[3:12].reshape(3, 3)
        curvature, slope = intrinsic(s)
        moment = stiffness * (omega - [curvature, 0, 0])
        a, b, c = omega
        spin = np.array([[0, -c, b], [c, 0, -a], [-b, a, 0]])
        return np.concatenate(
            [[slope, 0, 0] - np.cross(omega, moment) / stiffness, (frame @ spin).ravel(), frame[:, 2]]
        )

    y = np.concatenate([
        [model.start_n_per_mm, model.start_b_per_mm, model.start_twist_per_mm], np.eye(3).ravel(), np.zeros(3),
    ])  # fmt: skip
    rows, at = [], 0.0
    for end in [*([] if one else [boundary]), length]:
        wanted = places[(places > at) & (places <= end)]
        run = solve_ivp(rates, (at, end), y, "DOP853", np.append(wanted, end), rtol=1e-12, atol=1e-14)
        rows.append(run.y[:, :-1])
        y, at = run.y[:, -1], end
    found = np.concatenate(rows, axis=1).T
    return found[:, 12:], found[:, :3]


ARC = ("curvature_per_mm", "heading_y_rad", "heading_z_rad", "entry_y_mm", "entry_z_mm")
ROD = ("intrinsic_per_mm", "second_per_mm", "start_n_per_mm", "start_b_per_mm", "start_twist_per_mm")


def closest(model: Model, free: tuple[str, ...], depth: Array, tip: Array) -> Array:
    """Return the distances, (3, n), of positions, (3, n), from those of the best model with its bevel anywhere."""
    scale = 1e-3

    def misses(values: Array) -> Array:
        changed = model.with_values(**dict(zip(free, (scale * values[:-1]).tolist(), strict=True)))
        motion = Motion.sampled(depth + 1.0, depth, angle_rad=np.full(depth.size, values[-1]))
        return np.asarray(simulate(changed, motion).output - tip)

    start = np.array([model.values()[name] / scale for name in free] + [0.0])
    limits = np.array([(model.parameters()[name].lower, model.parameters()[name].upper) for name in free]) / scale
    bounds = np.append(limits, [[-7.0, 7.0]], axis=0).T
    return misses(least_squares(lambda values: misses(values).ravel(), start, bounds=(bounds[0], bounds[1])).x)


def rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def in_our_axes(position: Array) -> Array:
    """Positions of the papers, whose needle goes along z and bends toward -y, in ours: along x, toward y."""
    return np.stack([position[..., 2], -position[..., 1], position[..., 0]], axis=-1)


@pytest.mark.skipif(not PUBLISHED.exists(), reason="the published shape is not on this machine")
def test_the_published_shape_follows_from_the_published_parameters() -> None:
    published: dict[str, Any] = json.loads(PUBLISHED.read_text())
    stiffness, (n, b, twist) = published["needle_mech_params"]["B"], published["winit"]
    model = LayeredShape(
        published["kc"], start_n_per_mm=n, start_b_per_mm=b, start_twist_per_mm=twist,
        torsion_ratio=stiffness[2][2] / stiffness[0][0],
    )  # fmt: skip
    position, omega = (np.array(published["shape"][key]) for key in ("pos", "wv"))
    shape = model.shape(published["L"], np.linspace(0, published["L"], omega.shape[1]))
    # Theirs is a leapfrog of 0.5 mm: an adaptive integration is at the same distance from it.
    np.testing.assert_allclose(shape.curvature_per_mm, omega.T, atol=1e-7)
    np.testing.assert_allclose(shape.position_mm, in_our_axes(position.T), atol=3e-4)
    # The best needle of one curvature, in any plane, is 200 times as far away.
    assert rms(closest(SpatialBicycle(0.002), ARC, shape.place_mm, shape.position_mm.T)) > 0.05


@pytest.mark.parametrize("model", [
    LayeredShape(0.004, start_n_per_mm=0.004),
    TWO_LAYERS.with_values(boundary_mm=1e4),
    TWO_LAYERS,
    TWO_LAYERS.with_values(torsion_ratio=0.4, boundary_mm=150.0, intrinsic_per_mm=-0.003),
])  # fmt: skip
def test_the_compiled_shape_is_that_of_an_adaptive_integration(model: LayeredShape) -> None:
    places = np.linspace(5.0, 199.5, 50)
    shape = model.shape(200.0, places)
    position, omega = integrated(model, 200.0, places)
    np.testing.assert_allclose(shape.curvature_per_mm, omega, atol=1e-10)
    np.testing.assert_allclose(shape.position_mm, in_our_axes(position), atol=1e-6)
    axes = np.stack([shape.tangent, shape.normal, np.cross(shape.tangent, shape.normal)], axis=1)
    np.testing.assert_allclose(axes @ axes.transpose(0, 2, 1), np.broadcast_to(np.eye(3), axes.shape), atol=1e-12)


def test_a_tip_by_depth_is_the_end_of_the_shape_of_this_depth() -> None:
    depth = np.array([-1.0, 0.0, 20.0, 90.0, 140.0])
    model = TWO_LAYERS.with_values(heading_y_rad=0.1, heading_z_rad=-0.05, power=0.6)
    run = simulate(model, Motion.sampled(np.arange(5.0), depth))
    np.testing.assert_array_equal(run.output[:, :2], 0.0)
    for sample in (2, 3, 4):
        np.testing.assert_allclose(
            run.output[:, sample], model.shape(depth[sample], depth[sample]).position_mm[0], atol=1e-12
        )
    scaled = model.with_values(
        power=0.0, intrinsic_per_mm=0.002 * (100 / 140) ** 0.6, second_per_mm=0.011 * (100 / 140) ** 0.6
    )
    np.testing.assert_allclose(run.output[:, 4], scaled.shape(140.0, 140.0).position_mm[0], atol=1e-9)


def test_a_turned_base_turns_the_shape_about_the_line_of_the_insertion() -> None:
    time, depth = np.arange(5.0), np.linspace(0.0, 120.0, 5)
    straight = simulate(TWO_LAYERS, Motion.sampled(time, depth)).output
    turned = simulate(TWO_LAYERS, Motion.sampled(time, depth, angle_rad=np.full(5, np.pi / 2))).output
    np.testing.assert_allclose(turned, [straight[0], -straight[2], straight[1]], atol=1e-12)


def test_a_member_of_one_curvature_fails_on_two_layers() -> None:
    depth = np.linspace(1.0, 150.0, 75)
    tip = simulate(TWO_LAYERS, Motion.sampled(depth, depth)).output
    tip = tip + 0.1 * np.random.default_rng(1).standard_normal(tip.shape)
    start = LayeredShape(0.001, start_n_per_mm=0.001, second_per_mm=0.001, boundary_mm=70.0)
    layered = rms(closest(start, ROD, depth, tip))
    assert layered == pytest.approx(0.1, rel=0.1)
    assert rms(closest(SpatialBicycle(0.002), ARC, depth, tip)) > 3 * layered


def test_the_fit_to_sensors_finds_the_layers_with_intervals_that_hold() -> None:
    depth, sd = [90.0, 120.0, 150.0], 1e-4
    names = ["intrinsic_per_mm", "second_per_mm", "start_n_per_mm", "start_b_per_mm"]
    held = np.zeros(4)
    for seed in range(25):
        noise = sd * np.random.default_rng(seed).standard_normal((3, 4, 2))
        seen = TWO_LAYERS.curvatures(depth, SENSORS) + noise
        start = TWO_LAYERS.with_values(
            intrinsic_per_mm=0.001, second_per_mm=0.001, start_n_per_mm=0.001, start_b_per_mm=0.0
        )
        found = fit_shape(start, depth, SENSORS, seen, free=names)
        held += [each.low <= TWO_LAYERS.values()[name] <= each.high for name, each in found.estimates.items()]
    assert (held / 25 > 0.8).all()
    assert found.rms_per_mm == pytest.approx(sd, rel=0.35)


def test_sensors_outside_of_the_tissue_and_unread_ones_do_not_count() -> None:
    seen = TWO_LAYERS.curvatures([50.0], SENSORS)
    assert np.isfinite(seen[0]).all(axis=1).tolist() == [True, True, False, False]
    found = fit_shape(LayeredShape(0.001, start_n_per_mm=0.001), [50.0], SENSORS, seen)
    assert np.isnan(found.residual_per_mm[0, 2:]).all()
    with pytest.raises(DataError, match="too few sensors are in the tissue"):
        fit_shape(LayeredShape(0.001, start_n_per_mm=0.001), [20.0], SENSORS, seen)


def test_curvatures_that_are_not_in_order_or_in_another_unit_are_refused() -> None:
    start, seen = LayeredShape(0.001, start_n_per_mm=0.001), TWO_LAYERS.curvatures([150.0], SENSORS)
    with pytest.raises(DataError, match="the nearest first"):
        fit_shape(start, [150.0], SENSORS[::-1], seen)
    with pytest.raises(DataError, match="divide by 1000"):
        fit_shape(start, [150.0], SENSORS, 1000 * seen)
    with pytest.raises(DataError, match=r"\(1, 4, 2\)"):
        fit_shape(start, [150.0], SENSORS, seen[0])
    with pytest.raises(DataError, match="must be parameters of the shape"):
        fit_shape(start, [150.0], SENSORS, seen, free=["power"])


def test_places_that_are_not_on_the_needle_are_refused() -> None:
    for places in ([10.0, 5.0], [101.0], [], [-1.0]):
        with pytest.raises(ModelError, match="must increase"):
            TWO_LAYERS.shape(100.0, places)
    with pytest.raises(ModelError, match="must be above 0 mm"):
        TWO_LAYERS.shape(0.0, [0.0])


def test_a_model_file_holds_the_shape() -> None:
    assert ModelFile.from_toml(ModelFile(TWO_LAYERS).to_toml()).model == TWO_LAYERS
