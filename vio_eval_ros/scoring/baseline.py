"""
Baselines: what a suite gave before, and whether it has become worse beyond its own noise.

A stack is not deterministic, so a baseline is the distribution over repeated runs. A metric is
worse when its median moved by more than a rule allows, and a permutation test finds that chance
alone would hardly tell the runs apart like that. The test compares means without the outermost
fifth on either side: they withstand outliers as medians do, but the medians of five runs take too
few values to test with.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
import hashlib
import json
import math
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from vio_eval_ros import __version__
from vio_eval_ros.core import rotation
from vio_eval_ros.core.config import EvaluationConfig
from vio_eval_ros.core.evaluation import Evaluation
from vio_eval_ros.core.trajectory import Trajectory
from vio_eval_ros.errors import ConfigError, ReadError

SCHEMA = 'vio_eval_ros.baseline/1'
RESAMPLES = 9999
SEED = 0
CONFIDENCE = 0.95
TRIMMED = 0.2
#: what a baseline can have been made with otherwise, and still be compared on demand
CONDITIONS = ('options', 'ground_truth', 'definition')
HIGHER_IS_BETTER = ('coverage_ratio', 'matched_ratio')
LOWER_IS_BETTER = ('_m', '_deg', '_percent', '_deg_per_m', 'ate_extent_ratio', 'loop_closure_gain')
NEITHER = ('path_length_m',)


class Rule(NamedTuple):
    """
    When a metric is worse than the baseline's.

    Its median must be worse by more than all of ``relative`` (of the baseline's median),
    ``absolute`` and ``mad`` (times the baseline's median absolute deviation), and by chance alone
    with a probability of at most ``p``.
    """

    metric: str
    relative: float = 0.12
    absolute: float = 0.0
    mad: float = 0.0
    p: float = 0.025

    @classmethod
    def of(cls, metric: str, limits: Any) -> Rule:
        """Return the rule of ``{relative: 0.12, absolute: 0.01, mad: 3, p: 0.025}``."""
        names = cls._fields[1:]
        if not isinstance(limits, Mapping) or not limits.keys() <= set(names):
            raise ConfigError(f'compare {metric}: give any of {", ".join(names)} as numbers')
        for name, value in limits.items():
            if isinstance(value, bool) or not isinstance(value, (int, float)) or not value >= 0:
                raise ConfigError(f"compare {metric}: {name}: '{value}' is no number from 0 on")
        sign(metric)
        return cls(metric, **limits)


def sign(metric: str) -> int:
    """Return 1 where a higher value of a metric is worse, -1 where a lower one is."""
    if metric in HIGHER_IS_BETTER:
        return -1
    if metric.endswith(LOWER_IS_BETTER) and metric not in NEITHER:
        return 1
    raise ConfigError(f'compare {metric}: neither more nor less of it is worse')


@dataclass(frozen=True)
class Distribution:
    """A metric over repeated runs; None of it where no run gave a number."""

    values: tuple[float, ...]

    @property
    def median(self) -> float:
        """NaN of nothing."""
        return float(np.median(self.values)) if self.values else math.nan

    @property
    def mad(self) -> float:
        """Median absolute deviation from the median; NaN of nothing."""
        return (
            float(np.median(np.abs(np.array(self.values) - self.median)))
            if self.values
            else (math.nan)
        )

    def to_dict(self) -> dict[str, float]:
        """Return the numbers by which a distribution is told."""
        least, most = (min(self.values), max(self.values)) if self.values else (math.nan,) * 2
        return {
            'median': self.median,
            'mad': self.mad,
            'min': least,
            'max': most,
            'n': len(self.values),
        }


@dataclass(frozen=True)
class Comparison:
    """
    A metric of the candidate beside that of the baseline.

    :param difference: of the medians, candidate minus baseline.
    :param allowed: by how much it may be worse.
    :param p_value: one-sided; NaN where there are too few runs for any to be below the rule's.
    :param interval: bootstrap confidence interval (95 %) of the difference; NaN of single runs.
    """

    rule: Rule
    baseline: Distribution
    candidate: Distribution
    difference: float
    allowed: float
    p_value: float
    interval: tuple[float, float]
    worse: bool

    def to_dict(self) -> dict[str, Any]:
        """Return the comparison as results have it."""
        return {
            'metric': self.rule.metric,
            'baseline': self.baseline.to_dict(),
            'candidate': self.candidate.to_dict(),
            'difference': self.difference,
            'relative_difference': self.difference / self.baseline.median
            if self.baseline.median
            else math.nan,
            'allowed': self.allowed,
            'p_value': self.p_value,
            'confidence_interval': list(self.interval),
            'worse': self.worse,
        }


def compare(rule: Rule, baseline: Sequence[float], candidate: Sequence[float]) -> Comparison:
    """
    Return whether a metric is worse than the baseline's, beyond the noise of both.

    Where the candidate has no number at all and the baseline had one, it is worse. With so few
    runs that no outcome could be significant (one and one, say), the limits of the rule decide.
    """
    old, new = Distribution(tuple(baseline)), Distribution(tuple(candidate))
    difference = new.median - old.median
    allowed = max(rule.relative * abs(old.median), rule.absolute, rule.mad * old.mad)
    p_value, interval = math.nan, (math.nan, math.nan)
    if not old.values or not new.values:
        worse = bool(old.values)
    else:
        if 1 / math.comb(len(old.values) + len(new.values), len(new.values)) <= rule.p:
            p_value, interval = _significance(sign(rule.metric), old.values, new.values)
        beyond = sign(rule.metric) * difference > allowed
        worse = beyond and not p_value > rule.p
    return Comparison(rule, old, new, difference, allowed, p_value, interval, worse)


def _significance(
    worse: int, old: Sequence[float], new: Sequence[float]
) -> tuple[float, tuple[float, float]]:
    """Return the p-value of the difference, and the confidence interval of that of medians."""
    try:
        from scipy.stats import bootstrap, permutation_test, trim_mean
    except ImportError:
        raise ConfigError(
            "a baseline of repeated runs needs scipy: pip install 'vio_eval_ros[score]'"
        ) from None

    def of_middles(one: np.ndarray, other: np.ndarray, axis: int = -1) -> np.ndarray:
        return np.asarray(trim_mean(one, TRIMMED, axis) - trim_mean(other, TRIMMED, axis))

    def of_medians(one: np.ndarray, other: np.ndarray, axis: int = -1) -> np.ndarray:
        return np.asarray(np.median(one, axis=axis) - np.median(other, axis=axis))

    samples = (np.array(new), np.array(old))
    side = 'greater' if worse > 0 else 'less'
    # exact where there are no more permutations than this
    test = permutation_test(
        samples,
        of_middles,
        vectorized=True,
        n_resamples=RESAMPLES,
        alternative=side,
        rng=np.random.default_rng(SEED),
    )
    if min(map(len, samples)) < 2:
        return float(test.pvalue), (math.nan, math.nan)
    interval = bootstrap(
        samples,
        of_medians,
        vectorized=True,
        n_resamples=RESAMPLES,
        confidence_level=CONFIDENCE,
        method='percentile',
        rng=np.random.default_rng(SEED),
    ).confidence_interval
    return float(test.pvalue), (float(interval.low), float(interval.high))


@dataclass(frozen=True)
class Recorded:
    """What a baseline holds of one sequence."""

    options: Mapping[str, Any]
    ground_truth_sha256: str | None
    metrics: Mapping[str, tuple[float, ...]]


@dataclass(frozen=True)
class Baseline:
    """
    What the sequences of a suite gave before.

    :param definition_sha256: of what the metrics meant, see :func:`definition_sha256`.
    """

    definition_sha256: str
    sequences: Mapping[str, Recorded]

    @classmethod
    def load(cls, file: Path) -> Baseline:
        """
        Read a baseline.

        :raises ReadError: a file that is not there, truncated, or of another schema.
        """
        try:
            content = json.loads(file.read_text(encoding='utf-8'))
            if content['schema'] != SCHEMA:
                raise ReadError(file, f'is of schema {content["schema"]}, not {SCHEMA}')
            sequences = {
                name: Recorded(
                    one['options'],
                    one['ground_truth_sha256'],
                    {metric: tuple(of['values']) for metric, of in one['metrics'].items()},
                )
                for name, one in content['sequences'].items()
            }
            return cls(content['definition_sha256'], sequences)
        except OSError as error:
            raise ReadError(file, error.strerror or str(error)) from None
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            raise ReadError(
                file, f'is no baseline, or a damaged one ({type(error).__name__}: {error})'
            ) from None

    def to_json(self) -> str:
        """Return the baseline as its file has it."""
        content = {
            'schema': SCHEMA,
            'tool': {'name': 'vio_eval_ros', 'version': __version__},
            'definition_sha256': self.definition_sha256,
            'sequences': {
                name: {
                    'options': dict(one.options),
                    'ground_truth_sha256': one.ground_truth_sha256,
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

    def check(self, current: Mapping[str, Recorded], accepted: Iterable[str] = ()) -> list[str]:
        """
        Return how the conditions of the baseline differ from those of now, where that is accepted.

        :param accepted: any of ``CONDITIONS``.
        :raises ConfigError: they differ otherwise; the message says which.
        """
        differences = []
        if self.definition_sha256 != definition_sha256():
            differences.append(('definition', 'the metrics were defined otherwise'))
        for name, now in current.items():
            before = self.sequences.get(name)
            if before is None:
                continue
            for key, value in now.options.items():
                if before.options.get(key) != value:
                    problem = f'{name}: {key} was {before.options.get(key)}, is {value}'
                    differences.append(('options', problem))
            if before.ground_truth_sha256 != now.ground_truth_sha256:
                differences.append(('ground_truth', f'{name}: the ground truth is another'))
        refused = [item for item in differences if item[0] not in accepted]
        if refused:
            kinds = ' '.join(dict.fromkeys(kind for kind, _ in refused))
            raise ConfigError(
                f'the baseline cannot be compared: {"; ".join(text for _, text in refused)} '
                f'(record it anew, or compare all the same with --accept {kinds})'
            )
        return [text for _, text in differences]


def definition_sha256() -> str:
    """
    Return a fingerprint of what the metrics mean: of the values that a made-up run gets.

    Six digits, so that machines agree on it though their last bits differ.
    """
    digest = hashlib.sha256()
    stamps_ns = np.arange(400) * 50_000_000
    seconds = stamps_ns[:, None] / 1e9
    positions = np.hstack([np.sin(seconds), np.cos(0.7 * seconds), np.sin(0.3 * seconds)]) * 5
    turns = rotation.from_rotation_vector(np.hstack([0.3 * seconds, np.sin(seconds), 0 * seconds]))
    truth = Trajectory(stamps_ns, positions, turns)
    wobble = rotation.from_rotation_vector(0.02 * np.sin([7.0, 5.0, 3.0] * seconds))
    covariances = np.tile(0.01 * np.eye(3), (400, 2, 1, 1))
    estimate = Trajectory(
        stamps_ns + 3_000_000,
        1.05 * positions + 0.05 * np.cos([5.0, 3.0, 8.0] * seconds),
        rotation.multiply(wobble, turns),
        covariances,
    )[::2]
    for association in ('nearest', 'interpolate'):
        for alignment in ('none', 'posyaw', 'se3', 'sim3'):
            config = EvaluationConfig(
                association=association,
                alignment=alignment,
                rpe_deltas=('1f', '0.5s', '3m', '20d'),
                segment_lengths_m=(10.0,),
            )
            evaluation = Evaluation(config)
            evaluation.add_estimate(estimate)
            evaluation.add_ground_truth(truth)
            evaluation.flush()
            for name, value in evaluation.summary().metrics.items():
                digest.update(f'{association} {alignment} {name} {value:.5e}\n'.encode())
    return digest.hexdigest()
