"""Small synthetic maps for tests."""

from __future__ import annotations

import numpy as np


def rough(rng, ny, nx, *, amplitude=100.0, smooth=3.0):
    """A smooth random field with a correlation length of `smooth` cells, std `amplitude`."""
    noise = rng.standard_normal((ny, nx))
    ky, kx = np.fft.fftfreq(ny)[:, None], np.fft.fftfreq(nx)[None, :]
    spectrum = np.fft.fft2(noise) * np.exp(-2 * (np.pi * smooth) ** 2 * (kx**2 + ky**2) / 2)
    field = np.fft.ifft2(spectrum).real
    return amplitude * (field - field.mean()) / field.std()
