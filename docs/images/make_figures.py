"""Draws the figures of docs/figures.md: two simulated systems, one of them lost for a while."""

from __future__ import annotations

from dataclasses import replace
import io
from pathlib import Path

import numpy as np
from PIL import Image

import vio_eval_ros as vio
from vio_eval_ros.figures.catalogue import FIGURES, pages
from vio_eval_ros.simulation import simulate

FOLDER = Path(__file__).parent
COLOURS = 48


def main() -> None:
    """Write one picture for each figure."""
    flight = simulate(duration_s=60.0)
    truth, first = flight.ground_truth, flight.estimate
    seconds = (first.stamps_ns - first.stamps_ns[0]) / 1e9
    wander = 0.12 * np.sin(np.outer(seconds, [0.21, 0.13, 0.17]))
    second = replace(first, positions=first.positions + wander)
    runs = {
        'A': vio.evaluate(first, truth),
        'B': vio.evaluate(second[(seconds < 20) | (seconds > 27)], truth),
    }
    for name in FIGURES:
        content = pages([name], runs, 'png', columns=2, style=FOLDER / 'docs.mplstyle')
        image = Image.open(io.BytesIO(content)).convert('RGB').quantize(COLOURS)
        image.save(FOLDER / f'figure_{name}.png', optimize=True)


if __name__ == '__main__':
    main()
