"""The error of a rigid motion between two frames, as that of a registration, by its covariance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from needleplan.artifacts import CallRepr
from needleplan.errors import DataError, Mistake
from needleplan.signals._record import Array

__all__ = ["RigidError"]

# Largest asymmetry of a covariance, and size of its most negative eigenvalue, relative to its largest number.
_ROUNDING = 1e-9


@dataclass(frozen=True, eq=False)
class RigidError(CallRepr):
    """The error of a rigid motion: a small rotation about a centre, then a shift, jointly normal with the mean zero.

    Parameters
    ----------
    centre_mm : array_like
        Centre of the rotation (mm), shape (3,).
    covariance : array_like
        Covariance of the rotation vector (rad) and the shift (mm), in this order, shape (6, 6).

    Raises
    ------
    DataError
        If a shape is wrong, a number is not finite, or the covariance is not symmetric and positive semidefinite.

    Examples
    --------
    >>> import numpy as np
    >>> from needleplan.signals import RigidError
    >>> error = RigidError((0, 0, 0), np.diag([0.01**2, 0, 0, 1, 1, 1]))
    >>> round(error.tre_mm((0, 100, 0)), 3)
    2.0
    """

    centre_mm: Array
    covariance: Array

    def __post_init__(self) -> None:
        centre, covariance = np.array(self.centre_mm, float), np.array(self.covariance, float)
        for name, array, shape in (("centre_mm", centre, (3,)), ("covariance", covariance, (6, 6))):
            if array.shape != shape or not np.isfinite(array).all():
                raise DataError(
                    Mistake(name, f"shape {array.shape}", f"must have the shape {shape} and finite numbers")
                )
        rounding = _ROUNDING * abs(covariance).max()
        if abs(covariance - covariance.T).max() > rounding or np.linalg.eigvalsh(covariance).min() < -rounding:
            raise DataError(Mistake("covariance", "", "must be symmetric, without a negative eigenvalue"))
        object.__setattr__(self, "centre_mm", centre)
        object.__setattr__(self, "covariance", covariance)

    @classmethod
    def of_tre(cls, tre_mm: float) -> RigidError:
        """Return the error that shifts all points by the same random vector, isotropic, of a root mean square length.

        Parameters
        ----------
        tre_mm : float
            Root mean square length of the shift in three dimensions (mm).

        Returns
        -------
        RigidError

        Examples
        --------
        >>> from needleplan.signals import RigidError
        >>> round(RigidError.of_tre(1.5).tre_mm((10, 20, 30)), 6)
        1.5
        """
        return cls(np.zeros(3), np.diag([0.0] * 3 + [tre_mm**2 / 3] * 3))

    def tre_mm(self, place_mm: Array) -> float:
        """Return the root mean square error at a place (target registration error), to first order.

        Parameters
        ----------
        place_mm : array_like
            Place (mm), shape (3,).

        Returns
        -------
        float
            Error (mm) in three dimensions.

        Examples
        --------
        >>> from needleplan.signals import RigidError
        >>> RigidError.of_tre(0.0).tre_mm((0, 0, 0))
        0.0
        """
        x, y, z = np.asarray(place_mm, float) - self.centre_mm
        jacobian = np.hstack([np.array([[0, z, -y], [-z, 0, x], [y, -x, 0]]), np.eye(3)])
        return float(np.sqrt(np.trace(jacobian @ self.covariance @ jacobian.T)))

    def moved(self, axes: Array, origin_mm: Array) -> RigidError:
        """Return the error in a frame with these axes and this origin.

        Parameters
        ----------
        axes : array_like
            Unit vectors of the frame: the rows of an array of shape (3, 3).
        origin_mm : array_like
            Origin of the frame (mm), shape (3,).

        Returns
        -------
        RigidError

        Examples
        --------
        >>> import numpy as np
        >>> from needleplan.signals import RigidError
        >>> RigidError.of_tre(1.0).moved(np.eye(3), (1, 2, 3)).centre_mm.tolist()
        [-1.0, -2.0, -3.0]
        """
        turn = np.asarray(axes, float)
        both = np.kron(np.eye(2), turn)
        covariance = both @ self.covariance @ both.T
        return RigidError(turn @ (self.centre_mm - np.asarray(origin_mm, float)), (covariance + covariance.T) / 2)

    def motions(self, numbers: Array) -> Array:
        """Return the rigid motions of standard normal numbers.

        Parameters
        ----------
        numbers : numpy.ndarray
            Independent standard normal numbers, shape (n, 6).

        Returns
        -------
        numpy.ndarray
            Rows of rotation and shift (mm), which take a point p to R p + t, shape (n, 3, 4).

        Examples
        --------
        >>> import numpy as np
        >>> from needleplan.signals import RigidError
        >>> RigidError.of_tre(3**0.5).motions(np.eye(6)[5:])[0, :, 3].round(6).tolist()
        [0.0, 0.0, 1.0]
        """
        from scipy.spatial.transform import Rotation

        squares, axes = np.linalg.eigh(self.covariance)
        drawn = numbers @ (axes * np.sqrt(np.maximum(squares, 0.0))) @ axes.T
        turns = Rotation.from_rotvec(drawn[:, :3]).as_matrix()
        shifts = self.centre_mm - turns @ self.centre_mm + drawn[:, 3:]
        return np.concatenate([turns, shifts[:, :, None]], -1)
