"""A model from a file as the plant: the twin goes where the model says, whatever effects were added to it."""

from pathlib import Path

import numpy as np
import pytest

from needleplan.errors import ModelError, SimulationError
from needleplan.models import Bicycle, Channel, Model, ModelFile, ShaftAndTip, SpatialBicycle, simulate
from needleplan.models.effects import AddedEffect, Effect, effects_of, with_effect
from needleplan.signals import Array, Motion
from needleplan.simulation import Plant, Robot, Setup, SimulatedEntry, Simulation, run_simulation

BASE = SpatialBicycle(curvature_per_mm=0.01, heading_y_rad=0.02, entry_z_mm=0.5)
FORCE = ShaftAndTip(friction=0.012, cutting=0.4, onset_mm=4.0, presliding_mm=0.05)
VALUES = {
    "depth_mm": 15.0, "length_mm": 6.0, "direction_rad": 0.7, "fading_mm": 60.0, "frequency_hz": 0.3, "phase_rad": 0.4,
}  # fmt: skip
PROGRAM = """
[[move]]
insert_to_mm = 25.0
velocity_mm_s = 25.0
[[move]]
rotate_to_rad = 3.0
velocity_rad_s = 6.0
[[move]]
insert_to_mm = 40.0
velocity_mm_s = 8.0
"""


def with_one(effect: Effect, base: Model) -> Model:
    size = {"torsional_lag": 0.004, "entry_rupture": 0.6, "tracker_distortion": 4.0}.get(effect.name)
    values = {"size": size or 3 * effect.parameters["size"].typical}
    values |= {name: VALUES[name] for name in effect.parameters if name in VALUES}
    return with_effect(base, AddedEffect(effect.name, values))


def driven(plant: Plant) -> tuple[Motion, Array, Array, Array]:
    """Insert, turn and insert; return the motion, where the tip is and where it is seen, and the force."""
    rows, true, seen, force = [], [], [], []
    for begin in (lambda: plant.insert(25.0, 25.0), lambda: plant.rotate(3.0, 6.0), lambda: plant.insert(40.0, 8.0)):
        begin()
        while plant.moving:
            plant.step()
            rows.append((plant.now_s, plant.path_mm, plant.insertion.velocity, plant.roll.position))
            true.append(plant.tip().position_mm)
            seen.append(plant.seen_behind(0.0).position_mm)
            force.append(plant.felt_n)
    return Motion.sampled(*np.array(rows).T), np.array(true).T, np.array(seen).T, np.array(force)


@pytest.mark.slow
@pytest.mark.parametrize("effect", effects_of(Channel.TIP), ids=lambda each: each.name)
def test_the_tip_is_where_the_model_says(effect: Effect) -> None:
    model = with_one(effect, BASE)
    motion, true, seen, _ = driven(Plant(Setup(0.01, path=model, robot=Robot(servo_hz=400))))
    said, plain = simulate(model, motion).output, simulate(BASE, motion).output
    assert np.abs(said - plain).max() > 0.08  # there is something to be seen
    assert np.abs(seen - said).max() < 0.05
    own = np.abs(true - simulate(model.plant, motion).output).max()  # type: ignore[attr-defined]
    assert own < 0.05


def test_the_path_begins_along_the_entry() -> None:
    entry = SimulatedEntry(10.0, 20.0, 0.4)
    motion, true, _, _ = driven(Plant(Setup(0.01, entry, path=BASE, robot=Robot(servo_hz=200))))
    x, y, z = simulate(BASE, motion).output
    cos, sin = np.cos(0.4), np.sin(0.4)
    assert true == pytest.approx(np.array([10 + cos * x - sin * y, 20 + sin * x + cos * y, z]), abs=0.05)


@pytest.mark.parametrize("name", ["viscous", "bias", "puncture", "relaxation"])
def test_the_force_is_that_of_the_model(name: str) -> None:
    effect = next(each for each in effects_of(Channel.FORCE) if each.name == name)
    values = {key: what.lower if what.lower > 0 else 1.0 for key, what in effect.parameters.items() if what.free}
    values |= {key: value for key, value in VALUES.items() if key in effect.parameters}
    model = with_effect(FORCE, AddedEffect(name, values | {"size": 3 * effect.parameters["size"].typical}))
    motion, _, _, force = driven(Plant(Setup(0.01, force=model, robot=Robot(servo_hz=200))))
    assert force[1:] == pytest.approx(simulate(model, motion).output[1:], abs=2e-3)


def test_a_model_file_is_the_plant_of_a_simulation(tmp_path: Path) -> None:
    hidden = with_effect(BASE, AddedEffect("curvature_layer", {"size": 0.5, "depth_mm": 15.0}))
    ModelFile(hidden).write(tmp_path / "path.toml")
    ModelFile(FORCE).write(tmp_path / "force.toml")
    files = f'model = ["{tmp_path}/path.toml", "{tmp_path}/force.toml"]'
    text = f'schema = "needleplan.simulation/1"\n{files}\n[robot]\nservo_hz = 200\n{PROGRAM}'
    (tmp_path / "simulation.toml").write_text(text)
    record = run_simulation(Simulation.read(tmp_path / "simulation.toml")).record()
    seen = record.select(np.isfinite(record["x_mm"]))
    shown = np.array([seen[name] for name in ("x_mm", "y_mm", "z_mm")])
    assert shown == pytest.approx(simulate(hidden, seen.motion()).output, abs=0.05)
    felt = record.select(np.isfinite(record["force_n"]))
    going = felt.motion().velocity_mm_s > 5
    assert np.median(np.abs(felt["force_n"] - simulate(FORCE, felt.motion()).output)[going]) < 0.03
    assert felt["force_n"].max() > 0.7


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        ('model = "nowhere.toml"', "model.*cannot be read"),
        ("model = 3", "must be the name of a model file"),
        ('model = "path.toml"\n[tissue]\ncurvature_per_mm = 0.01', "the model determines the curvature of the path"),
        ('model = ["path.toml", "path.toml"]', "a second model"),
        ('model = "plane.toml"', "must be a model of the axial force"),
        ('model = "force.toml"', "tissue.curvature_per_mm.*without a scenario"),
    ],
)
def test_mistakes_of_models(
    lines: str, message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    for name, model in (("path", BASE), ("force", FORCE), ("plane", Bicycle(0.01))):
        ModelFile(model).write(f"{name}.toml")
    with pytest.raises(SimulationError, match=message):
        Simulation.from_toml(f'schema = "needleplan.simulation/1"\n{lines}\n{PROGRAM}')


def test_a_setup_takes_models_in_their_place() -> None:
    with pytest.raises(ModelError, match="path of a tip in 3D"):
        Setup(0.01, path=FORCE)
    with pytest.raises(ModelError, match="axial force"):
        Setup(0.01, force=BASE)
