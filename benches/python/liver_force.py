"""Compare members of the relaxing force on a published force into bovine liver, by cross-validation.

python benches/python/liver_force.py ../shared/data/liver_force/depth_force.csv > benches/results/liver_force.md

Data: axial force of an 18G bevel needle in bovine liver and heart, 3 mm/s, digitised from a figure of Okamura, Simone,
O'Leary, IEEE Trans. Biomed. Eng. 51 (2004) 1707; not part of this repository.

Split: the samples are divided into blocks of 1 mm of depth. Block number n belongs to fold n modulo 4. Each fold is
held out once, and the model is fitted to the other three. The table has the RMS of the residuals of all held-out
samples together, and that of all fitted samples. Blocks, because neighbouring samples have correlated errors. The
blocks are used up to the first puncture only: over the whole depth, a block with a puncture cannot be predicted from
its neighbours. There, every fourth sample is a fold. The split was fixed before the first run of this bench; two
folds of alternate blocks of 1 and 2 mm had been looked at before. Model I: in one fold, the force peak of the fitted
model lies within held-out blocks, hence the large error.
"""

import sys
from collections.abc import Callable

import numpy as np

from needleplan.identification._relaxing_force import fit_members
from needleplan.identification.force import fit_force
from needleplan.models import Model, simulate
from needleplan.models.force import ForceModel1
from needleplan.recording import read_records
from needleplan.signals import Array, MovingAverage, Record

FOLDS = 4
BLOCK_MM = 1.0
SPEED_MM_S = 3.0
BEFORE_MM = 18.5
START = ForceModel1(sigma0=1e-3, sigma1=1e-2, sigma2=1e-3, f1=1e-2, f2=-5e-3, alpha=0.05, beta=1.0)


def depth_model(record: Record, keep: Array) -> dict[str, Model]:
    """Return Model I of the thesis, fitted to the samples of `keep` from eight starts."""
    kept = record.with_column("force_n", np.where(keep, record["force_n"], np.nan))
    return {"Model I": fit_force(START, [kept], MovingAverage(1), 8).model}


def relaxing(capsules: int) -> Callable[[Record, Array], dict[str, Model]]:
    """Return the function that fits the members with up to `capsules` capsules."""

    def fitted(record: Record, keep: Array) -> dict[str, Model]:
        members = fit_members([record], mask=lambda _: keep, capsules=capsules)
        return {each.label: each.model for each in members}

    return fitted


def table(record: Record, fold: Array, families: list[Callable[[Record, Array], dict[str, Model]]]) -> None:
    """Print the RMS of fitted and of held-out residuals of every member that all folds have."""
    left: dict[str, list[tuple[Array, Array]]] = {}
    for number in range(FOLDS):
        held = fold == number
        for family in families:
            for label, model in family(record, ~held).items():
                error = record["force_n"] - simulate(model, record.motion()).output
                left.setdefault(label, []).append((error[~held], error[held]))
    print("| member | fitted, mN | held out, mN |\n|---|--:|--:|")
    for label, parts in left.items():
        if len(parts) == FOLDS:
            fitted, held_out = (np.sqrt(np.mean(np.concatenate(each) ** 2)) for each in zip(*parts, strict=True))
            print(f"| {label} | {1e3 * fitted:.1f} | {1e3 * held_out:.1f} |")


def main() -> int:
    """Print both tables."""
    (record,) = read_records(sys.argv[1], columns=f"depth=1[m], force=2[N], speed={SPEED_MM_S:g}[mm/s]")
    print("# Force into bovine liver\n\n" + (__doc__ or "").split("\n\n", 2)[2])
    before = record.select(record["depth_mm"] < BEFORE_MM)
    print(f"\n## Up to the first puncture ({BEFORE_MM:g} mm, {len(before)} samples)\n")
    table(before, np.floor(before["depth_mm"] / BLOCK_MM) % FOLDS, [depth_model, relaxing(0)])
    print(f"\n## The whole depth ({len(record)} samples)\n")
    table(record, np.arange(len(record)) % FOLDS, [depth_model, relaxing(4)])
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
