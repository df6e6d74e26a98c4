"""Limits on metrics: what makes a run pass or fail."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
import math
import re
from typing import Any, NamedTuple

from vio_eval_ros.core.config import nearest_name
from vio_eval_ros.errors import ConfigError

LIMITS = {'max': '<=', 'min': '>='}
SEVERITIES = ('fail', 'warn')


class Gate(NamedTuple):
    """
    A metric and its limit, a ceiling (``<=``) or a floor (``>=``).

    :param severity: ``fail`` or ``warn``: what a value beyond the limit does.
    """

    metric: str
    comparison: str
    limit: float
    severity: str = 'fail'

    @classmethod
    def parse(cls, text: str) -> Gate:
        """Return the gate that ``ate_trans_rmse_m<=0.1`` means."""
        match = re.fullmatch(r'\s*(\S+?)\s*(<=|>=)\s*(\S+)\s*', text)
        if not match:
            raise ConfigError(
                f"gate '{text}': write METRIC<=LIMIT or METRIC>=LIMIT, such as "
                "'ate_trans_rmse_m<=0.1'"
            )
        return cls(match[1], match[2], _limit(match[1], match[3]))

    def checked(self) -> Gate:
        """Return the gate; ``ConfigError`` where one of its parts makes no sense."""
        if self.comparison not in LIMITS.values() or self.severity not in SEVERITIES:
            raise ConfigError(
                f"gate {self.metric}: expected '<=' or '>=', and 'fail' or 'warn', got "
                f"'{self.comparison}' and '{self.severity}'"
            )
        return self._replace(limit=_limit(self.metric, self.limit))

    @classmethod
    def from_mapping(cls, limits: Mapping[str, Any]) -> list[Gate]:
        """Return the gates of ``{metric: {max: number, min: number, warn: number}}``."""
        return [gate for metric, bounds in limits.items() for gate in cls.of(str(metric), bounds)]

    @classmethod
    def of(cls, metric: str, bounds: Any) -> list[Gate]:
        """Return the gates on one metric; ``warn`` is a ceiling or a floor as the other is."""
        known = {*LIMITS, 'warn'}
        if not isinstance(bounds, Mapping) or not bounds or not bounds.keys() <= known:
            raise ConfigError(
                f'gate {metric}: give its limits as {{max: number}}, {{min: number}} or both, and '
                'warn: number beside only one of them'
            )
        gates = [
            cls(metric, LIMITS[bound], _limit(metric, limit))
            for bound, limit in bounds.items()
            if bound in LIMITS
        ]
        if 'warn' in bounds:
            if len(gates) != 1:
                raise ConfigError(
                    f'gate {metric}: warn needs either max or min beside it, not both'
                )
            warning = gates[0]._replace(limit=_limit(metric, bounds['warn']), severity='warn')
            if not gates[0].passes(warning.limit):
                raise ConfigError(
                    f'gate {metric}: warn: {warning.limit:g} is beyond the limit that fails a run'
                )
            gates.append(warning)
        return gates

    def passes(self, value: float) -> bool:
        """Return whether a value is within the limit; NaN never is."""
        return value <= self.limit if self.comparison == '<=' else value >= self.limit

    def __str__(self) -> str:
        """Return the gate as it is written on the command line."""
        return f'{self.metric}{self.comparison}{self.limit!r}'.removesuffix('.0')


class Verdict(NamedTuple):
    """A gate, the value that was measured, and whether it passed."""

    gate: Gate
    value: float
    passed: bool

    @property
    def word(self) -> str:
        """What to call it: ``pass``, or the severity of the gate."""
        return 'pass' if self.passed else self.gate.severity

    def to_dict(self) -> dict[str, Any]:
        """Return the verdict as results have it."""
        gate = self.gate
        return {
            'metric': gate.metric,
            'comparison': gate.comparison,
            'limit': gate.limit,
            'severity': gate.severity,
            'value': self.value,
            'passed': self.passed,
        }


def check_names(gates: Iterable[Gate], known: Iterable[str]) -> None:
    """Raise ``ConfigError`` for a gate on a metric that the evaluation does not give."""
    names = list(known)
    for gate in gates:
        if gate.metric not in names:
            raise ConfigError(
                f"gate '{gate}': there is no metric '{gate.metric}' with these "
                f'options{nearest_name(gate.metric, names)}'
            )


def judge(gates: Iterable[Gate], metrics: Mapping[str, float]) -> list[Verdict]:
    """Return the verdict of each gate."""
    return [
        Verdict(gate, metrics[gate.metric], gate.passes(metrics[gate.metric])) for gate in gates
    ]


def _limit(metric: str, value: Any) -> float:
    try:
        limit = float('nan' if isinstance(value, bool) else value)
    except (TypeError, ValueError, OverflowError):
        limit = math.nan
    if not math.isfinite(limit):
        raise ConfigError(f"gate {metric}: '{value}' is not a finite number")
    return limit
