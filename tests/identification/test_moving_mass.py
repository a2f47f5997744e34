from pathlib import Path

import numpy as np
import pytest
from scipy.io import loadmat

from needleplan.identification.friction import identify
from needleplan.models import DirectionalKarnopp, LumpedLuGre, ModelFile, simulate
from needleplan.models.effects import AugmentedModel
from needleplan.signals import Motion, Record

TRUTH = LumpedLuGre(sigma0=0.6, sigma1=0.24, sigma2=0.012, mu_c=0.45, mu_s=0.02, alpha=0.08)
MASS_KG = 0.3


def strokes(frequency_hz: float, *, noise_mm: float = 0.0, velocity: bool = True, seconds: float = 5.0) -> Record:
    """Strokes of 10 mm at 200 Hz with a mass, noise of 15 mN."""
    random = np.random.default_rng(3)
    time = np.arange(round(200 * seconds)) / 200
    depth = 100 + 5 * np.sin(2 * np.pi * frequency_hz * time) * np.minimum(frequency_hz * time, 1)
    motion = Motion.sampled(time, depth)
    inertia = 1e-3 * MASS_KG * np.gradient(motion.velocity_mm_s, time)
    force = simulate(TRUTH, motion).output + inertia + random.normal(0, 0.015, time.size)
    columns = {"time_s": time, "depth_mm": depth + random.normal(0, noise_mm, time.size), "force_n": force}
    return Record(columns | ({"velocity_mm_s": motion.velocity_mm_s} if velocity else {}), "strokes")


def test_a_mass_is_found_and_stored(tmp_path: object) -> None:
    record = strokes(2.0)
    found = identify([record], models=["II"], mass=True)
    each = found.estimates["mass_kg"]
    assert each.identified
    assert each.unit == "kg"
    assert each.low < MASS_KG < each.high
    assert each.high - each.low < 0.1 * MASS_KG
    assert isinstance(found.model, AugmentedModel)
    file = found.model_file([record])
    assert file is not None
    file.write(f"{tmp_path}/model.toml")
    read = ModelFile.read(f"{tmp_path}/model.toml").model
    assert read.values()["inertia.size"] == pytest.approx(each.value)
    # The effect of the file gives the force that was fitted.
    left = record["force_n"] - simulate(read, record.motion()).output
    assert float(np.std(left[200:])) < 0.02


def test_without_acceleration_the_remark_gives_the_missing_one() -> None:
    found = identify([strokes(0.2, seconds=15.0)], models=["II"], mass=True)
    assert not found.estimates["mass_kg"].identified
    assert isinstance(found.model, LumpedLuGre)
    (said,) = [each for each in found.remarks if "moving mass" in each]
    assert "7.9 mm/s2" in said
    assert "times the acceleration" in said


def test_a_mass_below_zero_is_no_matter_of_the_motion() -> None:
    record = strokes(2.0)
    inertia_n = 1e-3 * MASS_KG * np.gradient(record["velocity_mm_s"], record["time_s"])
    lagging = record.with_column("force_n", record["force_n"] - 2 * inertia_n)
    found = identify([lagging], models=["II"], mass=True)
    assert not found.estimates["mass_kg"].identified
    (said,) = [each for each in found.remarks if "moving mass" in each]
    assert "the force of a spring or of a delay" in said
    assert "move faster" not in said


def test_noise_of_the_depth_is_found_to_bias_the_mass() -> None:
    found = identify([strokes(2.0, noise_mm=0.01, velocity=False)], models=["II"], mass=True)
    assert not found.estimates["mass_kg"].identified
    assert any("Noise of the measured motion changes the mass" in each for each in found.remarks)


def test_little_noise_of_the_depth_is_harmless() -> None:
    each = identify([strokes(2.0, noise_mm=1e-3, velocity=False)], models=["II"], mass=True).estimates["mass_kg"]
    assert each.identified
    assert each.value == pytest.approx(MASS_KG, rel=0.05)


def test_mass_offset_and_friction_by_direction_of_a_drive() -> None:
    """A drive in size of a machine tool: tens of newtons and kilograms, encoder of 0.1 um."""
    random, time = np.random.default_rng(4), np.arange(6000) / 1000
    depth = 100 + 40 * np.sin(2 * np.pi * time)
    motion, noisy = Motion.sampled(time, depth), depth + random.normal(0, 1e-4, time.size)
    truth = DirectionalKarnopp(mu_c=30.0, sigma2=0.1, mu_c_out=20.0, sigma2_out=0.3)
    force = simulate(truth, motion).output + 0.02 * motion.acceleration_mm_s2 + random.normal(0, 0.5, time.size)
    record = Record({"time_s": time, "depth_mm": noisy, "force_n": force}, "drive")
    found = identify([record], models=["Karnopp", "Karnopp by direction"], mass=True, offset=True)
    assert found.model is not None
    assert found.model.name == "karnopp_by_direction+inertia"
    normal = found.model.values()["normal_force_n"]
    for name, value in truth.values().items():
        if name in found.estimates:
            assert found.estimates[name].value == pytest.approx(value / normal, rel=0.03)
    assert found.estimates["mass_kg"].value == pytest.approx(20.0, rel=0.01)
    alone = identify([record], models=["Karnopp"], mass=True, offset=True)
    assert alone.estimates["offset_n"].low < 5.0 < alone.estimates["offset_n"].high
    file = alone.model_file([record])
    assert file is not None
    assert file.model.values()["bias.size"] == alone.estimates["offset_n"].value


EMPS = Path(__file__).parents[3] / "shared" / "data" / "emps" / "DATA_EMPS.mat"


@pytest.mark.slow
@pytest.mark.skipif(not EMPS.exists(), reason="the EMPS benchmark's data are not beside the repository")
def test_a_public_drive_has_its_published_mass_and_friction_by_direction() -> None:
    data = {name: each.ravel() for name, each in loadmat(EMPS).items() if not name.startswith("__")}
    columns = {"time_s": data["t"], "depth_mm": 1e3 * data["qm"], "force_n": float(data["gtau"][0]) * data["vir"]}
    found = identify([Record(columns, "emps")], models=["Karnopp", "Karnopp by direction"], mass=True, offset=True)
    scores = {name: value for name, value, _ in found.scores}
    assert found.estimates["mass_kg"].low < 95.11 < found.estimates["mass_kg"].high
    assert scores["Karnopp by direction: RMSE held out"] < 2.5  # N
    assert scores["Karnopp by direction: RMSE held out"] < 0.95 * scores["Karnopp: RMSE held out"]


def test_without_the_option_there_is_no_mass() -> None:
    assert "mass_kg" not in identify([strokes(2.0, seconds=2.0)], models=["II"]).estimates
