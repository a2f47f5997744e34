import json
import re
from dataclasses import MISSING, fields
from pathlib import Path

import numpy as np
import pytest

from needleplan import simulation
from needleplan.cli import main
from needleplan.errors import SimulationError
from needleplan.models.deflection import FibreSensors
from needleplan.models.path import ImagePlane
from needleplan.recording import Recording, read_records
from needleplan.simulation import Move, Robot, Setup, Simulation, record_run, run_simulation, shipped_simulations
from tests import pages

TEXT = """
schema = "needleplan.simulation/1"
seed = 3
[tissue]
curvature_per_mm = 0.025
[[move]]
insert_to_mm = 10.0
velocity_mm_s = 10.0
[[move]]
rotate_to_rad = 3.0
velocity_rad_s = 6.0
[[move]]
dwell_s = 0.5
"""


def test_all_mistakes_at_once() -> None:
    text = """
schema = "needleplan.simulation/2"
seed = -1
scenario = "four_obstacle"
[effects]
curvature_eror = 0.1
tracker_noise_mm = -1
[robot]
servo_hz = 333
[[layer]]
from_mm = 30
[[layer]]
from_mm = 20
[friction]
kind = "lumped_lugr"
[[move]]
insert_to_mm = 500
velocity_mm_s = 5
[[move]]
insert_to_mm = 5
dwell_s = 1
[[move]]
rotate_to_rad = 1
velocity_mm_s = 5
[[move]]
insert_to_mm = 5
velocity_mm_s = 500
"""
    with pytest.raises(SimulationError) as refused:
        Simulation.from_toml(text, "mine.toml")
    said = str(refused.value)
    for word in (
        "mine.toml: ",
        'schema = "needleplan.simulation/2": must be "needleplan.simulation/1"',
        "seed = -1: must be a whole number",
        'did you mean "four_obstacles"?',
        'effects.curvature_eror: unknown key; did you mean "curvature_error"?',
        "effects.tracker_noise_mm = -1: must be a finite number in mm at least 0",
        "robot.servo_hz = 333: must be a multiple of 200",
        "layer 2.from_mm = 20: must be greater than that of the previous layer",
        'friction.kind = "lumped_lugr": must be one of',
        "move 1.insert_to_mm = 500: must be within the range of the robot",
        "move 2 = insert_to_mm, dwell_s: must have exactly one",
        "move 3.velocity_mm_s = 5: must not be given with rotate_to_rad",
        "move 3.velocity_rad_s: is missing",
        "move 4.velocity_mm_s = 500: must be at most the robot's top speed",
    ):
        assert word in said, word


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("x", "is not TOML"),
        (TEXT.replace("curvature_per_mm = 0.025", ""), "tissue.curvature_per_mm: is missing"),
        (TEXT.split("[[move]]")[0], "move: is missing"),
        (TEXT + "[friction]\nmu_c = 1.0\n", "friction.sigma1: is missing"),
        (TEXT + "[entry]\ndepth_mm = 3\n", "entry.depth_mm = 3: must be"),
    ],
)
def test_a_mistake_is_named(text: str, words: str) -> None:
    with pytest.raises(SimulationError) as refused:
        Simulation.from_toml(text)
    assert words in str(refused.value)


def test_made_in_python_it_obeys_the_same_rules() -> None:
    with pytest.raises(SimulationError, match="exactly one"):
        Simulation(Setup(0.01), (Move(),))
    with pytest.raises(SimulationError, match="must be a multiple of 200"):
        Setup(robot=Robot(servo_hz=500))


def test_shipped_simulations_can_be_read() -> None:
    assert shipped_simulations() == ["friction", "insertion", "steering"]
    assert Simulation.read("space") == Simulation.read("steering")  # a former name
    for name in shipped_simulations():
        assert Simulation.read(name).moves


def test_a_scenario_gives_the_curvature() -> None:
    text = TEXT.replace("seed = 3", 'scenario = "four_obstacles"').replace("curvature_per_mm = 0.025", "")
    assert Simulation.from_toml(text).setup.curvatures() == ((0.0, 1 / 40),)


def test_a_run_holds_all_samples_and_its_record_the_aligned_ones() -> None:
    done = run_simulation(Simulation.from_toml(TEXT))
    seconds = done.stage[-1].stamp.device_time_s
    assert seconds == pytest.approx(10 / 10 + 0.1 + 3.0 / 6 + 0.1 + 0.5 + 0.25, abs=0.003)
    for samples, rate in ((done.stage, 1000), (done.forces, 200), (done.poses, 40)):
        assert [each.stamp.sequence for each in samples] == list(range(1, len(samples) + 1))
        assert len(samples) == int(seconds * rate + 1e-6)
    record = done.record()
    seen = np.isfinite(record["x_mm"])
    assert record["time_s"][seen] == pytest.approx([each.stamp.device_time_s for each in done.poses])
    assert np.hypot(record["x_mm"], record["y_mm"])[seen][-1] == pytest.approx(10, abs=0.1)
    assert list(dict.fromkeys(record.phase)) == ["to 10 mm", "roll to 3 rad", "dwell"]
    assert record["depth_mm"] == pytest.approx([done.stage[5 * row + 4].depth_mm for row in range(len(record))])


def test_from_the_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file, out, again = tmp_path / "mine.toml", tmp_path / "run.csv", tmp_path / "run.h5"
    file.write_text(TEXT + "[effects]\nforce_noise_n = 0.01\n")
    assert main(["simulate", str(file), "-o", str(out), "--runs", "2", "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert [each["seed"] for each in said["runs"]] == [3, 4]
    assert [each.trial for each in read_records(out)] == ["seed 3", "seed 4"]
    assert main(["simulate", str(file), "-o", str(again), "--seed", "4"]) == 0
    assert "seed 4" in capsys.readouterr().out
    one, two = read_records(out)[1]["force_n"], read_records(again)[0]["force_n"]
    assert np.allclose(one, two, atol=1e-9, equal_nan=True)
    assert main(["simulate", str(file), "-o", "run.xyz", "--runs", "0"]) == 2
    said = capsys.readouterr().err
    assert "must end in .csv" in said
    assert "--runs = 0" in said


@pytest.mark.parametrize(
    "part", ["Entry", "Tissue", "Layer", "Shaft", "Fibre", "Ultrasound", "Robot", "Effects", "Move"]
)
def test_the_reference_has_every_key_and_default(part: str) -> None:
    tables = {name.removeprefix("Simulated"): getattr(simulation, name) for name in simulation.__all__}
    tables |= {"Fibre": FibreSensors, "Ultrasound": ImagePlane}
    text = (pages.ROOT / "docs/reference/simulation.md").read_text()
    sections = re.split(r"^## ", text, flags=re.MULTILINE)
    (section,) = [each for each in sections if re.match(rf"\[+{part.lower()}\]", each)]
    told = dict(re.findall(r"^\| `(\w+)` \| [^|]* \| `?([^|`]+)`? \|", section, re.MULTILINE))
    kinds = {MISSING: "required", None: "none"}
    assert told == {each.name: kinds.get(each.default, str(each.default)) for each in fields(tables[part])}


def test_sensors_along_the_needle_are_in_the_record_and_must_be_on_the_needle() -> None:
    text = """schema = "needleplan.simulation/1"
tissue.curvature_per_mm = 0.01
fibre.from_tip_mm = [5, 20]
[[move]]
insert_to_mm = 30.0
velocity_mm_s = 20.0
"""
    record = run_simulation(Simulation.from_toml(text)).record()
    for name in FibreSensors((5, 20)).columns:
        seen = record[name]
        assert np.isfinite(seen).sum() == pytest.approx(len(record) / 2, abs=2)
        assert seen[np.isfinite(seen)][-10:] == pytest.approx(0.01 if "y" in name.split("_") else 0.0, abs=1e-4)
    assert record["fbg2_y_per_mm"][np.isfinite(record["fbg2_y_per_mm"])][:20] == pytest.approx(0.0, abs=1e-12)
    with pytest.raises(SimulationError, match=r"fibre.from_tip_mm = 199: must end within the needle, which is 200 mm"):
        Simulation.from_toml(text.replace("[5, 20]", "[5, 199]"))
    with pytest.raises(SimulationError, match="the nearest sensor first"):
        Simulation.from_toml(text.replace("[5, 20]", "[20, 5]"))


def test_a_recording_of_sensors_along_the_needle_gives_the_same_trial(tmp_path: Path) -> None:
    text = """schema = "needleplan.simulation/1"
tissue.curvature_per_mm = 0.01
fibre.from_tip_mm = [5, 20]
effects.fibre_noise_per_mm = 1e-4
ultrasound.thickness_mm = 4.0
effects.ultrasound_noise_mm = 0.5
[[move]]
insert_to_mm = 30.0
velocity_mm_s = 20.0
"""
    run = run_simulation(Simulation.from_toml(text))
    record_run(run, tmp_path / "run.mcap")
    trial, record = Recording.read(tmp_path / "run.mcap").trial(), run.record()
    assert [name for name in trial.columns if name.startswith("fbg")] == list(FibreSensors((5, 20)).columns)
    there = np.isfinite(record["fbg1_y_per_mm"])
    rows = np.searchsorted(trial["time_s"], record["time_s"][there]).clip(max=len(trial) - 1)
    same = np.isclose(trial["time_s"][rows], record["time_s"][there], atol=1e-6)
    assert same.mean() > 0.95
    np.testing.assert_allclose(trial["fbg1_y_per_mm"][rows[same]], record["fbg1_y_per_mm"][there][same], atol=1e-9)
    there = np.isfinite(record["image_u_mm"])
    rows = np.searchsorted(trial["time_s"], record["time_s"][there] - 1e-6).clip(max=len(trial) - 1)
    assert there.sum() > 20
    np.testing.assert_allclose(trial["image_u_mm"][rows[:-1]], record["image_u_mm"][there][:-1], atol=1e-6)
