"""Files of one data set: a CSV file for each record (docs/reference/data.md), `model.toml` and `truth.json`."""

import json
from pathlib import Path
from typing import Any

import numpy as np
from third_generator_motion import Array

UNITS = {"friction": "N/mm", "cutting": "N", "onset_mm": "mm", "presliding_mm": "mm"}
DIGITS = {"time_s": 4, "depth_mm": 5, "velocity_mm_s": 5, "force_n": 6}


def write_set(
    folder: Path, nominal: dict[str, float], records: list[tuple[str, str, dict[str, Array]]], truth: dict[str, Any]
) -> None:
    """Write a data set into a new or existing folder."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, role, columns in records:
        head = ",".join([*columns, "trial", "role"])
        form = ",".join(f"%.{DIGITS[key]}f" for key in columns) + f",{name},{role}"
        table = np.column_stack(list(columns.values()))
        np.savetxt(folder / f"{name}.csv", table, fmt=form, header=head, comments="")
    parts = [f'[parameters.{key}]\nvalue = {value!r}\nunit = "{UNITS[key]}"\n' for key, value in nominal.items()]
    start = 'schema = "needleplan.model/1"\nkind = "shaft_and_tip"\ntitle = "before the diagnosis"\n'
    (folder / "model.toml").write_text("\n".join([start, *parts]))
    (folder / "truth.json").write_text(json.dumps(truth, indent=1) + "\n")
