"""Evaluation of one recorded run: from two sources of poses to a result."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from vio_eval_ros.core.cleaning import clean, Cleaning
from vio_eval_ros.core.config import EvaluationConfig
from vio_eval_ros.core.evaluation import Evaluation, Summary
from vio_eval_ros.core.gates import Gate, judge
from vio_eval_ros.core.orientations import why_positions_only
from vio_eval_ros.core.preparation import Preparation
from vio_eval_ros.core.side import Side
from vio_eval_ros.core.steps import distances
from vio_eval_ros.core.trajectory import Poses, Trajectory
from vio_eval_ros.diagnosis.hint import hint
from vio_eval_ros.errors import ConfigError, NoPairs
from vio_eval_ros.evaluation.result import Input, Result
from vio_eval_ros.recordings.agreement import assumed, comparable
from vio_eval_ros.recordings.sources import Source

#: poses of the ground truth that a result keeps for drawing it
MAX_OUTLINE_POSES = 2000


def score_run(
    estimate: Source,
    truth: Source,
    config: EvaluationConfig,
    gates: Iterable[Gate] = (),
    hashed: bool = True,
) -> Result:
    """
    Return how an estimate compares with the ground truth.

    :param hashed: whether to hash the files; only some reports show it.
    :raises ReadError: poses of several publishers take turns in one of them.
    :raises NoPairs: no two stamps match; the message says why.
    :raises ReadError: a side leaves open how it is to be read, and the two do not settle it.
    :raises ConfigError: poses whose orientations say nothing are to be moved to another frame.
    """
    estimate, truth = comparable(estimate, truth, config)
    _check_bodies(config, estimate.poses, truth.poses)
    if config.needs_path:
        config = config.of_path(_path_m(truth.poses, config))
    evaluation = _evaluated(config, estimate.poses, truth.poses)
    causal = None
    if estimate.causal is not None:
        causal = _evaluated(config, estimate.causal, truth.poses).summary().metrics
    summary = evaluation.summary(causal)
    associator = evaluation.associator
    if not len(summary.pairs):
        read = ''.join(f'; {sentence}' for sentence in assumed(estimate, truth))
        raise NoPairs(f'{associator.why_no_pairs()}{read}')
    taken = assumed(estimate, truth)
    warnings = [*taken, *summary.warnings]
    if line := _likely_cause(summary, estimate, truth, config):
        warnings.append(line)
    if _are_same(estimate.poses, truth.poses):
        warnings.append('the estimate and the ground truth are the same')
    result = Result(
        estimate=Input.of(
            estimate.spec,
            estimate.kind,
            associator.estimate,
            offset_s=config.time_offset_s,
            paths=estimate.paths,
        ),
        ground_truth=Input.of(
            truth.spec,
            truth.kind,
            associator.ground_truth,
            paths=truth.paths,
        ),
        config=config,
        summary=replace(summary, warnings=tuple(warnings)),
        verdicts=judge(gates, summary.metrics),
        truth=_outline(config, truth, associator.ground_truth),
        assumed=taken,
    )
    return with_hashes(result) if hashed else result


def with_hashes(
    result: Result, digest: Callable[[tuple[Path, ...]], str | None] | None = None
) -> Result:
    """
    Return the result with the hashes of its files.

    :param digest: gives that of some files; :func:`sha256` by default.
    """
    estimate, truth = (
        replace(one, sha256=(digest or sha256)(one.paths))
        for one in (result.estimate, result.ground_truth)
    )
    return replace(result, estimate=estimate, ground_truth=truth)


def _likely_cause(
    summary: Summary, estimate: Source, truth: Source, config: EvaluationConfig
) -> str | None:
    """Return a line on what makes suspicious figures so, if it is found."""
    named = {'estimate': estimate, 'ground_truth': truth}
    specs = {name: side.spec for name, side in named.items() if side.paths}

    def received() -> tuple[Trajectory, Trajectory]:
        return clean(estimate.poses, Cleaning()), clean(truth.poses, Cleaning())

    return hint(summary.pairs, summary.metrics, config, specs, received)


def _path_m(truth: Poses, config: EvaluationConfig) -> float:
    """Return the metres of path of the ground truth, whether or not the estimate covers it."""
    poses = clean(truth, Cleaning())
    seconds = (poses.stamps_ns - poses.stamps_ns[:1]) / 1e9
    inside = (seconds >= config.start_s) & (seconds <= config.end_s)
    return float(distances(poses.positions[inside])[-1:].sum())


def _check_bodies(config: EvaluationConfig, estimate: Poses, truth: Poses) -> None:
    """Refuse to move positions by orientations that say nothing."""
    for name, poses, preparation in (
        ('estimate', estimate, Preparation.of_estimate(config)),
        ('ground_truth', truth, Preparation.of_ground_truth(config)),
    ):
        if preparation.moves and (why := why_positions_only(poses)):
            raise ConfigError(
                f'{name}_to_body: {why}; it cannot be moved to another frame: leave the option out'
            )


def _are_same(one: Poses, other: Poses) -> bool:
    """Return whether two sources have the same stamps and positions, whatever their names."""
    return np.array_equal(one.stamps_ns, other.stamps_ns) and np.array_equal(
        one.positions, other.positions
    )


def _evaluated(config: EvaluationConfig, estimate: Poses, truth: Poses) -> Evaluation:
    """Return the evaluation of one revision of the estimate."""
    evaluation = Evaluation(config)
    evaluation.add_ground_truth(truth)
    evaluation.add_estimate(estimate)
    evaluation.flush()
    return evaluation


def _outline(config: EvaluationConfig, truth: Source, used: Side) -> Trajectory:
    """Return positions of the body, evenly over the ground truth that was used."""
    count = min(len(truth.poses), MAX_OUTLINE_POSES)
    chosen = np.linspace(0, len(truth.poses) - 1, count).round().astype(int)
    outline = Preparation.of_ground_truth(config).apply(truth.poses[chosen])
    outline = outline.within(used.first_used_ns, used.last_used_ns)
    return Trajectory(outline.stamps_ns, outline.positions)


def sha256(paths: Sequence[Path]) -> str | None:
    """Return the hash of concatenated files; None where one is a pipe."""
    import hashlib

    if not all(path.is_file() for path in paths):
        return None
    digest = hashlib.sha256()
    for path in paths:
        with path.open('rb') as file:
            while block := file.read(1 << 20):
                digest.update(block)
    return digest.hexdigest()
