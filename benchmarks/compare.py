"""
Times replay against evo on the same files, whole processes side by side.

Writes the section Replay of docs/benchmarks.md, with --quick only prints; exits with 1 where a
target is missed.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
import json
import os
from pathlib import Path
import re
from statistics import median
import sys
import sysconfig
from tempfile import TemporaryDirectory
import time
from typing import NamedTuple

import document
from document import machine, ranged, Target, targets_table

# This process stays small and imports no numpy: Linux counts the memory of the process that
# starts another in the peak of the other.
PROJECT = Path(__file__).resolve().parents[1]
DATA = Path(os.environ.get('VIO_EVAL_ROS_DATA', PROJECT.parent / 'shared' / 'data'))
MAX_DIFFERENCE = '0.01'  # evo's default
REPLAY = [sys.executable, '-m', 'vio_eval_ros', 'replay']
EVO = {
    name: [sys.executable, str(Path(sysconfig.get_path('scripts'), name))]
    for name in ('evo_ape', 'evo_rpe')
}
BOTH = 'evo_ape + evo_rpe'
RECORDINGS = {
    'ROS 1 bag': ('bag', 'euroc_V1_02_vins_fusion.bag'),
    'rosbag2 sqlite3': ('bag2', 'euroc_V1_02_vins_fusion_sqlite3'),
    'rosbag2 mcap': ('bag2', 'euroc_V1_02_vins_fusion_mcap'),
}


class Usage(NamedTuple):
    """What a process took."""

    seconds: float
    mebibytes: float


@dataclass
class Case:
    """
    An input and the processes that are compared on it.

    :param rounds: how often each process is run, in turn with the others.
    :param usages: of each process, one a round.
    """

    title: str
    commands: dict[str, list[str]]
    rounds: int
    usages: dict[str, list[Usage]] = field(default_factory=dict)

    def ratios(self, name: str, quantity: str) -> list[float]:
        """Return what a process took over what replay took, of each round."""
        return [
            getattr(theirs, quantity) / getattr(ours, quantity)
            for theirs, ours in zip(self.usages[name], self.usages['replay'], strict=True)
        ]


class Bench:
    """Runs processes one at a time, in an environment of their own."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._output = folder / 'output'
        self._messages = folder / 'messages'
        # evo writes its settings at its first start; both leave compiled modules behind
        own = {
            'HOME': str(folder),
            'PYTHONPYCACHEPREFIX': str(folder / 'compiled'),
            'PYTHONPATH': str(PROJECT),
        }
        self._environment = {
            name: value for name, value in os.environ.items() if name != 'PYTHONDONTWRITEBYTECODE'
        } | own

    def run(self, command: Sequence[str]) -> Usage:
        """Return what a process took, from its start to its end; it must succeed."""
        # neither draws a progress bar when its messages go to a file
        files = [
            (os.POSIX_SPAWN_OPEN, descriptor, path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600)
            for descriptor, path in ((1, self._output), (2, self._messages))
        ]
        begin = time.perf_counter()
        child = os.posix_spawn(command[0], command, self._environment, file_actions=files)
        _, status, usage = os.wait4(child, 0)
        seconds = time.perf_counter() - begin
        if status:
            sys.exit(f'{" ".join(command)}\n{self._messages.read_text(encoding="utf-8")}')
        return Usage(seconds, usage.ru_maxrss / (1 << 10 if sys.platform == 'linux' else 1 << 20))

    def output(self, command: Sequence[str]) -> str:
        """Return what a process prints."""
        self.run(command)
        return self._output.read_text(encoding='utf-8')

    def measure(self, case: Case) -> None:
        """Fill in the usages; the processes of a round run in turn, in changing order."""
        names = list(case.commands)
        case.usages = {name: [] for name in names}
        for k in range(case.rounds):
            for name in names[k % len(names) :] + names[: k % len(names)]:
                case.usages[name].append(self.run(case.commands[name]))

    def check(self, case: Case) -> None:
        """Exit unless replay and evo find the same errors; the first run of each warms up."""
        metrics = json.loads(self.output([*case.commands['replay'], '--json']))['metrics']
        for name, metric in (('evo_ape', 'ate_trans_rmse_m'), ('evo_rpe', 'rpe_1f_trans_rmse_m')):
            found = re.search(r'rmse\s+(\S+)', self.output(case.commands[name]))
            if not found or abs(metrics[metric] - float(found[1])) > 1e-6:
                sys.exit(f'{case.title}: {name} does not find {metric} {metrics[metric]}')


def replay(truth: Path, estimate: Path) -> list[str]:
    """Return the command that scores a pair of files, with all that replay does by default."""
    return [
        *REPLAY,
        '--estimate',
        str(estimate),
        '--ground-truth',
        str(truth),
        '--max-difference-s',
        MAX_DIFFERENCE,
    ]


def of_files(folder: Path, name: str, title: str, rounds: int) -> Case:
    """Return the comparison on a pair of TUM files."""
    truth, estimate = (folder / f'{name}_{side}.txt' for side in ('truth', 'estimate'))
    evo = ['tum', str(truth), str(estimate), '--t_max_diff', MAX_DIFFERENCE]
    return Case(
        title,
        {
            'replay': replay(truth, estimate),
            'evo_ape': [*EVO['evo_ape'], *evo, '-a'],
            'evo_rpe': [*EVO['evo_rpe'], *evo],
        },
        rounds,
    )


def of_recordings(rounds: int) -> Iterator[Case]:
    """Yield a comparison for each format of the recorded EuRoC run that is there."""
    truth, estimate = '/ground_truth/pose', '/vio/odometry'
    for title, (kind, name) in RECORDINGS.items():
        path = DATA / 'derived_bags' / name
        if not path.exists():
            print(f'no {title} to measure: {path.name} is not there')
            continue
        evo = [kind, str(path), truth, estimate, '--t_max_diff', MAX_DIFFERENCE]
        yield Case(
            f'V1_02, {title}',
            {
                'replay': [
                    *REPLAY,
                    str(path),
                    '--estimate',
                    estimate,
                    '--ground-truth',
                    truth,
                    '--max-difference-s',
                    MAX_DIFFERENCE,
                ],
                'evo_ape': [*EVO['evo_ape'], *evo, '-a'],
                'evo_rpe': [*EVO['evo_rpe'], *evo],
            },
            rounds,
        )


def growth(bench: Bench, rounds: int) -> Case:
    """Return how long replay takes for 100, 100,000 and 1,000,000 poses on each side."""
    names = {'100': 'hundred', '100,000': 'hundred_thousand', '1,000,000': 'million'}
    case = Case(
        'replay alone',
        {
            count: replay(
                bench.folder / f'{name}_truth.txt', bench.folder / f'{name}_estimate.txt'
            )
            for count, name in names.items()
        },
        rounds,
    )
    bench.measure(case)
    return case


def faster(case: Case, limit: float) -> Target:
    """Return how many times faster than evo_ape replay is."""
    ratios = case.ratios('evo_ape', 'seconds')
    return Target(
        f'{case.title}: at least {limit:g} times as fast as `evo_ape` alone',
        ranged(ratios, 1),
        median(ratios) >= limit,
    )


def smaller(case: Case, limit: float) -> Target:
    """Return how much of evo_ape's memory replay needs."""
    ratios = [1 / ratio for ratio in case.ratios('evo_ape', 'mebibytes')]
    return Target(
        f'{case.title}: at most {limit:g} of the memory of `evo_ape`',
        ranged(ratios, 2),
        median(ratios) <= limit,
    )


def linear(case: Case, limit: float) -> Target:
    """Return how many times more time a pose takes among a million than among 100,000."""
    rounds = zip(
        *([usage.seconds for usage in usages] for usages in case.usages.values()), strict=True
    )
    ratios = [(long - start) / (short - start) / 10 for start, short, long in rounds]
    return Target(
        f'Time per pose, without process start: for 1,000,000 poses at most {limit:g} times that '
        'for 100,000',
        ranged(ratios, 2),
        median(ratios) <= limit,
    )


def table(cases: Sequence[Case]) -> Iterator[str]:
    """Yield the lines of a Markdown table of what each process took."""
    yield '| input | process | time [s] | × replay | peak memory [MiB] | × replay |'
    yield '|---|---|---:|---:|---:|---:|'
    for case in cases:
        case.usages[BOTH] = [
            Usage(a.seconds + b.seconds, max(a.mebibytes, b.mebibytes))
            for a, b in zip(case.usages['evo_ape'], case.usages['evo_rpe'], strict=True)
        ]
        for name, usages in case.usages.items():
            seconds, peaks = zip(*usages, strict=True)
            digits = 2 if median(seconds) > 1 else 3
            times, sizes = (
                ('', '')
                if name == 'replay'
                else (
                    ranged(case.ratios(name, 'seconds'), 1),
                    f'{median(case.ratios(name, "mebibytes")):.1f}',
                )
            )
            yield (
                f'| {case.title if name == "replay" else ""} | `{name}` '
                f'| {ranged(seconds, digits)} | {times} | {median(peaks):.0f} | {sizes} |'
            )


def section(targets: Sequence[Target], cases: Sequence[Case], alone: Case | None) -> list[str]:
    """Return the figures as Markdown."""
    lines = [
        '`replay` beside [evo](https://github.com/MichaelGrupp/evo) on the same files. Measured '
        'by `benchmarks/compare.py`.',
        '',
        *targets_table(targets),
        '',
        *table(cases),
        '',
    ]
    if alone:
        lines += [
            '| replay, poses on each side | time [s] | peak memory [MiB] |',
            '|---|---:|---:|',
        ]
        for count, usages in alone.usages.items():
            seconds, peaks = zip(*usages, strict=True)
            lines.append(f'| {count} | {ranged(seconds, 3)} | {median(peaks):.0f} |')
    lines += [
        '',
        'A ratio is the median of the ratios of all rounds. The processes of a round run one '
        'after the other, in an order that changes from round to round '
        f'({", ".join(f"{case.title}: {case.rounds} rounds" for case in cases)}).',
        '',
        'Time is that of the whole process, start included; memory is the largest resident set. '
        'A first run, which is not counted, compiles modules, writes settings and brings the '
        'files into memory. In it both find the same ATE and RPE, to the six decimals that evo '
        'prints.',
        '',
        'One `replay` gives what takes several runs of evo: ATE of position and rotation; RPE of '
        'position, rotation, displacement and distance over 1 frame, 1 s and 10 m from every '
        'pose, each with all statistics; drift over path segments; and the ATE under the other '
        'alignments. `evo_ape -a` gives the ATE of the position, `evo_rpe` the RPE of the '
        'position over 1 frame.',
        '',
        '- EuRoC size: 36,000 true poses at 200 Hz and 3,600 estimates at 20 Hz; the million: '
        '1,000,000 poses at 20 Hz on each side. Simulated, TUM files with 9 decimals.',
        '- V1_02: VINS-Fusion on the EuRoC sequence, the same run in three kinds of '
        'recording, 1,671 true poses at 20 Hz and 845 estimates at 10 Hz.',
        '',
        machine('numpy', 'rosbags', 'evo'),
    ]
    return lines


@contextmanager
def prepared(names: Sequence[str]) -> Iterator[Bench]:
    """Give a bench whose folder has the inputs."""
    with TemporaryDirectory(prefix='vio_eval_ros_') as folder:
        bench = Bench(Path(folder))
        bench.run([sys.executable, str(PROJECT / 'benchmarks' / 'inputs.py'), folder, *names])
        yield bench


def main() -> int:
    """Run all comparisons; return 1 where a target is missed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        '--quick',
        action='store_true',
        help='leave the million poses out, and docs/benchmarks.md as it is',
    )
    quick = parser.parse_args().quick
    with prepared(
        ['euroc'] if quick else ['euroc', 'hundred', 'hundred_thousand', 'million']
    ) as bench:
        euroc = of_files(bench.folder, 'euroc', 'EuRoC size', 7 if quick else 21)
        million = of_files(bench.folder, 'million', 'The million', 3)
        cases = [euroc, *([] if quick else [million]), *of_recordings(3 if quick else 7)]
        for case in cases:
            print(f'{case.title}: {case.rounds} rounds', flush=True)
            bench.check(case)
            bench.measure(case)
        alone = None if quick else growth(bench, 9)
    targets = [faster(euroc, 4)]
    if alone:
        targets += [faster(million, 10), smaller(million, 0.5), linear(alone, 1.1)]
    lines = section(targets, cases, alone)
    print('\n'.join(lines))
    if not quick:
        document.write('Replay', lines)
    return 0 if all(target.met for target in targets) else 1


if __name__ == '__main__':
    sys.exit(main())
