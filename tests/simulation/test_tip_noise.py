"""The lab follows the tip noise of the plan, unless the simulation sets another one; then a remark says both."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import binomtest

from needleplan.anatomy import TARGET, Anatomy, SpaceScenario, write_phantom
from needleplan.control import Insertion, Options
from needleplan.control.safety import SafetyLimits
from needleplan.planning import PolicyTable, Pose, SpacePose, SpaceTable, plan_space, planned_noise
from needleplan.simulation import Effects, Robot, SimulatedStation, Simulation, simulated_station, tip_noise_remark
from tests.cli.commands import needleplan
from tests.control.scenes import small_table
from tests.control.space_scenes import box_table

pytestmark = pytest.mark.usefixtures("few_executions")

LAB = (
    'schema = "needleplan.simulation/1"\n[tissue]\ncurvature_per_mm = 0.025\n[robot]\nservo_hz = 400\n'
    "bandwidth_hz = 10\n[effects]\ncoil_offset_mm = 2.0\n{}[[move]]\ndwell_s = 1.0\n"
)


def station_with(
    effects: Effects, table: PolicyTable | SpaceTable, start: Pose | SpacePose, seed: int = 0
) -> SimulatedStation:
    """Return a lab with these effects and a slow servo, which computes faster."""
    simulation = Simulation.read("steering")
    setup = replace(simulation.setup, effects=effects, robot=Robot(servo_hz=400, bandwidth_hz=10.0))
    return simulated_station(replace(simulation, setup=setup), table, start, seed)


def test_the_noise_of_steps_in_the_plane_has_the_variance_of_the_walk() -> None:
    scenario = small_table().scenario
    motion, random = scenario.motion, np.random.default_rng(1)
    shares = [*motion.tip_noise[:0:-1], *motion.tip_noise]
    reach, steps = len(motion.tip_noise) - 1, 25
    drawn = random.choice(np.arange(-reach, reach + 1), (40_000, steps), p=shares).sum(1) * math.radians(360 / 72)
    in_plane, out_of_plane = planned_noise(scenario)
    assert drawn.std() == pytest.approx(in_plane * math.sqrt(steps * scenario.step_mm), rel=0.02)
    assert out_of_plane == 0


def test_the_headings_of_the_lab_scatter_as_planned() -> None:
    table = small_table()
    pose = Pose(0.0, 20.0, 0.0, 1)
    ends = []
    for seed in range(60):
        with station_with(Effects(), table, pose, seed) as station:
            path = station.lab.plant._path
            path.step(20.0, 0.0)
            path.step(40.0, math.pi)  # the arcs of both bevel sides cancel
            ends.append(path.tip())
    headings = np.array([math.atan2(*each.tangent[1::-1]) for each in ends])
    planned = planned_noise(table.scenario).in_plane_rad_sqrt_mm * math.sqrt(40.0)
    # The standard deviation of 60 normal numbers is within 30 % of the true one in 999 of 1,000 cases.
    assert headings.std(ddof=1) == pytest.approx(planned, rel=0.3)
    assert max(abs(each.tangent[2]) for each in ends) < 1e-9  # nothing leaves the plane


def test_the_default_simulation_follows_the_plan() -> None:
    table = box_table()
    with simulated_station(Simulation.read("steering"), table, table.best_entry()) as station:
        setup = station.lab.plant.setup
    assert setup.heading_noise_rad_sqrt_mm == (table.scenario.noise_rad_sqrt_mm,) * 2
    assert tip_noise_remark(setup) is None


def test_a_simulation_may_set_another_noise_and_a_remark_says_both() -> None:
    table = box_table()
    planned = table.scenario.noise_rad_sqrt_mm
    for own in (0.0, 0.033):
        with station_with(Effects(heading_noise_rad_sqrt_mm=own), table, table.best_entry()) as station:
            setup = station.lab.plant.setup
        assert setup.heading_noise_rad_sqrt_mm == (own, own)
        remark = tip_noise_remark(setup)
        assert remark is not None
        in_lab, in_plan = (math.degrees(each) * math.sqrt(10) for each in (own, planned))
        assert f"{in_lab:.1f} degrees after 10 mm in the simulation, {in_plan:.1f} in the plan" in remark
    with station_with(Effects(heading_noise_rad_sqrt_mm=planned), table, table.best_entry()) as station:
        assert tip_noise_remark(station.lab.plant.setup) is None


def test_without_a_plan_there_is_no_noise() -> None:
    assert Simulation.read("steering").setup.heading_noise_rad_sqrt_mm == (0.0, 0.0)


@pytest.mark.study
def test_insert_and_lab_print_the_remark(tmp_path: Path) -> None:
    table = tmp_path / "table.h5"
    box_table().write(table)
    lab = tmp_path / "lab.toml"
    for own, is_told in (("", False), ("heading_noise_rad_sqrt_mm = 0.0331\n", True)):
        lab.write_text(LAB.format(own))
        served = needleplan("lab", lab, "--table", table, "--duration", "0.2")
        assert served.returncode == 0, served.stderr
        assert ("tip noise: 6.0 degrees" in served.stderr) == is_told
    done = needleplan("insert", table, "--robot", f"sim://{lab}?seed=4", "--speed", "10", "--json")
    assert "tip noise: 6.0 degrees after 10 mm in the simulation, 4.0 in the plan" in done.stderr


@pytest.mark.study
def test_insertions_succeed_as_often_as_promised(tmp_path: Path) -> None:
    """Tip noise only: the lab of 3D plans succeeds as often as the promise at the entry says."""
    table = plan_space(SpaceScenario.of(Anatomy.read(write_phantom("prostate", tmp_path / "a", 2))))
    start = table.best_entry()
    promise, hits, runs = table.estimate(start).value, 0, 12
    for seed in range(runs):
        station = station_with(Effects(), table, start, seed)
        options = Options(
            velocity_mm_s=20.0, velocity_rad_s=10.0, torsion=station.torsion, needle_length_mm=station.needle_length_mm,
            longest_mm=SafetyLimits().deepest_mm,
        )  # fmt: skip
        limits = SafetyLimits(insertion_velocity_mm_s=25.0)
        with station, Insertion(
            table, station, options, registration=station.registration, limits=limits, accepted_limits="a fast lab"
        ) as insertion:  # fmt: skip
            insertion.run()
        hits += bool(table.scenario.codes(np.array(station.true_tip_mm)) == TARGET)
    assert binomtest(hits, runs, promise).pvalue > 0.01, f"{hits} of {runs}, promised {promise:.1%}"
