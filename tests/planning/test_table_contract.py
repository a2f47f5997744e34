"""The contract of tables, in the plane and in 3D."""

from dataclasses import replace

import pytest

from needleplan.anatomy import SpaceScenario
from needleplan.planning import PolicyTable, SpaceTable, plan, plan_space
from needleplan.scenario import Scenario
from tests.anatomy.volumes import TEXT, anatomy, box
from tests.planning.contract import TableContract

pytestmark = pytest.mark.usefixtures("few_executions")


class TestPlane(TableContract):
    @pytest.fixture(scope="class")
    @classmethod
    def table(cls) -> PolicyTable:
        scenario = Scenario.read("four_obstacles")
        return plan(replace(scenario, grid=replace(scenario.grid, spacing_mm=(2.0, 2.0))))


class TestSpace(TableContract):
    @pytest.fixture(scope="class")
    @classmethod
    def table(cls) -> SpaceTable:
        text = TEXT.replace("radius_mm = 60.0", "radius_mm = 60.0\ntip_noise_deg = 6.0")
        return plan_space(SpaceScenario.of(anatomy(box(), text)))
