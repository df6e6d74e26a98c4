"""What ``/diagnostics`` says of a live evaluation."""

from __future__ import annotations

from collections.abc import Mapping
import math
from typing import TYPE_CHECKING

from diagnostic_msgs.msg import DiagnosticStatus, KeyValue

from vio_eval_ros.core.gates import judge, SEVERITIES
from vio_eval_ros.core.trajectory import Pairs
from vio_eval_ros.diagnosis.diagnosis import Cause
from vio_eval_ros.live.monitor import Diagnosing
from vio_eval_ros.recordings.messages import CONVERTERS
from vio_eval_ros.rendering.text import number

if TYPE_CHECKING:
    from vio_eval_ros.ros.evaluator_node import Evaluator
    from vio_eval_ros.ros.pose_topic import PoseTopic

OK, WARN = DiagnosticStatus.OK, DiagnosticStatus.WARN
ERROR, STALE = DiagnosticStatus.ERROR, DiagnosticStatus.STALE

LOW_COVERAGE = 0.9
MANY_DROPPED = 0.01
DIVERGED_FACTOR = 10.0
DIVERGED_M = 10.0
#: of causes, as the names of values have them
UNITS = {'%/min': 'percent_per_min', 'deg/min': 'deg_per_min'}


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
    level, message = OK, 'running'
    elsewhere = ('coverage_ratio', 'matched_ratio')
    values = {name: value for name, value in node.values.items() if name not in elsewhere}
    gates = [gate for gate in node.gates if gate.metric in node.values]
    # those that fail before those that warn
    broken = sorted(
        (verdict for verdict in judge(gates, node.values) if not verdict.passed),
        key=lambda verdict: SEVERITIES.index(verdict.word),
    )
    if not values.get('pairs'):
        level, message = WARN, 'no pairs yet'
    elif _diverged(node):
        level, message = ERROR, 'the estimate has diverged'
    elif broken:
        gate, value, _ = broken[0]
        level = ERROR if gate.severity == 'fail' else WARN
        message = f'gate {gate} is broken: {number(value)}'
    elif (alignment := node.run.evaluation.alignment()).undetermined or math.isnan(
        values['ate_trans_rmse_m']
    ):
        level, message = WARN, 'the alignment is not determined yet'
        if alignment.undetermined:
            message = f'{alignment.undetermined}: {message}'
    troubles = [
        trouble for trouble in (node.problem, *node.reporter.unwritten.values()) if trouble
    ]
    if troubles:
        level, message = max(level, WARN), '; '.join([message, *troubles])
    return _status('accuracy', level, message, values)


def _association(node: Evaluator) -> DiagnosticStatus:
    associator = node.run.evaluation.associator
    coverage = node.values.get('coverage_ratio', math.nan)
    values: dict[str, object] = {
        'pairs': node.values.get('pairs', 0),
        'coverage_ratio': coverage,
        'matched_ratio': node.values.get('matched_ratio', math.nan),
    }
    poor = []
    for name, stream in (
        ('estimate', associator.estimate),
        ('ground_truth', associator.ground_truth),
    ):
        dropped = stream.counts.dropped
        values[f'{name}_poses'] = stream.used
        values |= {f'{name}_{reason}': count for reason, count in dropped.items()}
        if sum(dropped.values()) > MANY_DROPPED * (stream.used + sum(dropped.values())):
            reasons = [f'{n} {reason.replace("_", "-")}' for reason, n in dropped.items() if n]
            poor.append(f'{name.replace("_", " ")}: dropped {", ".join(reasons)}')
    if not values['pairs']:
        return _status('association', WARN, why_no_pairs(node), values)
    if behind := _behind(node):
        poor.insert(0, behind)
    if coverage < LOW_COVERAGE:
        poor.insert(0, f'only {100 * coverage:.1f} % of the ground truth was tracked')
    if poor:
        return _status('association', WARN, '; '.join(poor), values)
    return _status('association', OK, 'running', values)


def _behind(node: Evaluator) -> str:
    """Return which stream does not keep up with the other, if one does not."""
    if node.truth is not None:
        return ''
    estimate_ns, truth_ns = (stream.runs.newest_ns for stream in node.streams)
    ahead_s = (truth_ns - estimate_ns) / 1e9 - node.config.time_offset_s
    if abs(ahead_s) <= node.settings.stale_after_s:
        return ''
    ends = ('estimate', 'ground truth') if ahead_s > 0 else ('ground truth', 'estimate')
    return f'the {ends[0]} ends {abs(ahead_s):.1f} s before the {ends[1]}: no values for the rest'


def why_no_pairs(node: Evaluator) -> str:
    """Return why there is no pair, with what has arrived of both streams."""
    associator = node.run.evaluation.associator
    sides = (associator.estimate, associator.ground_truth)
    dropped = [sum(side.counts.dropped.values()) - side.counts.overflow for side in sides]
    if all(side.used or count for side, count in zip(sides, dropped, strict=True)):
        return node.run.evaluation.no_pairs()
    message = f'no pairs yet: {node.run.waiting_for()}'
    for stream in node.streams:
        if not stream.received and (problems := _problems(stream)):
            message = f'{message}; {"; ".join(problems)}'
    unstamped = [stream.topic for stream in node.streams if stream.runs.unstamped]
    if unstamped:
        return f'{message}; {" and ".join(unstamped)} stamped 0: is there a /clock?'
    return f'{message}; are the clocks the same?' if _apart(node) else message


def _apart(node: Evaluator) -> bool:
    """Return whether both streams have arrived, and have no time in common."""
    offset_ns = round(node.config.time_offset_s * 1e9)
    estimate = node.estimate.runs
    begin_ns, end_ns = estimate.oldest_ns + offset_ns, estimate.newest_ns + offset_ns
    if node.truth is not None:
        stamps_ns = node.truth.poses.stamps_ns
        first_ns, last_ns = int(stamps_ns.min()), int(stamps_ns.max())
    else:
        truth = node.streams[1].runs
        first_ns, last_ns = truth.oldest_ns, truth.newest_ns
    arrived = begin_ns < end_ns and first_ns < last_ns
    return arrived and (begin_ns > last_ns or end_ns < first_ns)


def _streams(node: Evaluator) -> DiagnosticStatus:
    values: dict[str, object] = {'run': node.run_number}
    problems, stale = [], []
    for stream in node.streams:
        values |= {
            f'{stream.name}_topic': stream.topic,
            f'{stream.name}_type': stream.msgtype,
            f'{stream.name}_publishers': stream.publishers,
            f'{stream.name}_received': stream.received,
            f'{stream.name}_lost': stream.lost,
            f'{stream.name}_queue_full': stream.full,
            f'{stream.name}_undecodable': stream.undecodable,
            f'{stream.name}_incompatible_qos': stream.incompatible,
        }
        problems += _problems(stream)
        if stream.received and stream.silent_s() > node.settings.stale_after_s:
            gone = '' if stream.publishers else ', and nobody publishes it'
            stale.append(f'nothing on {stream.topic} for {stream.silent_s():.0f} s{gone}')
    jumped = [f'{s.topic} {s.runs.jumps[0]}' for s in node.streams if s.runs.jumps]
    problems += [f'{jump}: waiting for the other stream to do so' for jump in jumped]
    if node.namesakes:
        problems.append(
            f'there is another {node.get_fully_qualified_name()}: both answer to its services and '
            'write the same report; name one with -r __node:=NAME'
        )
    if node.clock_jumped_s < math.inf:
        problems.append('the clock jumped back: waiting for the streams to do so')
    if problems:
        return _status('streams', WARN, '; '.join(problems + stale), values)
    if stale:
        return _status('streams', STALE, '; '.join(stale), values)
    return _status('streams', OK, 'running', values)


def _problems(stream: PoseTopic) -> list[str]:
    """Return what is wrong with a stream and its publishers."""
    problems = [_publishers(stream)]
    if stream.incompatibility:
        problems.append(f'incompatible QoS on {stream.topic}: {stream.incompatibility}')
    if stream.undecodable:
        problems.append(f'{stream.undecodable} messages on {stream.topic} are no {stream.msgtype}')
    if stream.lost:
        problems.append(f'{stream.lost} messages on {stream.topic} were lost')
    if stream.full:
        problems.append(f'{stream.topic}: {stream.full} times the queue was full')
    problems = [problem for problem in problems if problem]
    if problems or stream.received:
        return problems
    return [f'{"nothing received on" if stream.publishers else "nobody publishes"} {stream.topic}']


def _publishers(stream: PoseTopic) -> str:
    """Return what is wrong with the number or the types of the publishers."""
    listed = ' and '.join(stream.published_types)
    scorable = [msgtype for msgtype in stream.published_types if msgtype in CONVERTERS]
    if listed and not scorable:
        return f'{stream.topic} carries {listed}, which has no pose that can be scored'
    if len(scorable) > 1 and not stream.msgtype:
        return f'{stream.topic} is published as {listed}; set {stream.name}_type to one of them'
    if scorable and stream.msgtype not in scorable:
        remedy = f'set {stream.name}_type' if stream.is_given else 'restart the evaluator'
        return f'{stream.topic} is published as {listed}, not {stream.msgtype}; {remedy}'
    if len(stream.published_types) > 1:
        return f'{stream.topic} is published as {listed}; only {stream.msgtype} is read'
    if stream.publishers > 1:
        return f'{stream.publishers} publishers on {stream.topic}: their poses are mixed'
    return ''


def _diagnosis(node: Evaluator) -> DiagnosticStatus:
    """Say what is wrong: the largest jump at once, all causes as of the last diagnosis."""
    diagnosing, jump = node.run.diagnosing, node.run.largest_jump()
    found = diagnosing.latest
    causes = found.causes if found is not None else ()
    values: dict[str, object] = {}
    messages = []
    if jump is not None:
        messages = [f'the estimate jumped by {number(jump[1])} m at {jump[0] / 1e9:.3f} s']
        values = {'jump_stamp_ns': jump[0], 'jump_m': jump[1]}
        causes = tuple(cause for cause in causes if cause.name != 'jump')
    if diagnosing.problem:
        messages.append(failed(diagnosing))
    unmoved = [cause for cause in causes if cause.name == 'insufficient_motion']
    if causes and not unmoved:
        messages += [f'{cause.name}: {cause.evidence}' for cause in causes[:1]]
        messages += [f'also {", ".join(cause.name for cause in causes[1:])}'] * (len(causes) > 1)
        for k, cause in enumerate(causes, 1):
            values |= {f'cause_{k}': cause.name, **_numbers(cause)}
    if found is not None:
        values |= {
            'diagnosed_pairs': diagnosing.pairs,
            'cannot_tell': ', '.join(found.cannot_tell),
        }
    if messages:
        return _status('diagnosis', WARN, '; '.join(messages), values)
    if node.began_as:
        message = f'run {node.run_number} began as {node.began_as}'
    elif found is None or unmoved:
        message = 'cannot tell yet: too little time or motion so far'
    else:
        message = 'nothing unusual'
    return _status('diagnosis', OK, message, values)


def _numbers(cause: Cause) -> dict[str, object]:
    """Return what there is to say of a cause, under names that begin with its own."""
    unit = f'_{UNITS.get(cause.unit, cause.unit)}'
    sizes = {unit: cause.value, f'_uncertainty{unit}': cause.uncertainty}
    said = {'_confidence': cause.confidence, '_advice': cause.advice}
    return {
        f'{cause.name}{key}': value
        for key, value in {**sizes, **said, '_flags': ' '.join(cause.flags)}.items()
        if not (isinstance(value, float) and math.isnan(value))
    }


def failed(diagnosing: Diagnosing) -> str:
    """Return that there is no diagnosis, for no fault of the run's."""
    return f'the diagnosis failed: this is a bug, please report it: {diagnosing.problem}'


def found_wrong(diagnosing: Diagnosing, pairs: Pairs) -> list[str]:
    """Return a line for each cause that is found in the pairs of a run that has ended."""
    found = diagnosing.conclude(pairs)
    causes = found.causes if found is not None else ()
    if diagnosing.problem:
        return [failed(diagnosing)]
    return [f'{cause.name}: {cause.evidence}. {cause.advice}' for cause in causes]


def _diverged(node: Evaluator) -> bool:
    """
    Return whether the estimate has left the ground truth for good.

    Either it moved far more in the window than the ground truth did, or its error is far larger
    than the extent of the ground truth.
    """
    scale = node.run.evaluation.alignment().scale
    moved_m = scale * node.run.estimate_path_m(node.settings.window_s)
    return moved_m > DIVERGED_FACTOR * node.window['path_length_m'] + DIVERGED_M or (
        node.values['ate_extent_ratio'] > DIVERGED_FACTOR
        and node.values['ate_trans_rmse_m'] > DIVERGED_M
    )
