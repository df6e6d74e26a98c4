"""Scores one run of a suite, in whichever process; imports little, since each process does so."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path

from vio_eval_ros.core.config import EvaluationConfig
from vio_eval_ros.errors import VioEvalError
from vio_eval_ros.evaluation.recorded import score_run
from vio_eval_ros.evaluation.result import Result
from vio_eval_ros.recordings.sources import check_times, read_sources, Source
from vio_eval_ros.recordings.spec import Spec


def score_specs(
    estimates: Sequence[str],
    truth: str,
    recording: Path | None,
    times: Path | None,
    config: EvaluationConfig,
) -> Result | str:
    """
    Return the result of a run, or in one line why there is none.

    :param estimates: specs of the estimate and, if there is one, of it as first published.
    :param truth: spec of the ground truth.
    :param recording: what topics without a recording of their own are read from.
    :param times: the stamps of KITTI poses.
    """
    try:
        if Spec.parse(truth).path is None:
            *read, true = read_sources([*estimates, truth], recording, times)
        else:
            read, true = read_sources(estimates, recording, times), _truth(truth, times)
        check_times(times, (*read, true))
        estimate = read[0] if len(read) == 1 else read[0].revising(read[1])
        return score_run(estimate, true, config)
    except (VioEvalError, OSError) as error:
        problem = str(error)
    except Exception as error:
        problem = f'{type(error).__name__}: {error}'
    return ' '.join(problem.split())


@lru_cache(maxsize=2)
def _truth(spec: str, times: Path | None) -> Source:
    """Return a ground truth, which the runs of a sequence share."""
    return read_sources([spec], None, times)[0]
