"""Runs whose figures are known: a circle of ground truth, and estimates that are off by some."""

from collections.abc import Callable
from importlib import import_module
from itertools import count
import os
from pathlib import Path

import numpy as np
import pytest

from vio_eval_ros.core.trajectory import Trajectory
from vio_eval_ros.rendering.tum import tum
from vio_eval_ros.scoring import scoring
from vio_eval_ros.scoring.loading import load_suite
from vio_eval_ros.scoring.results import SuiteResult
from vio_eval_ros.scoring.scoring import score_suite

SECONDS = np.arange(0.0, 20.0, 0.05)
ANGLES = 0.2 * np.pi * SECONDS  # two whole rounds
X = np.array([1.0, 0.0, 0.0])
CIRCLE = Trajectory(
    (1e9 * SECONDS).astype(np.int64) + 1_400_000_000_000_000_000,
    np.column_stack([np.cos(ANGLES), np.sin(ANGLES), 0 * ANGLES]),
    np.column_stack([0 * ANGLES, 0 * ANGLES, np.sin(ANGLES / 2), np.cos(ANGLES / 2)]),
)


class Lab:
    """
    A folder with a ground truth, ``gt.tum``, a circle of 1 m radius.

    A suite in it has ``alignment: none``, so that a run that is off by 0.1 m has that ATE.
    """

    circle = CIRCLE

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        (folder / 'gt.tum').write_text(tum(CIRCLE))

    def run(self, name: str, off_m: float, until: float = 1.0) -> None:
        """Write a run that is off by so much, and that ended at this share of the time."""
        path = self.folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        poses = CIRCLE[: round(until * len(CIRCLE))]
        moved = Trajectory(poses.stamps_ns, poses.positions + off_m * X, poses.rotations)
        path.write_text(tum(moved))

    def runs(self, folder: str, *off_m: float) -> None:
        """Write a run for each error."""
        for k, one in enumerate(off_m):
            self.run(f'{folder}/{k}.tum', one)

    def suite(self, *sequences: str, top: str = '') -> Path:
        """Write a suite; a sequence is ``NAME`` or ``NAME, more: of it``, with runs in NAME."""
        lines = ['options: {alignment: none, rpe_deltas: [1f]}', top, 'sequences:']
        for sequence in sequences:
            name, _, more = sequence.partition(', ')
            own = '' if 'estimate:' in more else f', estimate: "{name}/*.tum"'
            lines.append(f'  - {{name: {name}, ground_truth: gt.tum{own}, {more}}}')
        path = self.folder / 'suite.yaml'
        path.write_text('\n'.join(lines))
        return path

    def score(self, *sequences: str, top: str = '', jobs: int = 2) -> SuiteResult:
        """Return what a suite is worth."""
        return score_suite(load_suite(self.suite(*sequences, top=top)), jobs)


SABOTEUR = """
import faulthandler, os, signal, sys
from vio_eval_ros.scoring import run

read, original = run.read_sources, run.score_specs


def read_sources(specs, *arguments):
    {statement}
    return read(specs, *arguments)


def score(*arguments):
    run.read_sources = read_sources
    return original(*arguments)
"""


@pytest.fixture
def sabotage(tmp_path_factory, monkeypatch) -> Callable[[str], None]:
    """Return what has a statement executed before the ``specs`` of a run are read."""
    modules = count()

    def sabotaged(statement: str) -> None:
        folder = tmp_path_factory.mktemp('sabotage')
        # a name of its own: the processes of earlier tests may have imported others
        name = f'saboteur_{os.getpid()}_{folder.name}_{next(modules)}'
        (folder / f'{name}.py').write_text(SABOTEUR.format(statement=statement))
        monkeypatch.syspath_prepend(folder)
        monkeypatch.setattr(scoring, 'score_specs', import_module(name).score)

    return sabotaged


@pytest.fixture
def lab(tmp_path: Path) -> Lab:
    return Lab(tmp_path)
