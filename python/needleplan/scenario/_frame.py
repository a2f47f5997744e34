"""What a scenario in the plane has like one in 3D: the place of the target, the frame of the plan, and its texts."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from needleplan.scenario._parts import Target

__all__ = ["PlaneFrame"]


class PlaneFrame:
    """Base of a scenario in the plane: its frame is that of the world, and its plane is at z = 0."""

    if TYPE_CHECKING:
        target: Target

        def to_toml(self) -> str: ...

    @property
    def target_mm(self) -> tuple[float, float]:
        """Centre of the target (mm)."""
        return self.target.center_mm

    @property
    def target_radius_mm(self) -> float:
        """Radius of the target (mm)."""
        return self.target.radius_mm

    @property
    def frame_axes(self) -> NDArray[np.float64]:
        """Unit vectors of the plan's axes in the world, shape (3, 3): the identity in the plane."""
        import numpy as np

        return np.eye(3)

    @property
    def frame_origin_mm(self) -> NDArray[np.float64]:
        """Origin of the plan's frame in the world (mm): zero in the plane."""
        import numpy as np

        return np.zeros(3)

    def texts(self) -> dict[str, str]:
        """Return the texts that a recording keeps of the scenario.

        Returns
        -------
        dict of str to str
            Texts by file name: `scenario.toml`.

        Examples
        --------
        >>> from needleplan.scenario import Scenario
        >>> list(Scenario.read("four_obstacles").texts())
        ['scenario.toml']
        """
        return {"scenario.toml": self.to_toml()}
