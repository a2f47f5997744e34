"""Measure processor times of the tip filter with each combination of its sensors, and of the shape of a needle.

python benches/python/sensor_times.py > benches/results/sensor_times.md
python benches/python/sensor_times.py --depth 12       # short test run

An insertion of 50 mm at 5 mm/s with a half turn at 15 mm, R = 40 mm. Stage samples at 1 kHz, curvature sensors at 100
Hz, poses at 40 Hz, images at 20 Hz. "Estimate": the tip after a sample of each kind but the stage. The shape: a needle
of 200 mm in two layers with a curvature and a twist at the entry.
"""

import argparse
import math
from collections import defaultdict
from collections.abc import Callable, Iterator
from time import perf_counter, process_time
from typing import Any

import machine
import numpy as np

from needleplan.estimation import Registration, TipFilter, TipSettings
from needleplan.models import LayeredShape
from needleplan.models.deflection import FibreSensors
from needleplan.models.path import ImagePlane
from needleplan.simulation import Effects, Lab, Setup, SimulatedEntry

RADIUS_MM, TURN_MM, SPEED_MM_S = 40.0, 15.0, 5.0
SENSORS, PLANE = FibreSensors((10.0, 30.0, 65.0, 100.0)), ImagePlane()
COMBINATIONS = {"tracker": (None, None), "and curvature sensors": (SENSORS, None), "and images": (None, PLANE),
                "and both": (SENSORS, PLANE)}  # fmt: skip
KINDS = ("stage", "pose", "curvatures", "image", "estimate")
SHAPES = 2000


def samples(coil_mm: float, depth_mm: float) -> Iterator[tuple[str, Any]]:
    """Yield the samples of an insertion in the order of their arrival, with their kinds."""
    effects = Effects(
        heading_noise_rad_sqrt_mm=0.002, tracker_noise_mm=0.2, tracker_angle_noise_rad=0.01, coil_offset_mm=coil_mm,
        fibre_noise_per_mm=2e-4, ultrasound_noise_mm=1.0, ultrasound_missed=0.3,
    )  # fmt: skip
    setup = Setup(1 / RADIUS_MM, SimulatedEntry(depth_mm=-2.0), effects=effects, fibre=SENSORS, ultrasound=PLANE)
    with Lab(setup, 1) as lab:
        devices = {"pose": lab.tracker, "curvatures": lab.fibre, "image": lab.ultrasound}
        for goal, roll in ((TURN_MM, math.pi), (depth_mm, None)):
            lab.stage.insert(goal, SPEED_MM_S)
            for turn in (False, True)[: 2 if roll else 1]:
                if turn and roll:
                    lab.stage.rotate(roll, 6.0)
                moving = True
                while moving:
                    sample = lab.stage.read(0.01)
                    assert sample is not None
                    moving = sample.moving
                    yield "stage", sample
                    for kind, device in devices.items():
                        yield from ((kind, each) for each in device.waiting())


def times_ms(coil_mm: float, taken: list[tuple[str, Any]], fibre: Any, plane: Any) -> dict[str, list[float]]:
    """Return the processor time (ms) of each call of a filter, by kind."""
    registration = Registration(coil_offset_mm=coil_mm)
    tip = TipFilter(registration, (0.0, 0.0, 0.0), 1 / RADIUS_MM, TipSettings(), fibre, plane)
    uses: dict[str, Callable[[Any], object]] = {"stage": tip.predict, "pose": tip.update}
    uses |= {"curvatures": tip.update_fibre} if fibre else {}
    uses |= {"image": tip.update_image} if plane else {}
    found: dict[str, list[float]] = defaultdict(list)
    for kind, sample in taken:
        if kind not in uses:
            continue
        began = process_time()
        uses[kind](sample)
        between = process_time()
        found[kind].append(1e3 * (between - began))
        if kind != "stage":
            _ = tip.tip
            found["estimate"].append(1e3 * (process_time() - between))
            found["95 % of both"].append(found[kind][-1] + found["estimate"][-1])
    return found


def main() -> int:
    """Print the times."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--depth", type=float, default=50.0, help="depth of the insertion in mm (50)")
    options = parser.parse_args()
    about = machine.description()
    print(
        "Processor time, mean in ms, of a call of the tip filter by the kind of the sample. The mean of all: calls and"
    )
    print("estimates, by the number of samples.")
    print(f"{about['processor']}, {about['date'][:10]}, commit {about['commit']}, Python {about['python']}.\n")
    print(f"| coil behind the tip | measurements | {' | '.join(KINDS)} | 95 % of sample and estimate | mean of all |")
    print("|--:|---|" + "--:|" * (len(KINDS) + 2))
    for coil in (9.3, 30.0):
        taken = list(samples(coil, max(options.depth, TURN_MM + 1)))
        for name, (fibre, plane) in COMBINATIONS.items():
            found = times_ms(coil, taken, fibre, plane)
            both = np.percentile(found.pop("95 % of both"), 95)
            calls = sum(len(each) for kind, each in found.items() if kind != "estimate")
            shown = [f"{np.mean(found[kind]):.2f}" if found[kind] else "" for kind in KINDS]
            mean = sum(map(sum, found.values())) / calls
            print(f"| {coil:g} mm | {name} | {' | '.join(shown)} | {both:.2f} | {mean:.2f} |")
    needle = LayeredShape(0.003, 0.002, -0.001, start_twist_per_mm=1e-3, second_per_mm=0.006, boundary_mm=60.0)
    seconds = []
    for _ in range(SHAPES):
        began = perf_counter()
        needle.shape(200.0, 200.0)
        seconds.append(perf_counter() - began)
    print(f"\nThe shape of 200 mm: {1e6 * float(np.median(seconds)):.0f} us (median of {SHAPES}).")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
