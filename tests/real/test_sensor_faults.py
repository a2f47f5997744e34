"""Sound measurements of others have no faults of the sensor."""

import numpy as np

from needleplan.recording import read_records
from needleplan.signals import fault_notes
from tests.real.shared import require


def test_friction_and_liver_have_no_faults() -> None:
    rig = require("friction_rig") / "test_data_2.txt"
    (record,) = read_records(rig, columns="time=Time[s],depth=Position[mm],force=-Friction[uN]", accept_units=True)
    assert fault_notes(record) == []
    (record,) = read_records(
        require("liver_force") / "depth_force.csv", columns="depth=1[m], force=2[N], speed=3[mm/s]"
    )
    assert fault_notes(record) == []
    assert np.isfinite(record["force_n"]).all()
