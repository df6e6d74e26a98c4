"""
How often a wrong truth, or a wrong system, is named: published runs of EuRoC that are warped.

``python benchmarks/doubtful_truth.py [--quick]``. Each warp is, after the best rigid alignment, of
twice the median error of the systems: RMS over the run; of a bump, over the part that it is on.
The trajectories are read from the folder that VIO_EVAL_ROS_DATA names.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations
from pathlib import Path
import sys
import tempfile

import numpy as np
from systems import put_into
import yaml

import vio_eval_ros as vio
from vio_eval_ros.comparison.doubts import shared_positions
from vio_eval_ros.comparison.hat import Doubt, TRUTH, unaligned, which_is_wrong

WARPS = ('bump', 'bend', 'axis', 'drift', 'yaw', 'jump')
SIZE = 2.0
TRUTH_GOAL, SYSTEM_GOAL = 0.95, 0.90
TIMES = 40


class Group:
    """Systems on a sequence at the stamps that they share."""

    def __init__(self, stamps_ns: np.ndarray, truth: np.ndarray, systems: dict[str, np.ndarray]):
        self.stamps_ns, self.truth, self.systems = stamps_ns, truth, systems
        errors = unaligned(np.stack(list(systems.values())) - truth, truth)
        self.error_m = float(np.median(np.sqrt(np.mean(np.sum(errors**2, axis=2), axis=1))))

    def doubt(
        self, truth: np.ndarray | None = None, changed: dict[str, np.ndarray] | None = None
    ) -> Doubt:
        """Return which is wrong, with another truth or other positions of some systems."""
        systems = {**self.systems, **(changed or {})}
        return which_is_wrong(self.stamps_ns, self.truth if truth is None else truth, systems)

    def warp(self, kind: str, source: np.random.Generator) -> np.ndarray:
        """Return (N, 3) metres by which positions are wrong."""
        along = np.linspace(0, 1, len(self.truth))
        part = np.ones(len(along), dtype=bool)
        arms = self.truth - self.truth.mean(axis=0)
        way = source.normal(size=3)
        way /= np.linalg.norm(way)
        begin, length = source.uniform(0, 0.65), source.uniform(0.1, 0.35)
        ramp = np.clip((along - begin) / length, 0, 1)[:, None]
        if kind == 'bump':
            part = (along > begin) & (along < begin + length)
            found = np.sin(np.pi * ramp) ** 2 * way
        elif kind == 'bend':
            found = arms[:, [source.integers(3)]] ** 2 * way
        elif kind == 'axis':
            found = arms * np.eye(3)[source.integers(3)]
        elif kind == 'drift':
            found = ramp * way
        elif kind == 'yaw':
            found = ramp * np.cross([0, 0, 1], arms)
        else:
            found = (along > source.uniform(0.2, 0.8))[:, None] * way
        left = unaligned(found[None], self.truth)[0, part]
        return found * SIZE * self.error_m / np.sqrt(np.mean(np.sum(left**2, axis=1)))


def groups(folder: Path) -> Iterator[tuple[str, Group]]:
    """Yield the systems of each sequence."""
    suite = yaml.safe_load(put_into(folder).read_text())
    for sequence in suite['sequences']:
        runs = {}
        for one in suite['systems']:
            spec = str(folder / one['estimate'].format(sequence=sequence))
            if Path(spec.split('?')[0]).exists():
                options = {**suite['options'], **one.get('options', {})}
                truth = str(folder / f'truth/{sequence}.txt')
                runs[one['name']] = vio.evaluate(spec, truth, **options)
        yield sequence, Group(*shared_positions(runs))


def named(group: Group, kind: str, times: int, seed: int = 0) -> tuple[float, float, float]:
    """Return how often a warped truth is named, a warped system, and the truth instead of it."""
    source = np.random.default_rng(seed)
    hits = np.zeros((times, 3))
    for k in range(times):
        warp = group.warp(kind, source)
        name = str(source.choice(list(group.systems)))
        of_system = group.doubt(changed={name: group.systems[name] + warp}).wrong
        of_truth = group.doubt(truth=group.truth + warp).wrong
        hits[k] = of_truth == (TRUTH,), name in of_system, of_system == (TRUTH,)
    return tuple(hits.mean(axis=0).tolist())


def without_some(group: Group) -> tuple[int, int]:
    """Return in how many choices of three systems or more the truth is named, and of how many."""
    found = [
        Group(group.stamps_ns, group.truth, {name: group.systems[name] for name in names})
        for count in range(3, len(group.systems))
        for names in combinations(group.systems, count)
    ]
    return sum(one.doubt().wrong == (TRUTH,) for one in found), len(found)


def main(options: list[str]) -> int:
    """Return 1 where a goal is missed."""
    times = 10 if '--quick' in options else TIMES
    means, falsely = [], 0
    with tempfile.TemporaryDirectory() as folder:
        for sequence, group in groups(Path(folder)):
            doubt = group.doubt()
            falsely += doubt.wrong == (TRUTH,)
            print(f'{sequence}: {len(group.systems)} systems, median error {group.error_m:.3f} m')
            print(f'  as it is: {", ".join(doubt.wrong) or doubt.verdict}')
            print('  fewer of its systems: truth named in {} of {}'.format(*without_some(group)))
            rates = np.array([named(group, kind, times) for kind in WARPS])
            for kind, (truth, system, instead) in zip(WARPS, rates, strict=True):
                print(
                    f'  {kind:6} truth {truth:5.0%}   system {system:5.0%} (truth {instead:.0%})'
                )
            means.append(rates[:, :2].mean(axis=0))
            print('  mean   truth {:5.1%}   system {:5.1%}'.format(*means[-1]))
    truth, system = np.mean(means, axis=0)
    print(f'truth {truth:.1%} of {TRUTH_GOAL:.0%}, system {system:.1%} of {SYSTEM_GOAL:.0%}')
    return int(falsely > 0 or truth < TRUTH_GOAL or system < SYSTEM_GOAL)


if __name__ == '__main__':
    sys.exit(main(sys.argv[1:]))
