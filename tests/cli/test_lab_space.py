"""The registration that the lab writes for a 3D plan."""

from pathlib import Path

import numpy as np
import pytest

from needleplan.cli.lab import _registration
from needleplan.estimation.registration import Registration
from needleplan.simulation import Simulation, simulated_station
from tests.control.space_scenes import box_table

pytestmark = pytest.mark.usefixtures("few_executions")


def test_the_registration_leads_to_ras_and_back_to_the_lattice(tmp_path: Path) -> None:
    table = box_table()
    with simulated_station(Simulation.read("steering"), table, table.best_entry().pose) as station:
        setup = station.lab.plant.setup
    _registration(setup).write(tmp_path / "lab.toml")
    read, frame = Registration.read(tmp_path / "lab.toml"), table.scenario.grid.frame
    place, turn = (10.0, 4.0, 7.0), (0.5, 0.5, -0.5, 0.5)
    assert np.allclose(read.place(place, turn).position_mm, frame.world(place), atol=1e-9)
    back = read.followed_by(frame.axes, -(frame.axes @ frame.origin_mm)).place(place, turn)
    assert np.allclose(back.position_mm, place, atol=1e-9)
    assert np.allclose(back.direction, Registration().place(place, turn).direction, atol=1e-9)
