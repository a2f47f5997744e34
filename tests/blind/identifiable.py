"""How much of an effect is left when the base is calibrated again: its size as an analyst can see it at best."""

from dataclasses import dataclass

import numpy as np

from tests.blind.motions import Array


@dataclass(frozen=True)
class Colour:
    """Noise of rms, a share of whose variance is AR(1) with the coefficient keep."""

    rms: float
    share: float
    keep: float

    def whitened(self, signal: Array) -> Array:
        """The signals (T, ...) in units of the noise, by its spectrum over the record (periodic at the ends)."""
        steps = len(signal)
        angle = 2 * np.pi * np.fft.rfftfreq(steps)
        slow = (1.0 - self.keep**2) / np.abs(1.0 - self.keep * np.exp(-1j * angle)) ** 2
        density = self.rms**2 * (1.0 - self.share + self.share * slow)
        shape = (-1, *([1] * (signal.ndim - 1)))
        return np.fft.irfft(np.fft.rfft(signal, axis=0) / np.sqrt(density).reshape(shape), steps, axis=0)


def left(added: Array, calibrations: Array, colour: Colour) -> tuple[float, float]:
    """Share of the effect that calibrating the base again absorbs, and the noncentrality of the rest.

    added (T, R, axes) is what the effect adds, calibrations (T, R, axes, P) what the P parameters of the base do, each
    free in each trial. Both are measured in the whitened noise of the sensor; the tissue's heterogeneity is not in it.
    """
    absorbed = total = 0.0
    for r in range(added.shape[1]):
        seen = colour.whitened(added[:, r]).ravel()
        basis = colour.whitened(calibrations[:, r]).reshape(len(seen), -1)
        basis = basis / np.linalg.norm(basis, axis=0)
        orthogonal = np.linalg.svd(basis, full_matrices=False)[0]
        absorbed += float(np.sum((orthogonal.T @ seen) ** 2))
        total += float(seen @ seen)
    return (absorbed / total if total else 0.0), total - absorbed
