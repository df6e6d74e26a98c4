"""Inertial sensors at rest whose noise is known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Noise:
    """
    What disturbs one axis; in SI units, where u is rad/s of a gyroscope, m/s² of an accelerometer.

    :param density: u/√Hz, white noise.
    :param walk: u/s/√Hz, random walk of the bias.
    :param instability: u, flicker noise of the bias: B of IEEE Std 952, whose Allan deviation is
        flat at √(2 ln 2/π) B = 0.664 B.
    """

    density: float
    walk: float
    instability: float = 0.0


@dataclass(frozen=True)
class NoiseModel:
    """The noise of each axis of the gyroscope and of the accelerometer."""

    gyro: Noise
    accel: Noise


#: The ADIS16448 of EuRoC, as its ``sensor.yaml`` has it.
EUROC = NoiseModel(gyro=Noise(1.6968e-4, 1.9393e-5), accel=Noise(2.0e-3, 3.0e-3))


def simulate_noise(
    count: int, rate_hz: float, noise: NoiseModel, source: np.random.Generator
) -> np.ndarray:
    """
    Return noise to be added to true angular rates and specific forces.

    :param count: the number of samples, N.
    :param source: of the random numbers; the axes are independent of each other.
    :return: (N, 6) gyroscope x y z in rad/s, accelerometer x y z in m/s²; all biases begin at 0.
    """
    axes = (noise.gyro,) * 3 + (noise.accel,) * 3
    samples = np.empty((count, 6))
    for column, axis in enumerate(axes):
        samples[:, column] = simulate_axis(count, rate_hz, axis, source)
    return samples


def simulate_axis(
    count: int, rate_hz: float, noise: Noise, source: np.random.Generator
) -> np.ndarray:
    """Return (N,) samples of one axis at rest; the arguments are those of simulate_noise."""
    samples = source.standard_normal(count)
    samples *= noise.density * np.sqrt(rate_hz)
    if noise.walk:
        samples += np.cumsum(source.normal(0, noise.walk / np.sqrt(rate_hz), count))
    if noise.instability:
        samples += noise.instability * _flicker(source.standard_normal(count))
    return samples


def _flicker(white: np.ndarray) -> np.ndarray:
    """
    Return noise whose two-sided spectral density is 1/(2π f), of unit white noise.

    By half-order integration of the white noise: N. J. Kasdin and T. Walter, Discrete simulation
    of power law noise, IEEE Frequency Control Symposium 1992.
    """
    count = len(white)
    index = np.arange(1, count)
    response = np.cumprod(np.concatenate([[1.0], (index - 0.5) / index]))
    spectrum = np.fft.rfft(white, 2 * count) * np.fft.rfft(response, 2 * count)
    return np.fft.irfft(spectrum, 2 * count)[:count]
