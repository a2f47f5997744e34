"""Options for sensors that show the needle besides the tracker: curvatures along it, and ultrasound images."""

from __future__ import annotations

import argparse
import contextlib
from collections.abc import Iterator
from typing import TYPE_CHECKING

from needleplan.cli.identify_options import sensors_at
from needleplan.cli.options import numbers
from needleplan.errors import InputError, Mistake

if TYPE_CHECKING:
    from needleplan.devices import SampledDevice, Source
    from needleplan.models.deflection import FibreSensors
    from needleplan.models.path import ImagePlane

__all__ = ["add_needle_sensors", "opened_sensors", "read_addressed_sensors", "read_needle_sensors"]

# Largest age (s) of an image, as in the settings of the tip filter.
_LONGEST_DELAY_S = 2.0
_OPENED = (("--fibre", "--sensors"), ("--images", "--image-plane"))


def add_needle_sensors(group: argparse._ActionsContainer, frame: str) -> None:
    """Declare the options that say where the sensors are; `frame` names the frame of the image plane."""
    group.add_argument(
        "--sensors", metavar="MM,MM",
        help="shape of the needle by curvature sensors at these distances from the tip",
    )  # fmt: skip
    group.add_argument(
        "--image-plane", metavar="O,U,V",
        help="tip in ultrasound images: point of the image at 0, 0 in mm, and directions of its two axes, as nine "
        f"numbers in the frame of the {frame}",
    )  # fmt: skip
    group.add_argument(
        "--image-delay", type=float, metavar="S", help="age of an image when it arrives, in s (default: 0)"
    )


def read_needle_sensors(options: argparse.Namespace) -> tuple[FibreSensors | None, ImagePlane | None]:
    """Return the curvature sensors and the image plane of the options. Raises InputError or ModelError."""
    from needleplan.models.path import ImagePlane

    delay, plane = options.image_delay, None
    if delay is not None and not (options.image_plane and 0 <= delay <= _LONGEST_DELAY_S):
        rule = f"must be from 0 to {_LONGEST_DELAY_S:g} s, with --image-plane"
        raise InputError(Mistake("--image-delay", f"{delay:g}", rule))
    if options.image_plane:
        values = numbers("--image-plane", options.image_plane, 9)
        plane = ImagePlane(tuple(values[:3]), tuple(values[3:6]), tuple(values[6:]))
    return sensors_at(options.sensors) if options.sensors else None, plane


def read_addressed_sensors(
    options: argparse.Namespace, *, simulated: bool
) -> tuple[FibreSensors | None, ImagePlane | None]:
    """Return the sensors of an insertion.

    Raises InputError, also for a simulated lab, whose simulation has the sensors, and for an address without its
    place or a place without its address.
    """
    mistakes = []
    for names in _OPENED:
        values = [getattr(options, name[2:].replace("-", "_")) for name in names]
        for at, value in enumerate(values):
            if value and simulated:
                rule = "is for real devices: a simulation has its own [fibre] and [ultrasound]"
                mistakes.append(Mistake(names[at], value, rule))
            elif value and not values[1 - at]:
                mistakes.append(Mistake(names[at], value, f"needs {names[1 - at]}"))
    if mistakes:
        raise InputError(mistakes)
    return read_needle_sensors(options)


@contextlib.contextmanager
def opened_sensors(options: argparse.Namespace, fibre: FibreSensors | None) -> Iterator[dict[Source, SampledDevice]]:
    """Open the sensors at `--fibre` and `--images`, and close them at the end of the context.

    Raises AddressError, ConfigurationError and DeviceFault.
    """
    from needleplan.devices import Source
    from needleplan.devices.igtl import open_fibre, open_images

    with contextlib.ExitStack() as opened:
        devices: dict[Source, SampledDevice] = {}
        if fibre is not None and options.fibre:
            devices[Source.FIBRE] = opened.enter_context(open_fibre(options.fibre, len(fibre.from_tip_mm)))
        if options.images:
            devices[Source.IMAGE] = opened.enter_context(open_images(options.images))
        yield devices
