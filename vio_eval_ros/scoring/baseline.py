"""Baselines: the file of what a suite gave before, and under which conditions."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
import hashlib
import json
from pathlib import Path
import re
from typing import Any

import numpy as np

from vio_eval_ros.comparison.repeated import Distribution
from vio_eval_ros.core import rotation
from vio_eval_ros.core.config import EvaluationConfig
from vio_eval_ros.core.evaluation import Evaluation
from vio_eval_ros.core.orientations import LARGEST_NUMBER
from vio_eval_ros.core.trajectory import Trajectory
from vio_eval_ros.errors import ConfigError, ReadError
from vio_eval_ros.settings import finite
from vio_eval_ros.version import __version__

SCHEMA = 'vio_eval_ros.baseline/1'
MAX_BYTES = 1 << 26
MOST_NAMED = 3
#: what may differ in a baseline that is compared all the same, if that is accepted
CONDITIONS = ('options', 'ground_truth', 'definition')


@dataclass(frozen=True)
class BaselineSequence:
    """
    What a baseline holds of one sequence.

    :param ground_truth_sha256: None where each run has its own, in its recording.
    :param metrics: the values of all runs; empty where no run could be scored.
    :param ground_truth: its topic and stated conventions; None where they are not known.
    """

    options: Mapping[str, Any]
    ground_truth_sha256: str | None = None
    metrics: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    ground_truth: str | None = None

    @classmethod
    def of(cls, content: Mapping[str, Any]) -> BaselineSequence:
        """Return the content of a file on a sequence; ``ValueError`` etc. where it is damaged."""
        metrics = {
            metric: tuple(finite(value) for value in of['values'])
            for metric, of in content['metrics'].items()
        }
        for metric, values in metrics.items():
            if not values or not all(abs(value) < LARGEST_NUMBER for value in values):
                raise ValueError(f'{metric} has no values, or invalid ones')
        digest, stated = (
            None if truth is None else str(truth)
            for truth in (content['ground_truth_sha256'], content.get('ground_truth'))
        )
        return cls(dict(content['options']), digest, metrics, stated)

    def differences(self, now: BaselineSequence) -> Iterator[tuple[str, str]]:
        """Yield each condition that differs now, and how."""
        for key in {**self.options, **now.options}:
            before, after = self.options.get(key), now.options.get(key)
            if before != after:
                yield 'options', f'{key} was {before}, now {after}'
        stated = self.ground_truth, now.ground_truth
        both_scored = self.metrics and now.metrics
        if None not in stated and stated[0] != stated[1]:
            was, is_now = (f"'{text}'" if text else 'the whole file' for text in stated)
            yield 'ground_truth', f'the ground truth was {was}, now {is_now}'
        elif both_scored and self.ground_truth_sha256 != now.ground_truth_sha256:
            yield 'ground_truth', 'the ground truth has changed'


@dataclass(frozen=True)
class Baseline:
    """
    What the sequences of a suite gave before.

    :param definition_sha256: of the definition of each metric, see :func:`definition_sha256`.
    """

    definition_sha256: Mapping[str, str]
    sequences: Mapping[str, BaselineSequence]

    @classmethod
    def load(cls, file: Path) -> Baseline:
        """
        Read a baseline.

        :raises ReadError: the file is missing, truncated, or of another schema.
        """
        try:
            with file.open(encoding='utf-8') as opened:
                content = json.loads(opened.read(MAX_BYTES))
            if content['schema'] != SCHEMA:
                raise ReadError(file, f'has the schema {content["schema"]}, not {SCHEMA}')
            sequences = {
                name: BaselineSequence.of(one) for name, one in content['sequences'].items()
            }
            return cls(dict(content['definition_sha256']), sequences)
        except OSError as error:
            raise ReadError(file, error.strerror or str(error)) from None
        except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
            raise ReadError(file, f'is not a baseline, or is damaged ({damage(error)})') from None

    def to_json(self) -> str:
        """Return the baseline as its file has it."""
        content = {
            'schema': SCHEMA,
            'tool': {'name': 'vio_eval_ros', 'version': __version__},
            'definition_sha256': dict(self.definition_sha256),
            'sequences': {
                name: {
                    'options': dict(one.options),
                    'ground_truth_sha256': one.ground_truth_sha256,
                    'ground_truth': one.ground_truth,
                    'metrics': {
                        metric: {
                            'values': list(values),
                            'median': Distribution(values).median,
                            'mad': Distribution(values).mad,
                        }
                        for metric, values in one.metrics.items()
                        if values
                    },
                }
                for name, one in self.sequences.items()
            },
        }
        return json.dumps(content, indent=2, allow_nan=False) + '\n'

    def check(
        self, current: Mapping[str, BaselineSequence], accepted: Iterable[str] = ()
    ) -> list[str]:
        """
        Return the accepted differences between the conditions of the baseline and those of now.

        :param accepted: any of ``CONDITIONS``.
        :raises ConfigError: other conditions differ; the message says which.
        """
        found: dict[tuple[str, str], list[str]] = {}
        meant = definition_sha256()
        others = [
            name
            for name, digest in self.definition_sha256.items()
            if meant.get(name, digest) != digest
        ]
        if others:
            more = f' and {len(others) - MOST_NAMED} more' if len(others) > MOST_NAMED else ''
            named = ', '.join(others[:MOST_NAMED])
            found['definition', f'{named}{more} had another definition'] = []
        for name, now in current.items():
            if name in self.sequences:
                for difference in self.sequences[name].differences(now):
                    found.setdefault(difference, []).append(name)
        texts = [
            (condition, f'{", ".join(names)}: {what}' if names else what)
            for (condition, what), names in found.items()
        ]
        refused = [(condition, text) for condition, text in texts if condition not in accepted]
        if refused:
            conditions = ' '.join(dict.fromkeys(condition for condition, _ in refused))
            raise ConfigError(
                f'the baseline cannot be compared: {"; ".join(text for _, text in refused)} '
                f'(record it again, or compare all the same with --accept {conditions})'
            )
        return [text for _, text in texts]


def damage(error: Exception) -> str:
    """Return in a few words what is wrong with the content of a file."""
    if isinstance(error, KeyError):
        return f'{error!s:.100} is missing'
    if isinstance(error, (ValueError, ConfigError)):
        return f'{error!s:.200}'
    return 'a field has the wrong type'


def definition_sha256() -> dict[str, str]:
    """
    Return a fingerprint of the definition of each metric: of its values for a synthetic run.

    Values are rounded to four digits, since machines and versions differ in the last bits.
    Metrics of a delta or a length share one per kind: ``rpe_*s_trans_rmse_m`` for any seconds.
    """
    stamps_ns = np.arange(400) * 50_000_000
    seconds = stamps_ns[:, None] / 1e9
    positions = np.hstack([np.sin(seconds), np.cos(0.7 * seconds), np.sin(0.3 * seconds)]) * 70
    rotations = rotation.from_rotation_vector(
        np.hstack([0.3 * seconds, np.sin(seconds), 0 * seconds])
    )
    truth = Trajectory(stamps_ns, positions, rotations)

    def estimate(scale: float) -> Trajectory:
        wobble = rotation.from_rotation_vector(0.02 * np.sin([7.0, 5.0, 3.0] * seconds))
        moved = scale * positions + 0.7 * np.cos([5.0, 3.0, 8.0] * seconds)
        covariances = np.tile(0.01 * np.eye(3), (400, 2, 1, 1))
        rotated = rotation.multiply(wobble, rotations)
        return Trajectory(stamps_ns + 3_000_000, moved, rotated, covariances)[::2]

    def evaluated(config: EvaluationConfig, scale: float) -> Evaluation:
        evaluation = Evaluation(config)
        evaluation.add_estimate(estimate(scale))
        evaluation.add_ground_truth(truth)
        evaluation.flush()
        return evaluation

    values: dict[str, list[str]] = {}
    for association in ('nearest', 'interpolate'):
        for alignment in ('none', 'posyaw', 'se3', 'sim3'):
            config = EvaluationConfig(
                association=association,
                alignment=alignment,
                rpe_deltas=('1f', '0.5s', '30m', '20d'),
                segment_lengths_m=(150.0,),
            )
            evaluation = evaluated(config, 1.05)
            causal = evaluated(config, 1.1).summary().metrics
            for name, value in evaluation.summary(causal).metrics.items():
                values.setdefault(family(name), []).append(f'{value:.3e}')
    return {
        name: hashlib.sha256(' '.join(of_runs).encode()).hexdigest()
        for name, of_runs in values.items()
    }


def family(metric: str) -> str:
    """Return the name of a metric with ``*`` in place of the number that the user chose."""
    return re.sub(r'^(rpe|segment)_[0-9.]+(?=[fsmd]_)', r'\1_*', metric)
