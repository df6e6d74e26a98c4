"""Several estimates of one ground truth: a result of each, and a matrix of them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Any

from vio_eval_ros.comparison.doubts import doubts
from vio_eval_ros.comparison.hat import Doubt
from vio_eval_ros.comparison.matrix import CellRun, Matrix
from vio_eval_ros.comparison.verdicts import Difference, differences
from vio_eval_ros.core.config import EvaluationConfig
from vio_eval_ros.core.gates import Gate
from vio_eval_ros.core.statistics import without_nan
from vio_eval_ros.errors import VioEvalError
from vio_eval_ros.evaluation.recorded import score_run, sha256, with_hashes
from vio_eval_ros.evaluation.result import Result
from vio_eval_ros.recordings.sources import Source
from vio_eval_ros.version import __version__

SCHEMA = 'vio_eval_ros.comparison/1'


@dataclass(frozen=True, eq=False)
class Comparison:
    """
    What became of each system.

    :param runs: one of each system, by its name, in the order of the user.
    :param chosen: names of the metrics that are compared.
    """

    runs: Mapping[str, CellRun]
    chosen: tuple[str, ...]

    @property
    def results(self) -> Mapping[str, Result]:
        """The result of each system that could be scored."""
        return {name: run.result for name, run in self.runs.items() if run.result is not None}

    @property
    def unscored(self) -> Mapping[str, str]:
        """Why a system could not be scored, by its name."""
        return {name: run.failure for name, run in self.runs.items() if run.result is None}

    @cached_property
    def matrix(self) -> Matrix:
        """The values of the chosen metrics."""
        return Matrix.of_runs(self.runs, self.chosen)

    @property
    def differences(self) -> tuple[Difference, ...]:
        """The difference of the best system from each other one by each metric, with verdicts."""
        return differences(self.matrix)

    @property
    def doubts(self) -> Mapping[str, Doubt]:
        """Which one is wrong, a system or the truth; empty of fewer than two systems."""
        return doubts(self.matrix)

    @property
    def passed(self) -> bool | None:
        """Whether all were scored and no gate failed; None where there are no gates."""
        if self.unscored:
            return False
        verdicts = [result.passed for result in self.results.values()]
        return None if None in verdicts else all(verdicts)

    def to_dict(self) -> dict[str, Any]:
        """Return the comparison as schema ``vio_eval_ros.comparison/1`` has it: no NaN."""
        result = {
            'schema': SCHEMA,
            'tool': {'name': 'vio_eval_ros', 'version': __version__},
            'systems': [
                {
                    'name': name,
                    'result': None if run.result is None else run.result.to_dict(),
                    'error': run.failure if run.result is None else None,
                }
                for name, run in self.runs.items()
            ],
            'matrix': self.matrix.to_dict(),
            'differences': [one.to_dict() for one in self.differences],
            'doubts': {name: one.to_dict() for name, one in self.doubts.items()},
            'verdict': {True: 'pass', False: 'fail', None: None}[self.passed],
        }
        return {name: without_nan(value) for name, value in result.items()}


def scorer(
    truth: Source, config: EvaluationConfig, gates: Sequence[Gate] = (), hashed: bool = True
) -> Callable[[Source], Result]:
    """
    Return what gives the result of an estimate, as :func:`score_run` does.

    :param hashed: whether to hash the files, each of them once.
    """
    digest = cache(sha256)

    def score(estimate: Source) -> Result:
        result = score_run(estimate, truth, config, gates, hashed=False)
        return with_hashes(result, digest) if hashed else result

    return score


def compared(
    estimates: Mapping[str, Source | Exception],
    score: Callable[[Source], Result],
    metrics: Sequence[str],
) -> Comparison:
    """
    Return the comparison of several estimates.

    :param estimates: by the names of their systems; an error where one could not be read.
    :param score: gives the result of an estimate.
    :raises VioEvalError: none could be scored; it says why.
    """
    runs = {name: _run(name, estimate, score) for name, estimate in estimates.items()}
    found = Comparison(runs, tuple(metrics))
    if not found.results:
        told = '; '.join(f'{name}: {why}' for name, why in found.unscored.items())
        raise VioEvalError(f'no system could be scored: {told}')
    return found


def _run(name: str, estimate: Source | Exception, score: Callable[[Source], Result]) -> CellRun:
    if isinstance(estimate, Exception):
        return CellRun(name, None, str(estimate))
    try:
        return CellRun.of(name, score(estimate))
    except (VioEvalError, OSError) as error:
        return CellRun(name, None, str(error))
