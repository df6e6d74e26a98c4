"""
Baselines: what a suite gave before, and whether it has become worse beyond its own noise.

A stack is not deterministic, so a baseline is the distribution over repeated runs. A metric is
worse when its median moved by more than a rule allows, and a permutation test finds that chance
alone would hardly tell the runs apart like that. The test compares means without the outermost
fifth on either side: they withstand outliers as medians do, but the medians of five runs take too
few values to test with.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
import hashlib
from itertools import combinations
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
from vio_eval_ros.settings import finite

SCHEMA = 'vio_eval_ros.baseline/1'
MAX_BYTES = 1 << 26
RESAMPLES = 9999
SEED = 0
CONFIDENCE = 0.95
TRIMMED = 0.2
MOST_NAMED = 3
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
    relative: float = 0.16
    absolute: float = 0.0
    mad: float = 0.0
    p: float = 0.05

    @classmethod
    def of(cls, metric: str, limits: Any) -> Rule:
        """Return the rule of ``{relative: 0.16, absolute: 0.01, mad: 3, p: 0.05}``."""
        known = cls._fields[1:]
        if not isinstance(limits, Mapping) or not limits.keys() <= set(known):
            raise ConfigError(f'compare {metric}: give any of {", ".join(known)} as numbers')
        numbers = {name: finite(value) for name, value in limits.items()}
        for name, number in numbers.items():
            if not 0 <= number <= (1 if name == 'p' else math.inf):
                least = 'number from 0 to 1' if name == 'p' else 'finite number from 0 on'
                raise ConfigError(f"compare {metric}: {name}: '{limits[name]}' is no {least}")
        sign(metric)
        return cls(metric, **numbers)


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
        if not self.values:
            return math.nan
        return float(np.median(np.abs(np.array(self.values) - self.median)))

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
    """

    rule: Rule
    baseline: Distribution
    candidate: Distribution
    difference: float
    allowed: float
    p_value: float
    worse: bool

    @cached_property
    def interval(self) -> tuple[float, float]:
        """Bootstrap confidence interval (95 %) of the difference; NaN of single runs."""
        if min(len(self.baseline.values), len(self.candidate.values)) < 2:
            return math.nan, math.nan
        return _interval(self.baseline.values, self.candidate.values)

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
    p_value = math.nan
    if not old.values or not new.values:
        worse = bool(old.values)
    else:
        if 1 / math.comb(len(old.values) + len(new.values), len(new.values)) <= rule.p:
            p_value = _p_value(sign(rule.metric), old.values, new.values)
        worse = sign(rule.metric) * difference > allowed and not p_value > rule.p
    return Comparison(rule, old, new, difference, allowed, p_value, worse)


def _p_value(worse: int, old: Sequence[float], new: Sequence[float]) -> float:
    """
    Return how probable a difference like that is if nothing but chance tells the runs apart.

    Of all ways to deal the values out to two groups of these sizes it is the share that sets them
    apart as much; where there are more than RESAMPLES ways, of as many random ones.
    """
    values, size = np.array([*new, *old]), len(new)
    if math.comb(len(values), size) <= RESAMPLES:
        first = np.array(list(combinations(range(len(values)), size)))
        others = np.ones((len(first), len(values)), bool)
        np.put_along_axis(others, first, False, axis=1)
        orders = np.hstack([first, np.nonzero(others)[1].reshape(len(first), -1)])
    else:
        orders = np.tile(np.arange(len(values)), (RESAMPLES, 1))
        orders[1:] = np.random.default_rng(SEED).permuted(orders[1:], axis=1)
    dealt = values[orders]
    apart = worse * (_trimmed_mean(dealt[:, :size]) - _trimmed_mean(dealt[:, size:]))
    # the first is as it was; what equals it may differ in the last bits
    return float(np.mean(apart >= apart[0] - 1e-12 * np.abs(values).max()))


def _trimmed_mean(values: np.ndarray) -> np.ndarray:
    """Return the mean of each row without the outermost fifth on either side."""
    cut = int(TRIMMED * values.shape[1])
    kept = np.sort(values, axis=1)[:, cut : values.shape[1] - cut]
    return np.asarray(kept.mean(axis=1))


def _interval(old: Sequence[float], new: Sequence[float]) -> tuple[float, float]:
    """Return the bootstrap confidence interval (percentiles) of the difference of the medians."""
    random = np.random.default_rng(SEED)
    one, other = (
        np.median(np.array(values)[random.integers(len(values), size=(RESAMPLES, len(values)))], 1)
        for values in (new, old)
    )
    beyond = (1 - CONFIDENCE) / 2
    low, high = np.quantile(one - other, [beyond, 1 - beyond])
    return float(low), float(high)


@dataclass(frozen=True)
class Recorded:
    """
    What a baseline holds of one sequence.

    :param ground_truth_sha256: None where each run has its own, in its recording.
    :param metrics: the values of all runs; none at all where no run could be scored.
    """

    options: Mapping[str, Any]
    ground_truth_sha256: str | None = None
    metrics: Mapping[str, tuple[float, ...]] = field(default_factory=dict)

    @classmethod
    def of(cls, content: Mapping[str, Any]) -> Recorded:
        """Return what the file has of a sequence; ``ValueError`` and others where it is wrong."""
        metrics = {
            metric: tuple(finite(value) for value in of['values'])
            for metric, of in content['metrics'].items()
        }
        for metric, values in metrics.items():
            if not values or any(map(math.isnan, values)):
                raise ValueError(f'{metric} has values that are no numbers, or none')
        truth = content['ground_truth_sha256']
        return cls(dict(content['options']), truth if truth is None else str(truth), metrics)

    def differences(self, now: Recorded) -> Iterator[tuple[str, str]]:
        """Yield which condition is another now, and how."""
        for key in {**self.options, **now.options}:
            before, after = self.options.get(key), now.options.get(key)
            if before != after:
                yield 'options', f'{key} was {before}, is {after}'
        both_scored = self.metrics and now.metrics
        if both_scored and self.ground_truth_sha256 != now.ground_truth_sha256:
            yield 'ground_truth', 'the ground truth is another'


@dataclass(frozen=True)
class Baseline:
    """
    What the sequences of a suite gave before.

    :param definition_sha256: of what each metric meant, see :func:`definition_sha256`.
    """

    definition_sha256: Mapping[str, str]
    sequences: Mapping[str, Recorded]

    @classmethod
    def load(cls, file: Path) -> Baseline:
        """
        Read a baseline.

        :raises ReadError: a file that is not there, truncated, or of another schema.
        """
        try:
            with file.open(encoding='utf-8') as opened:
                content = json.loads(opened.read(MAX_BYTES))
            if content['schema'] != SCHEMA:
                raise ReadError(file, f'is of schema {content["schema"]}, not {SCHEMA}')
            sequences = {name: Recorded.of(one) for name, one in content['sequences'].items()}
            return cls(dict(content['definition_sha256']), sequences)
        except OSError as error:
            raise ReadError(file, error.strerror or str(error)) from None
        except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
            raise ReadError(
                file, f'is no baseline, or a damaged one ({type(error).__name__}: {error})'
            ) from None

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
            found['definition', f'{named}{more} meant something else'] = []
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
                f'(record it anew, or compare all the same with --accept {conditions})'
            )
        return [text for _, text in texts]


def definition_sha256() -> dict[str, str]:
    """
    Return a fingerprint of what each metric means: of the values that a made-up run gets.

    Four digits of them, so that machines and versions agree that differ in the last bits.
    """
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
    values: dict[str, list[str]] = {}
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
                values.setdefault(name, []).append(f'{value:.3e}')
    return {
        name: hashlib.sha256(' '.join(of_runs).encode()).hexdigest()
        for name, of_runs in values.items()
    }
