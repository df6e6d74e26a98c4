"""
A suite: which runs of which sequences are scored, with which options, against which gates.

These are the values; :mod:`vio_eval_ros.scoring.loading` reads them from YAML.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from vio_eval_ros.comparison.repeated import Rule
from vio_eval_ros.core.config import EvaluationConfig
from vio_eval_ros.core.gates import Gate
from vio_eval_ros.evaluation.result import SUCCESS_GATES
from vio_eval_ros.recordings.spec import Spec
from vio_eval_ros.scoring.baseline import BaselineSequence
from vio_eval_ros.scoring.stack import config_paths

SUCCESS_RATE = 'success_rate'
#: what keeps a lost track from winning; a suite may set other limits, but not omit these gates
DEFAULT_GATES = (*SUCCESS_GATES, Gate(SUCCESS_RATE, '>=', 1.0))
OVER = ('median', 'worst')


@dataclass(frozen=True)
class RunsGate:
    """
    A gate on a metric over repeated runs.

    :param over: ``median``, or the ``worst`` of them.
    """

    gate: Gate
    over: str = 'median'


@dataclass(frozen=True)
class RunSpec:
    """
    Where one run of a sequence is read from.

    :param name: its estimate as the suite names it, with the match in place of the glob.
    :param estimate: spec of the estimate.
    :param recording: what topics without a recording of their own are read from, if anything.
    :param causal: spec of the same run as first published, if there is one.
    :param problem: why there is nothing to score; empty where there is.
    """

    name: str
    estimate: str
    recording: Path | None = None
    causal: str | None = None
    problem: str = ''


@dataclass(frozen=True)
class Sequence:
    """
    The runs of one sequence, and what is required of them.

    :param ground_truth: spec of the ground truth.
    :param rules: when a metric is worse than in the baseline.
    :param band: limits of what the literature has reached: good, plausible, failed [m]; None
        where the file ``bands`` has none for this kind of sensors.
    :param stack: what produced the estimates, and ``calibration`` with which files, for the
        manifest.
    :param times: the stamps of KITTI poses.
    :param system: of which these are the runs; empty in a suite of only one.
    """

    name: str
    runs: tuple[RunSpec, ...]
    ground_truth: str
    config: EvaluationConfig
    gates: tuple[RunsGate, ...]
    rules: tuple[Rule, ...] = ()
    band: Mapping[str, float] | None = None
    bands: Path | None = None
    modality: str | None = None
    tags: tuple[str, ...] = ()
    stack: Mapping[str, Any] = field(default_factory=dict)
    calibration: tuple[Path, ...] = ()
    times: Path | None = None
    system: str = ''

    @property
    def title(self) -> str:
        """The name of the sequence and, where there are several, of the system."""
        return f'{self.name}/{self.system}' if self.system else self.name

    @property
    def paths(self) -> Iterator[Path]:
        """The files and folders that the runs are read from."""
        for run in (run for run in self.runs if not run.problem):
            specs = (run.estimate, run.causal, self.ground_truth)
            found = [run.recording, *(Spec.parse(spec).path for spec in specs if spec is not None)]
            yield from (path for path in (*found, self.times) if path is not None)

    @property
    def conditions(self) -> BaselineSequence:
        """What of a baseline is known before anything is scored."""
        spec = Spec.parse(self.ground_truth)
        stated = '&'.join(f'{name}={value}' for name, value in sorted(spec.statements.items()))
        truth = (spec.topic or '') + (f'?{stated}' if stated else '')
        return BaselineSequence(self.config.to_dict(), ground_truth=truth)

    @property
    def truth_is_recorded(self) -> bool:
        """Whether each run brings a ground truth of its own, in its recording."""
        return Spec.parse(self.ground_truth).path is None

    @property
    def success_gates(self) -> tuple[Gate, ...]:
        """What a single run must keep to be a success: not diverged, and covering enough."""
        wanted = {gate.metric for gate in SUCCESS_GATES}
        return tuple(
            runs.gate
            for runs in self.gates
            if runs.gate.metric in wanted and runs.gate.severity == 'fail'
        )


@dataclass(frozen=True)
class Suite:
    """
    All sequences of a file.

    :param overrides: what was set from outside, ``key.key=value`` each.
    """

    file: Path
    sequences: tuple[Sequence, ...]
    manifest: Path | None = None
    overrides: tuple[str, ...] = ()

    @property
    def has_systems(self) -> bool:
        """Whether systems are compared."""
        return any(one.system for one in self.sequences)

    @property
    def paths(self) -> list[Path]:
        """The files and folders that are read."""
        found = [path for sequence in self.sequences for path in sequence.paths]
        for one in self.sequences:
            config = config_paths(one.stack, self.file.parent)
            documents = (one.bands, *one.calibration, *config)
            found += [path for path in documents if path is not None]
        return list(dict.fromkeys(found))
