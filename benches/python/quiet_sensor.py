"""Name and measure large effects in readings of a quiet sensor, by the formulas of the library.

PYTHONPATH=.:python OPENBLAS_NUM_THREADS=1 python benches/python/quiet_sensor.py
PYTHONPATH=.:python python benches/python/quiet_sensor.py --rate 400 --noise 0.001 --effect backlash

Who tries a diagnosis first simulates a model with an effect and little noise. There the model of the data is exact, so
that each wrong name is an error of the fits or of the means over sample intervals. Motions and base are those of
tests/diagnosis/test_quiet_sensor.py.
"""

import argparse
import time

from needleplan.diagnosis import diagnose
from tests.diagnosis.test_quiet_sensor import recordings
from tests.diagnosis.trials import BASE

EFFECTS = {
    "puncture": {"size": 1.0, "depth_mm": 33.333, "bulge_mm": 3.0},
    "viscous": {"size": 3e-3},
    "respiration": {"size": 0.3, "frequency_hz": 0.25, "phase_rad": 0.5, "rest": 0.0},
    "bias": {"size": 0.1},
    "latency": {"size": 0.05},
    "backlash": {"size": 0.1},
}
# Rate (Hz) and noise (N) of the recordings.
SENSORS = ((400.0, 0.001), (50.0, 0.01))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--effect", action="append", choices=tuple(EFFECTS), help="only these; may be repeated")
    parser.add_argument("--rate", type=float, help="rate, Hz; by default 400 and 50")
    parser.add_argument("--noise", type=float, default=0.001, help="noise, N, at this rate")
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    print("| rate, Hz | noise, N | effect | answer | size, true | size, 95 % interval | processor time, s |")
    print("|--:|--:|---|---|--:|---|--:|")
    for rate, noise in SENSORS if given.rate is None else [(given.rate, given.noise)]:
        for name in given.effect or EFFECTS:
            begin = time.process_time()
            found = diagnose(BASE, recordings(name, EFFECTS[name], rate, given.seed, noise))
            took = time.process_time() - begin
            sizes = [each.estimates["size"] for each in found.effects if each.name == name]
            size = " ".join(f"{each.value:.4g} ({each.low:.4g} to {each.high:.4g})" for each in sizes)
            answer = f"{found.verdict}: {', '.join(found.names)}" if found.names else str(found.verdict)
            print(
                f"| {rate:g} | {noise:g} | {name} | {answer} | {EFFECTS[name]['size']:g} | {size} | {took:.1f} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
