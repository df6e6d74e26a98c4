"""Measures how long ten figures of ten runs take, and a figure of a million poses."""

from __future__ import annotations

from time import perf_counter

import numpy as np

import vio_eval_ros as vio
from vio_eval_ros.figures.catalogue import FIGURES, pages
from vio_eval_ros.simulation import simulate

RUNS = 10
POSES = 1_000_000


def main() -> None:
    """Print the seconds of both."""
    flight = simulate(duration_s=120.0)
    result = vio.evaluate(flight.estimate, flight.ground_truth)
    names = list(FIGURES)[:10]
    begin = perf_counter()
    content = pages(names, {f'run {k}': result for k in range(RUNS)})
    told = f'{len(content) / 1e6:.1f} MB of PDF'
    print(f'{len(names)} figures of {RUNS} runs: {perf_counter() - begin:.1f} s, {told}')

    stamps = np.arange(POSES) * 5_000_000
    phase = stamps / 3e11
    truth = np.stack([np.cos(phase), np.sin(phase), phase], axis=1) * 20
    noise = np.random.default_rng(0).normal(0, 0.02, truth.shape)
    one = vio.evaluate((stamps, truth + noise, None), (stamps, truth, None))
    for name in ('top', 'xyz', 'errors', 'error_path'):
        begin = perf_counter()
        content = pages([name], {'VIO': one})
        told = f'{len(content) / 1e3:.0f} kB of PDF'
        print(f'{name} of {POSES:,} poses: {perf_counter() - begin:.1f} s, {told}')


if __name__ == '__main__':
    main()
