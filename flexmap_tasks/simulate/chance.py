"""Chance that can be repeated: one stream per purpose, so that one setting never stirs another."""

from __future__ import annotations

import zlib

import numpy as np

from flexmap_tasks.model.arrays import Floats


def stream(seed: int, purpose: str) -> np.random.Generator:
    """A generator of its own for `purpose` in the world with this seed."""
    return np.random.Generator(np.random.PCG64([seed, zlib.crc32(purpose.encode())]))


class SmoothField:
    """A stationary Gaussian random field over the plane, by random Fourier features (Rahimi and Recht 2007).

    The covariance falls with exp(-d^2 / (2 length_m^2)); each of the `axes` values has unit variance.
    """

    def __init__(self, rng: np.random.Generator, length_m: float, axes: int, waves: int = 96) -> None:
        self._wave = rng.normal(0.0, 1.0 / length_m, (axes, 2, waves))
        self._phase = rng.uniform(0.0, 2 * np.pi, (axes, waves))

    def __call__(self, xy_m: Floats) -> Floats:
        """(n, axes) values at xy_m (n, 2)."""
        waves = self._phase.shape[1]
        columns = [
            np.cos(xy_m[:, :2] @ wave + phase).sum(axis=1) * np.sqrt(2.0 / waves)
            for wave, phase in zip(self._wave, self._phase, strict=True)
        ]
        return np.stack(columns, axis=1)


def walk(rng: np.random.Generator, step: Floats, correlation: float) -> Floats:
    """First-order Gauss-Markov process of unit variance at ascending places `step` (n,).

    correlation : length (in the unit of `step`) over which it falls to 1/e
    """
    n = len(step)
    keep = np.exp(-np.diff(step, prepend=step[:1]) / correlation)
    shock = rng.normal(0.0, 1.0, n) * np.sqrt(np.maximum(0.0, 1.0 - keep**2))
    out = np.empty(n)
    value = rng.normal()
    for i in range(n):
        value = keep[i] * value + shock[i]
        out[i] = value
    return out
