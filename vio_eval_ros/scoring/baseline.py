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
import re
from typing import Any, NamedTuple

import numpy as np

from vio_eval_ros.core import rotation
from vio_eval_ros.core.cleaning import LARGEST
from vio_eval_ros.core.config import EvaluationConfig
from vio_eval_ros.core.evaluation import Evaluation
from vio_eval_ros.core.trajectory import Trajectory
from vio_eval_ros.errors import ConfigError, ReadError
from vio_eval_ros.settings import finite
from vio_eval_ros.version import __version__

SCHEMA = 'vio_eval_ros.baseline/1'
MAX_BYTES = 1 << 26
RESAMPLES = 9999
SEED = 0
CONFIDENCE = 0.95
TRIMMED = 0.2
USUAL_P = 0.05
#: what stands for no number where one is needed to compute with, times the largest that there is
NO_NUMBER = 1e3
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
    p: float = USUAL_P

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

    :param missing: runs of the candidate without a number, each worse than any other.
    :param difference: of the medians, candidate minus baseline; NaN where one has none.
    :param allowed: by how much it may be worse.
    :param p_value: one-sided; NaN where there are too few runs to tell.
    """

    rule: Rule
    baseline: Distribution
    candidate: Distribution
    missing: int
    difference: float
    allowed: float
    p_value: float
    worse: bool

    @cached_property
    def interval(self) -> tuple[float, float]:
        """Bootstrap confidence interval (95 %) of the difference; NaN of single runs."""
        if self.missing or min(len(self.baseline.values), len(self.candidate.values)) < 2:
            return math.nan, math.nan
        return _interval(self.baseline.values, self.candidate.values)

    @property
    def least_p_value(self) -> float:
        """The smallest p-value that so many runs can have."""
        return _least_p_value(len(self.baseline.values), len(self.candidate.values) + self.missing)

    @property
    def contradicted(self) -> bool:
        """Whether the median is worse by too much, and what is tested is better all the same."""
        way = sign(self.rule.metric)
        return not self.worse and way * self.difference > self.allowed and self.p_value > 0.5

    def to_dict(self) -> dict[str, Any]:
        """Return the comparison as results have it."""
        return {
            'metric': self.rule.metric,
            'baseline': self.baseline.to_dict(),
            'candidate': self.candidate.to_dict(),
            'missing': self.missing,
            'difference': self.difference,
            'relative_difference': self.difference / self.baseline.median
            if self.baseline.median
            else math.nan,
            'allowed': self.allowed,
            'p_value': self.p_value,
            'confidence_interval': list(self.interval),
            'worse': self.worse,
        }


def compare(
    rule: Rule, baseline: Sequence[float], candidate: Sequence[float], missing: int = 0
) -> Comparison:
    """
    Return whether a metric is worse than the baseline's, beyond the noise of both.

    Where most runs of the candidate have no number and the baseline had one, it is worse. With so
    few runs that no outcome could be significant (one and one, say), the limits of the rule
    decide.

    :param missing: runs of the candidate that have no number.
    """
    way = sign(rule.metric)
    old, new = Distribution(tuple(baseline)), Distribution(tuple(candidate))
    all_new = Distribution((*new.values, *[way * math.inf] * missing))
    difference = all_new.median - old.median
    allowed = max(rule.relative * abs(old.median), rule.absolute, rule.mad * old.mad)
    p_value = math.nan
    if not math.isfinite(difference):
        difference, worse = math.nan, bool(old.values)
    else:
        if _least_p_value(len(old.values), len(all_new.values)) <= USUAL_P:
            p_value = _p_value(way, old.values, all_new.values)
        worse = way * difference > allowed and not p_value > rule.p
    return Comparison(rule, old, new, missing, difference, allowed, p_value, worse)


def _least_p_value(old: int, new: int) -> float:
    """Return the smallest p-value that so many runs can have."""
    return 1 / math.comb(old + new, new)


def _p_value(worse: int, old: Sequence[float], new: Sequence[float]) -> float:
    """
    Return how probable a difference like that is if nothing but chance tells the runs apart.

    Of all ways to deal the values out to two groups of these sizes it is the share that sets them
    apart as much; where there are more than RESAMPLES ways, of as many random ones.
    """
    values, size = np.array([*new, *old]), len(new)
    most = np.abs(values[np.isfinite(values)]).max()
    values = np.clip(values, -NO_NUMBER * most, NO_NUMBER * most)
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
    :param ground_truth: which topic it is, and what is stated of it; None where that is not known.
    """

    options: Mapping[str, Any]
    ground_truth_sha256: str | None = None
    metrics: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    ground_truth: str | None = None

    @classmethod
    def of(cls, content: Mapping[str, Any]) -> Recorded:
        """Return what the file has of a sequence; ``ValueError`` and others where it is wrong."""
        metrics = {
            metric: tuple(finite(value) for value in of['values'])
            for metric, of in content['metrics'].items()
        }
        for metric, values in metrics.items():
            if not values or not all(abs(value) < LARGEST for value in values):
                raise ValueError(f'{metric} has values that are no numbers, or none')
        digest, stated = (
            None if truth is None else str(truth)
            for truth in (content['ground_truth_sha256'], content.get('ground_truth'))
        )
        return cls(dict(content['options']), digest, metrics, stated)

    def differences(self, now: Recorded) -> Iterator[tuple[str, str]]:
        """Yield which condition is another now, and how."""
        for key in {**self.options, **now.options}:
            before, after = self.options.get(key), now.options.get(key)
            if before != after:
                yield 'options', f'{key} was {before}, is {after}'
        stated = self.ground_truth, now.ground_truth
        both_scored = self.metrics and now.metrics
        if None not in stated and stated[0] != stated[1]:
            was, is_now = (f"'{text}'" if text else 'all of its file' for text in stated)
            yield 'ground_truth', f'the ground truth was {was}, is {is_now}'
        elif both_scored and self.ground_truth_sha256 != now.ground_truth_sha256:
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
            raise ReadError(file, f'is no baseline, or a damaged one ({damage(error)})') from None

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


def damage(error: Exception) -> str:
    """Return in a few words what is wrong with a file that was thought to be one of ours."""
    if isinstance(error, KeyError):
        return f'there is no {error!s:.100} in it'
    if isinstance(error, (ValueError, ConfigError)):
        return f'{error!s:.200}'
    return 'a part of it is of another kind'


def definition_sha256() -> dict[str, str]:
    """
    Return a fingerprint of what each metric means: of the values that a made-up run gets.

    Four digits of them, so that machines and versions agree that differ in the last bits. Metrics
    of a delta or a length have one for each kind: ``rpe_*s_trans_rmse_m``, whatever the seconds.
    """
    stamps_ns = np.arange(400) * 50_000_000
    seconds = stamps_ns[:, None] / 1e9
    positions = np.hstack([np.sin(seconds), np.cos(0.7 * seconds), np.sin(0.3 * seconds)]) * 70
    turns = rotation.from_rotation_vector(np.hstack([0.3 * seconds, np.sin(seconds), 0 * seconds]))
    truth = Trajectory(stamps_ns, positions, turns)

    def estimate(scale: float) -> Trajectory:
        wobble = rotation.from_rotation_vector(0.02 * np.sin([7.0, 5.0, 3.0] * seconds))
        moved = scale * positions + 0.7 * np.cos([5.0, 3.0, 8.0] * seconds)
        covariances = np.tile(0.01 * np.eye(3), (400, 2, 1, 1))
        turned = rotation.multiply(wobble, turns)
        return Trajectory(stamps_ns + 3_000_000, moved, turned, covariances)[::2]

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
    """Return a metric with ``*`` in place of a number that the user chose."""
    return re.sub(r'^(rpe|segment)_[0-9.]+(?=[fsmd]_)', r'\1_*', metric)
