"""Scenarios as plain dicts, and where the sampled reference solutions are."""

import copy
import json
import os
from pathlib import Path
from typing import Any

NPZ_NAME = "planner_four_obstacles.npz"
VARIANTS = ("cost_arc4", "cost_arc1", "success_arc4")
FOUR_OBSTACLES = (
    [[25, 0], [40, 0], [40, 22], [32, 30], [25, 20]],
    [[30, 45], [48, 42], [52, 56], [40, 64], [32, 58]],
    [[62, 15], [76, 12], [80, 34], [70, 40], [64, 30]],
    [[72, 56], [84, 50], [88, 66], [76, 74]],
)


def npz_path() -> Path | None:
    """The sampled reference solutions: in $NEEDLEPLAN_SHARED, else in ../shared/reference beside the repository."""
    root = Path(__file__).resolve().parents[2]
    folder = Path(os.environ.get("NEEDLEPLAN_SHARED", root.parent / "shared" / "reference"))
    for candidate in (folder / NPZ_NAME, folder / "reference" / NPZ_NAME):
        if candidate.is_file():
            return candidate
    return None


def case(
    size: tuple[float, float],
    *,
    target: tuple[float, float, float],  # x, y, radius
    rho: float,
    headings: int,
    obstacles: tuple[list[list[float]], ...] = (),
    noise: tuple[float, ...] = (1.0,),
    samples: int = 1,
    spacing: tuple[float, float] = (1.0, 1.0),
    transition: str = "nearest",
    objective: tuple[float, float, float, float, float] = (1.0, 4.0, 10000.0, 10000.0, 1.0),
    layers: tuple[tuple[float, float], ...] = (),  # from x, radius
    tissues: tuple[tuple[list[list[float]], float], ...] = (),
) -> dict[str, Any]:
    """Return what tomllib would; `objective` is insertion per mm, rotation, collision, exit, discount."""
    names = ("insertion_per_mm", "rotation", "collision", "exit", "discount")
    layer = [{"from_mm": start, "curvature_radius_mm": radius} for start, radius in layers]
    return {
        "workspace": {"width_mm": size[0], "height_mm": size[1]},
        "obstacle": [{"name": f"obstacle {n}", "polygon_mm": polygon} for n, polygon in enumerate(obstacles)],
        "target": {"center_mm": list(target[:2]), "radius_mm": target[2]},
        "needle": {"curvature_radius_mm": rho, "layer": layer},
        "tissue": [{"polygon_mm": polygon, "curvature_radius_mm": radius} for polygon, radius in tissues],
        "motion": {"headings": headings, "tip_noise": list(noise), "arc_samples": samples},
        "grid": {"spacing_mm": list(spacing), "transition": transition},
        "objective": dict(zip(names, objective, strict=True)),
    }


def with_straight(scenario: dict[str, Any], share: float, price: float | None = None, **motion: Any) -> dict[str, Any]:
    """Return the scenario with straight steps and other changes of [motion]; without a price it has the default."""
    motion = scenario["motion"] | motion | {"straight_curvature_share": share}
    paid = {} if price is None else {"straight_per_mm": price}
    return scenario | {"motion": motion, "objective": scenario["objective"] | paid}


def four_obstacles(variant: str, transition: str = "nearest", collision: float | None = None) -> dict[str, Any]:
    """Return one of `VARIANTS` of the four-obstacle scenario."""
    literal = (1.0, 40.0, 200.0, 100.0, 0.95)
    objective = (1.0, 4.0, 10000.0, 10000.0, 1.0) if variant == "success_arc4" else literal
    if collision is not None:
        objective = (*objective[:2], collision, *objective[3:])
    return case(
        (120.0, 80.0),
        target=(100.0, 50.0, 2.0),
        rho=40.0,
        headings=60,
        obstacles=FOUR_OBSTACLES,
        noise=(0.466, 0.24, 0.027),
        samples=1 if variant == "cost_arc1" else 4,
        transition=transition,
        objective=objective,
    )


def toml_text(scenario: dict[str, Any], **solver: Any) -> str:
    """Write a case as a scenario file; `solver` becomes its table of that name."""
    lines = ['schema = "needleplan.scenario/1"', 'title = "oracle case"']
    for name, table in (*scenario.items(), ("solver", solver)):
        for entry in table if isinstance(table, list) else [table]:
            lines.append(f"[[{name}]]" if isinstance(table, list) else f"[{name}]")
            lines += [f"{key} = {json.dumps(value)}" for key, value in entry.items() if key != "layer"]
            for layer in entry.get("layer", []):
                lines += ["[[needle.layer]]", *(f"{key} = {json.dumps(value)}" for key, value in layer.items())]
    return "\n".join(lines).replace("= Infinity", "= inf") + "\n"


def mirrored(scenario: dict[str, Any]) -> dict[str, Any]:
    """Return the scenario reflected about y = height/2."""
    result, height = copy.deepcopy(scenario), scenario["workspace"]["height_mm"]
    result["target"]["center_mm"][1] = height - scenario["target"]["center_mm"][1]
    for region in (*result["obstacle"], *result["tissue"]):
        for key in {"polygon_mm", "holes_mm", "center_mm", "ends_mm"} & set(region):
            region[key] = reflected(region[key], height)
    return result


def reflected(points: Any, height: float) -> Any:
    """Return a point, or a list of points or of lists of points, reflected about y = height/2."""
    if isinstance(points[0], int | float):
        return [points[0], height - points[1]]
    return [reflected(each, height) for each in points]
