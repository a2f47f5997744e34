"""Print the lines of `stop_latency.py --samples` about one way of the datagrams: `sample_to_stop.py WAY SECONDS`."""

import sys

from needleplan.control.realtime import measure_promptness
from needleplan.devices import UdpLink


class PythonLink(UdpLink):
    """A link whose socket Python keeps: the way of the datagrams before the supervisor had threads."""


def main(way: str, seconds: float) -> None:
    """Measure, and print."""
    found = measure_promptness(seconds, PythonLink if way == "Python" else UdpLink)
    for what, number, times_ms in (
        ("sample to STOP", found.stops, found.stop_ms),
        ("heartbeat gap", found.gaps, found.gap_ms),
    ):
        cells = " | ".join(f"{each:.2f}" for each in times_ms)
        print(f"| {what} | {way} | {found.priority} | {number} | {cells} | {found.missing} |", flush=True)


if __name__ == "__main__":
    main(sys.argv[1], float(sys.argv[2]))
