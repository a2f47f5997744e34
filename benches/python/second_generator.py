"""Second, independent generator of insertions with and without hidden effects, to judge `needleplan diagnose`.

Writes one folder for each data set: `train_1.csv` ..., `holdout.csv`, `noise.csv` in the columns of
docs/reference/data.md, the base model `model.toml`, and `truth.json`. The last one is not for whoever diagnoses.
Nothing of needleplan is imported.

    python benches/python/second_generator.py --out FOLDER --sets 40 --seed 1 --kind single --rate 100 --heterogeneity
    0.03
"""

import argparse
import json
from pathlib import Path

import numpy as np
from second_generator_motion import MOTIONS, RATES_HZ
from second_generator_sets import KINDS, SIZES, DataSet, draw_references, make, wishes

UNITS = {"friction": "N/mm", "cutting": "N", "onset_mm": "mm", "presliding_mm": "mm"}
Columns = dict[str, np.ndarray]


def trials_of(data: DataSet) -> list[tuple[str, str, Columns]]:
    """Name, role and measured columns of each record, in the order of the files."""
    records = []
    for number, (trial, measured) in enumerate(zip(data.bases, data.measured, strict=True), start=1):
        time = np.arange(trial.samples) / trial.rate_hz
        depth, speed, _ = trial.motion.at(time)
        columns = {"time_s": time, "depth_mm": depth, "velocity_mm_s": speed, "force_n": measured}
        name, role = (f"train_{number}", "train") if number < len(data.bases) else ("holdout", "holdout")
        records.append((name, role, columns))
    record = data.noise_record
    still = {"time_s": np.arange(len(record)) / data.wish.rate_hz, "force_n": record}
    return [*records, ("noise", "noise", still)]


def references_of(data: DataSet, count: int) -> list[tuple[str, str, Columns]]:
    """Name, role and columns of further trials without the effects, in other tissue and another motion."""
    records = []
    for number, (trial, measured) in enumerate(draw_references(data, count), start=1):
        time = np.arange(trial.samples) / trial.rate_hz
        depth, speed, _ = trial.motion.at(time)
        columns = {"time_s": time, "depth_mm": depth, "velocity_mm_s": speed, "force_n": measured}
        records.append((f"reference_{number}", "reference", columns))
    return records


def write_csv(path: Path, name: str, role: str, columns: Columns) -> None:
    row = ",".join(["%.4f" if each == "time_s" else "%.5f" for each in columns] + [name, role])
    numbers = np.column_stack(list(columns.values()))
    head = ",".join([*columns, "trial", "role"])
    path.write_text(head + "\n" + (row + "\n") * len(numbers) % tuple(numbers.ravel().tolist()), encoding="utf-8")


def write_hdf5(path: Path, records: list[tuple[str, str, Columns]]) -> None:
    """All records in one file, one group each. Needs h5py, which the CSV files do not."""
    import h5py

    with h5py.File(path, "w") as file:
        for name, role, columns in records:
            group = file.create_group(name)
            group.attrs["trial"], group.attrs["role"] = name, role
            for column, values in columns.items():
                group.create_dataset(column, data=values)


def write_model(path: Path, nominal: dict[str, float]) -> None:
    lines = ['schema = "needleplan.model/1"', 'kind = "shaft_and_tip"', 'title = "base of the second generator"']
    for name, value in nominal.items():
        lines += ["", f"[parameters.{name}]", f"value = {value:.3g}", f'unit = "{UNITS[name]}"']
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def write(data: DataSet, folder: Path, *, hdf5: bool = False) -> None:
    """Writes the files of one data set."""
    folder.mkdir(parents=True, exist_ok=True)
    records = trials_of(data)
    if hdf5:
        write_hdf5(folder / "data.h5", records)
    else:
        for name, role, columns in records:
            write_csv(folder / f"{name}.csv", name, role, columns)
    write_model(folder / "model.toml", data.nominal)
    (folder / "truth.json").write_text(json.dumps(data.truth, indent=1) + "\n", encoding="utf-8")


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, required=True, help="folder for the data sets")
    parser.add_argument("--sets", type=int, default=40)
    parser.add_argument("--first", type=int, default=0, help="index of the first data set, to continue a series")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--kind", choices=KINDS, help="default: a mixture of none, single, pair and outside")
    parser.add_argument("--motion", choices=MOTIONS, help="default: 60 %% rich, 20 %% one speed, 20 %% cycles")
    parser.add_argument("--rate", type=int, choices=RATES_HZ, help="sampling rate in Hz; default: all four")
    parser.add_argument(
        "--heterogeneity", type=float, help="relative standard deviation by depth; default: 0, 0.03 and 0.1"
    )
    parser.add_argument(
        "--sizes",
        choices=SIZES,
        default="noise",
        help="strata of noncentrality against noise, or noise and tissue; or RMS",
    )
    parser.add_argument("--format", choices=("csv", "hdf5"), default="csv")
    given = parser.parse_args(arguments)
    asked = wishes(
        given.seed, given.first + given.sets, given.kind, given.rate, given.heterogeneity, given.motion, given.sizes
    )
    for wish in asked[given.first :]:
        write(make(wish), given.out / f"set_{wish.index:04d}", hdf5=given.format == "hdf5")
    print(f"{given.sets} data sets in {given.out}")


if __name__ == "__main__":
    main()
