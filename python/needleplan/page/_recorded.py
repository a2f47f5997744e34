"""A recorded insertion for the page: the path of the tip, the axial force, decisions and events over time.

Distances of paths and tips from the obstacles of a plan in a plane, for the page.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from needleplan.errors import DataError
from needleplan.page._requests import pack
from needleplan.page._sensed import Sensed
from needleplan.planning import Pose
from needleplan.scenario import Scenario

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from numpy.typing import NDArray

    from needleplan.recording import Recording

__all__ = [
    "force_along",
    "messages_of",
    "nearest_risk",
    "packed_track",
    "recorded_plan",
    "risk_distances",
    "thinned",
    "track_message",
]


def risk_distances(scenario: Scenario, points_mm: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the distances (mm) of points from each obstacle, shape (obstacles, n); 0 in an obstacle.

    Parameters
    ----------
    scenario : Scenario
        The scenario, whose obstacles are taken without their margins.
    points_mm : numpy.ndarray
        Points of the centre line of the needle, shape (n, 2).

    Returns
    -------
    numpy.ndarray
    """
    import shapely

    points = shapely.points(points_mm[:, :2])
    rows = [shapely.distance(obstacle.region(), points) for obstacle in scenario.obstacles]
    return np.array(rows, np.float64).reshape(len(rows), len(points_mm))


def nearest_risk(scenario: Scenario, points_mm: NDArray[np.float64]) -> dict[str, Any] | None:
    """Return name and distance (mm) of the obstacle that points come closest to; None without obstacles.

    Parameters
    ----------
    scenario : Scenario
        The scenario.
    points_mm : numpy.ndarray
        Points along a path, shape (n, 2).

    Returns
    -------
    dict or None
        `name`, "obstacle" with its name or number, and `distance_mm`.
    """
    least = risk_distances(scenario, points_mm).min(1, initial=np.inf)
    if not len(least):
        return None
    number = int(least.argmin())
    name = scenario.obstacles[number].name or number + 1
    return {"name": f"obstacle {name}", "distance_mm": float(least[number])}


# Largest number of samples of a curve that the page draws; between them samples are left out.
_MOST_SAMPLES = 4000


def recorded_plan(recording: Recording) -> tuple[Scenario, Pose | None]:
    """Return the scenario of a recorded insertion, and the pose of its first decision, None if it has no decision.

    Raises DataError if the recording is not one of an insertion in a plane.
    """
    text = recording.session.texts.get("scenario.toml")
    if text is None or not recording.counts.get("/tip"):
        rule = "holds no plan or no path of the tip; only recordings of `needleplan insert` can be viewed"
        raise DataError(rule, str(recording.path))
    first = next(iter(recording.messages(["/decision"])), None) if "/decision" in recording.counts else None
    start = None if first is None else Pose.wound(first.values["pose"])
    return Scenario.from_toml(text, str(recording.path)), start


def track_message(recording: Recording) -> bytes:
    """Return the message on a recorded insertion. Times are in s from the first message."""
    begin_s = recording.start_ns * 1e-9
    columns = recording.columns("/tip")
    tip = np.stack([columns["time_s"] - begin_s, *(columns[name] for name in ("x_mm", "y_mm", "heading_rad"))], axis=1)
    decisions, events = messages_of(recording, _plane_decision)
    header = {"duration_s": recording.duration_s, "decisions": decisions, "events": events}
    return packed_track(header, recorded_plan(recording)[0], tip, force_along(recording), Sensed.of(recording))


def force_along(recording: Recording) -> NDArray[np.float64]:
    """Return time (s, from the first message) and axial force (N), shape (n, 2); n is 0 without a force."""
    if not recording.counts.get("/force"):
        return np.empty((0, 2))
    force = recording.columns("/force")
    axis = np.array(recording.session.force_axis or (0.0, 0.0, 1.0))
    vectors = np.stack([force[f"force_{name}_n"] for name in "xyz"], axis=1)
    return np.stack([force["time_s"] - recording.start_ns * 1e-9, vectors @ axis], axis=1)


def messages_of(
    recording: Recording, decision: Callable[[Any], dict[str, Any]]
) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Return decisions, as `decision` makes them of the values of a message, and events; with their times in s."""
    topics = [topic for topic in ("/decision", "/event") if topic in recording.counts]
    decisions, events = [], []
    for message in recording.messages(topics):
        time_s = (message.time_ns - recording.start_ns) * 1e-9
        if message.topic == "/decision":
            decisions.append({"time_s": time_s} | decision(message.values))
        else:
            events.append({"time_s": time_s} | _some(message.values, ("name", "cause", "text")))
    return decisions, events


def _plane_decision(values: Any) -> dict[str, Any]:
    return {"x_mm": values["pose"][0], "y_mm": values["pose"][1]} | _some(values, ("action", "success"))


def packed_track(
    header: Mapping[str, Any],
    scenario: Scenario,
    tip: NDArray[np.float64],
    force: NDArray[np.float64],
    sensed: Sensed | None = None,
) -> bytes:
    """Return the message on an insertion.

    Parameters
    ----------
    header : dict
        `duration_s`, `decisions` and `events`, with times in s.
    scenario : Scenario
        What the insertion followed; the message holds the distance (mm) of the tip from its nearest obstacle.
    tip : numpy.ndarray
        Time (s), x_mm, y_mm and heading_rad of the tip, shape (n, 4).
    force : numpy.ndarray
        Time (s) and axial force (N), shape (m, 2); none if m is 0.
    sensed : Sensed, optional
        Samples of curvature sensors and images.

    Returns
    -------
    bytes
    """
    kept, force = thinned(tip), thinned(force).astype(np.float32)
    tip = kept.astype(np.float32)
    arrays: dict[str, NDArray[Any]] = {"tip_time_s": tip[:, 0], "tip": tip[:, 1:]}
    if scenario.obstacles:
        arrays["risk_mm"] = risk_distances(scenario, kept[:, 1:3]).min(0).astype(np.float32)
    if len(force):
        arrays |= {"force_time_s": force[:, 0], "force_n": force[:, 1]}
    more, measured = sensed.packed(in_space=False) if sensed else ({}, {})
    return pack({**header, **more}, {**arrays, **measured})


def thinned(samples: NDArray[Any]) -> NDArray[Any]:
    """Return at most `_MOST_SAMPLES` samples at equal distances, the last one included."""
    step = max(-(-len(samples) // _MOST_SAMPLES), 1)
    return samples[::-1][::step][::-1]


def _some(values: Any, keys: tuple[str, ...]) -> dict[str, Any]:
    return {key: values.get(key) for key in keys}
