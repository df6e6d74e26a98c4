"""What ``/diagnostics`` says of a live evaluation."""

from __future__ import annotations

from collections.abc import Mapping
import math
from typing import TYPE_CHECKING

from diagnostic_msgs.msg import DiagnosticStatus, KeyValue

from vio_eval_ros.core.gates import judge
from vio_eval_ros.reports.text import number

if TYPE_CHECKING:
    from vio_eval_ros.nodes.evaluator_node import Evaluator

LOW_COVERAGE = 0.9
DIVERGED_FACTOR = 10.0
DIVERGED_M = 10.0


def status_messages(node: Evaluator) -> list[DiagnosticStatus]:
    """Return the statuses accuracy, association, streams and diagnosis."""
    return [_accuracy(node), _association(node), _streams(node), _diagnosis(node)]


def _status(
    name: str, level: bytes, message: str, values: Mapping[str, object]
) -> DiagnosticStatus:
    return DiagnosticStatus(
        name=f'vio_evaluator: {name}',
        hardware_id='vio_evaluator',
        level=level,
        message=message,
        values=[KeyValue(key=key, value=str(value)) for key, value in values.items()],
    )


def _accuracy(node: Evaluator) -> DiagnosticStatus:
    level, message = DiagnosticStatus.OK, 'running'
    values = {name: value for name, value in node.values.items() if name != 'coverage_ratio'}
    if not values.get('pairs'):
        return _status('accuracy', DiagnosticStatus.WARN, 'no pairs yet', values)
    gates = [gate for gate in node.gates if gate.metric in values]
    broken = [verdict for verdict in judge(gates, values) if not verdict.passed]
    if diverged(node.window, node.run.estimate_path_m(node.settings.window_s)):
        level, message = DiagnosticStatus.ERROR, 'the estimate has diverged'
    elif broken:
        gate, value, _ = broken[0]
        level, message = DiagnosticStatus.ERROR, f'gate {gate} is broken: {number(value)}'
    elif math.isnan(values['ate_trans_rmse_m']):
        level, message = DiagnosticStatus.WARN, 'the alignment is not determined yet'
    if node.note:
        level = max(level, DiagnosticStatus.WARN)
        message = f'{message}; {node.note}'
    return _status('accuracy', level, message, values)


def _association(node: Evaluator) -> DiagnosticStatus:
    associator = node.run.evaluation.associator
    coverage = node.values.get('coverage_ratio', math.nan)
    values: dict[str, object] = {
        'pairs': node.values.get('pairs', 0),
        'coverage_ratio': coverage,
        'matched_ratio': node.values.get('matched_ratio', math.nan),
    }
    for name, stream in (
        ('estimate', associator.estimate),
        ('ground_truth', associator.ground_truth),
    ):
        values[f'{name}_poses'] = stream.used
        values |= {f'{name}_{reason}': n for reason, n in stream.counts.dropped.items()}
    if node.values and not node.values['pairs']:
        return _status(
            'association', DiagnosticStatus.WARN, node.run.evaluation.no_pairs(), values
        )
    if not node.values:
        return _status('association', DiagnosticStatus.WARN, node.run.waiting_for(), values)
    if coverage < LOW_COVERAGE:
        message = f'only {100 * coverage:.1f} % of the ground truth was tracked'
        return _status('association', DiagnosticStatus.WARN, message, values)
    return _status('association', DiagnosticStatus.OK, 'running', values)


def _streams(node: Evaluator) -> DiagnosticStatus:
    values: dict[str, object] = {}
    problems, stale = [], []
    for stream in node.streams:
        values |= {
            f'{stream.name}_topic': stream.topic,
            f'{stream.name}_type': stream.msgtype,
            f'{stream.name}_publishers': stream.publishers,
            f'{stream.name}_received': stream.received,
            f'{stream.name}_lost': stream.lost,
            f'{stream.name}_incompatible_qos': stream.incompatible,
            f'{stream.name}_left_over': stream.left_over,
        }
        if stream.trouble:
            problems.append(stream.trouble)
        elif not stream.received:
            problems.append(f'nothing received on {stream.topic}')
        elif stream.silent_s() > node.settings.stale_after_s:
            stale.append(f'nothing on {stream.topic} for {stream.silent_s():.0f} s')
    if problems:
        return _status('streams', DiagnosticStatus.WARN, '; '.join(problems + stale), values)
    if stale:
        return _status('streams', DiagnosticStatus.STALE, '; '.join(stale), values)
    return _status('streams', DiagnosticStatus.OK, 'running', values)


def _diagnosis(node: Evaluator) -> DiagnosticStatus:
    jump = node.run.jump
    values = {} if jump is None else {'jump_stamp_ns': jump[0], 'jump_m': jump[1]}
    if jump is None:
        return _status('diagnosis', DiagnosticStatus.OK, 'nothing unusual', values)
    message = f'the estimate jumped by {number(jump[1])} m at {jump[0] / 1e9:.3f} s'
    return _status('diagnosis', DiagnosticStatus.WARN, message, values)


def diverged(window: Mapping[str, float], estimate_path_m: float) -> bool:
    """Return whether the estimate moved far more in the window than the ground truth did."""
    truth_path_m = window.get('path_length_m', math.nan)
    return estimate_path_m > DIVERGED_FACTOR * truth_path_m + DIVERGED_M
