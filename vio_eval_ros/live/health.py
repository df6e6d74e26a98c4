"""
How healthy a live evaluation is: what is known of it in, statuses out.

Plain functions from a :class:`Snapshot` to lines of ``/diagnostics``. The table in docs/live.md
lists what the messages mean.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum
import math

from vio_eval_ros.core.config import nearest_name
from vio_eval_ros.core.gates import Gate, judge, SEVERITIES
from vio_eval_ros.diagnosis.causes import CAUSES
from vio_eval_ros.diagnosis.report import Cause, Diagnosis
from vio_eval_ros.live.snapshot import RunState, Snapshot, TopicState
from vio_eval_ros.live.timeliness import MEDIAN, P99, REAL_TIME_FACTOR
from vio_eval_ros.recordings.messages import STREAMED
from vio_eval_ros.recordings.transforms import TF_TYPES
from vio_eval_ros.rendering.text import number

#: how much of the run is evaluated at all
ASSOCIATION_RATIOS = ('coverage_ratio', 'tracked_ratio', 'initialisation_s', 'matched_ratio')
#: share of the ground truth that was tracked since the first pair, below which there is a warning
LOW_TRACKED_RATIO = 0.9
#: share of poses that could not be used, above which there is a warning
MANY_DROPPED_RATIO = 0.01
#: error over the extent of the ground truth, and motion over that of the ground truth, above which
#: an estimate has diverged ...
DIVERGED_RATIO = 10.0
#: ... if the error, or the excess of the motion over that, is also larger than this
DIVERGED_M = 10.0
#: how many topics are listed where one is not published
MOST_OFFERED = 5


class Level(IntEnum):
    """How bad it is; numbered as in diagnostic_msgs/msg/DiagnosticStatus."""

    OK = 0
    WARN = 1
    ERROR = 2
    STALE = 3


@dataclass(frozen=True)
class Status:
    """
    The health of one aspect of an evaluation.

    :param name: accuracy, association, streams, timing or diagnosis.
    :param values: numbers and words by the names that scripts rely on.
    """

    name: str
    level: Level
    message: str
    values: Mapping[str, object]


def statuses(snapshot: Snapshot) -> list[Status]:
    """Return the statuses accuracy, association, streams, timing and diagnosis."""
    return [
        accuracy(snapshot.run, snapshot.gates, snapshot.problems),
        association(snapshot),
        streams(snapshot),
        timing(snapshot.run, snapshot.gates),
        diagnosis(snapshot.run),
    ]


def telling(statuses: Sequence[Status]) -> list[Status]:
    """Return those that are not all well, but for what another one says as well."""
    wrong = [status for status in statuses if status.level != Level.OK]
    return [
        status
        for status in wrong
        if not any(status.message in o.message for o in wrong if o is not status)
    ]


def accuracy(run: RunState, gates: Sequence[Gate], problems: Sequence[str] = ()) -> Status:
    """Return how good the estimate is so far: errors, gates, divergence."""
    elsewhere = ASSOCIATION_RATIOS
    values = {name: value for name, value in run.values.items() if name not in elsewhere}
    level, message = _accuracy(run, gates)
    if problems:
        level, message = max(level, Level.WARN), '; '.join([message, *problems])
    return Status('accuracy', level, message, values)


def _accuracy(run: RunState, gates: Sequence[Gate]) -> tuple[Level, str]:
    if not run.values.get('pairs'):
        return Level.WARN, 'no pairs yet'
    if has_diverged(run):
        return Level.ERROR, 'the estimate has diverged'
    level, broken = _broken(gates, run.values)
    if broken:
        return level, broken
    undetermined = run.alignment.undetermined if run.alignment is not None else ''
    if undetermined or math.isnan(run.values['ate_trans_rmse_m']):
        prefix = f'{undetermined}: ' if undetermined else ''
        return Level.WARN, f'{prefix}the alignment is not determined yet'
    return Level.OK, 'running'


def _broken(gates: Sequence[Gate], values: Mapping[str, float]) -> tuple[Level, str]:
    """Return the worst of the gates on these values that is broken; OK where none is."""
    known = [gate for gate in gates if gate.metric in values]
    # those that fail before those that warn
    broken = sorted(
        (verdict for verdict in judge(known, values) if not verdict.passed),
        key=lambda verdict: SEVERITIES.index(verdict.word),
    )
    if not broken:
        return Level.OK, ''
    gate, value, _ = broken[0]
    level = Level.ERROR if gate.severity == 'fail' else Level.WARN
    return level, f'gate {gate} is broken: {number(value)}'


def has_diverged(run: RunState) -> bool:
    """
    Return whether the estimate has left the ground truth for good.

    Either it moved far more in the window than the ground truth did, or its error is far larger
    than the extent of the ground truth.
    """
    allowed_m = DIVERGED_RATIO * run.ground_truth_moved_m + DIVERGED_M
    return run.estimate_moved_m > allowed_m or (
        run.values['ate_extent_ratio'] > DIVERGED_RATIO
        and run.values['ate_trans_rmse_m'] > DIVERGED_M
    )


def association(snapshot: Snapshot) -> Status:
    """Return whether estimate and ground truth are paired, or why not."""
    run = snapshot.run
    tracked = run.values.get('tracked_ratio', math.nan)
    values: dict[str, object] = {
        'pairs': run.values.get('pairs', 0),
        **{name: run.values.get(name, math.nan) for name in ASSOCIATION_RATIOS},
    }
    dropped = []
    for name, side in (('estimate', run.estimate), ('ground_truth', run.ground_truth)):
        values[f'{name}_poses'] = side.used
        values |= {f'{name}_{reason}': count for reason, count in side.dropped.items()}
        count = sum(side.dropped.values())
        if count > MANY_DROPPED_RATIO * (side.used + count):
            reasons = [
                f'{n} {reason.replace("_", "-")}' for reason, n in side.dropped.items() if n
            ]
            dropped.append(f'{name.replace("_", " ")}: dropped {", ".join(reasons)}')
    if not values['pairs']:
        return Status('association', Level.WARN, why_no_pairs(snapshot), values)
    problems = []
    if tracked < LOW_TRACKED_RATIO:
        late = run.values.get('initialisation_s', 0.0) > 0
        since = ' since the first estimate' if late else ''
        problems = [f'only {100 * tracked:.1f} % of the ground truth was tracked{since}']
    problems += [problem for problem in (_ends_early(snapshot),) if problem]
    problems += dropped
    if problems:
        return Status('association', Level.WARN, '; '.join(problems), values)
    return Status('association', Level.OK, 'running', values)


def _ends_early(snapshot: Snapshot) -> str:
    """Return which topic does not keep up with the other, if one does not."""
    if len(snapshot.topics) < 2:
        return ''
    estimate, truth = snapshot.topics
    ahead_s = (truth.newest_ns - estimate.newest_ns) / 1e9 - snapshot.time_offset_s
    if abs(ahead_s) <= snapshot.stale_after_s:
        return ''
    ends = ('estimate', 'ground truth') if ahead_s > 0 else ('ground truth', 'estimate')
    return f'the {ends[0]} ends {abs(ahead_s):.1f} s before the {ends[1]}: no values for the rest'


def why_no_pairs(snapshot: Snapshot) -> str:
    """Return why there is no pair, with what has arrived of both sides."""
    run = snapshot.run
    if run.estimate.has_arrived and run.ground_truth.has_arrived:
        return run.no_pairs
    message = f'no pairs yet: {run.waiting_for}'
    for topic in snapshot.topics:
        if not topic.received and (problems := topic_problems(topic, snapshot.offered)):
            message = f'{message}; {"; ".join(problems)}'
    unstamped = [topic.topic for topic in snapshot.topics if topic.unstamped]
    if unstamped:
        return f'{message}; {" and ".join(unstamped)} stamped 0: is there a /clock?'
    return f'{message}; are the clocks the same?' if _clocks_are_apart(snapshot) else message


def _clocks_are_apart(snapshot: Snapshot) -> bool:
    """Return whether both sides have arrived, and have no time in common."""
    estimate, *others = snapshot.topics
    offset_ns = round(snapshot.time_offset_s * 1e9)
    begin_ns, end_ns = estimate.oldest_ns + offset_ns, estimate.newest_ns + offset_ns
    spans = [(truth.oldest_ns, truth.newest_ns) for truth in others]
    first_ns, last_ns = snapshot.file_span_ns or spans[0]
    arrived = begin_ns < end_ns and first_ns < last_ns
    return arrived and (begin_ns > last_ns or end_ns < first_ns)


def streams(snapshot: Snapshot) -> Status:
    """Return whether messages arrive, and what is wrong with them and their publishers."""
    values: dict[str, object] = {'run': snapshot.run.number}
    problems, stale = [], []
    for topic in snapshot.topics:
        values |= {
            f'{topic.name}_topic': topic.topic,
            f'{topic.name}_type': topic.msgtype,
            f'{topic.name}_publishers': len(topic.publishers),
            f'{topic.name}_received': topic.received,
            f'{topic.name}_sent_before': topic.sent_before,
            f'{topic.name}_lost': topic.lost,
            f'{topic.name}_queue_full': topic.full,
            f'{topic.name}_undecodable': topic.undecodable,
            f'{topic.name}_incompatible_qos': topic.incompatible,
        }
        problems += topic_problems(topic, snapshot.offered)
        if topic.received and topic.silent_s > snapshot.stale_after_s:
            gone = '' if topic.publishers else ', and nobody publishes it'
            stale.append(f'nothing on {topic.topic} for {topic.silent_s:.0f} s{gone}')
    problems += snapshot.run.turns
    problems += [
        f'{topic.topic} {topic.jump}: waiting for the other stream to do so'
        for topic in snapshot.topics
        if topic.jump is not None
    ]
    if snapshot.other_node:
        problems.append(
            f'there is another {snapshot.other_node}: both answer to its services and write the '
            'same report; name one with -r __node:=NAME'
        )
    if snapshot.clock_jumped:
        problems.append('the clock jumped back: waiting for the streams to do so')
    if problems:
        return Status('streams', Level.WARN, '; '.join(problems + stale), values)
    if stale and len(stale) == len(snapshot.topics) and _reached_the_end(snapshot):
        return Status('streams', Level.OK, f'ended: {"; ".join(stale)}', values)
    if stale:
        return Status('streams', Level.STALE, '; '.join(stale), values)
    missed = [sent_before(t.sent_before, t.topic) for t in snapshot.topics if t.sent_before]
    return Status('streams', Level.OK, '; '.join(['running', *missed]), values)


def _reached_the_end(snapshot: Snapshot) -> bool:
    """Return whether the estimate has come as far as a ground truth that is a file."""
    if snapshot.file_span_ns is None:
        return True
    short_ns = snapshot.file_span_ns[1] - snapshot.topics[0].newest_ns
    return short_ns / 1e9 <= snapshot.stale_after_s + snapshot.time_offset_s


def topic_problems(topic: TopicState, offered: Sequence[str] = ()) -> list[str]:
    """
    Return what is wrong with a topic and its publishers.

    :param offered: other topics with poses, of which one may be meant.
    """
    problems = [_publisher_problem(topic)]
    if topic.incompatibility:
        problems.append(f'incompatible QoS on {topic.topic}: {topic.incompatibility}')
    if topic.undecodable:
        problems.append(undecodable(topic.undecodable, topic.topic, topic.msgtype))
    if topic.lost:
        problems.append(f'{counted(topic.lost, "message")} lost on {topic.topic}')
    if topic.full:
        problems.append(f'{topic.topic}: the queue was full {counted(topic.full, "time")}')
    problems = [problem for problem in problems if problem]
    if topic.problem:
        problems.append(topic.problem)
    if problems or topic.received:
        return problems
    if topic.publishers:
        return [f'nothing received on {topic.topic}']
    if topic.msgtype in TF_TYPES:
        return [f'nobody publishes {topic.topic.partition(":")[0]}']
    return [f'nobody publishes {topic.topic}{suggestion(topic.topic, offered)}']


def suggestion(topic: str, offered: Sequence[str]) -> str:
    """Return which of the topics with poses may be meant, or which there are; or ''."""
    if near := nearest_name(topic, offered):
        return near
    more = ' ...' if len(offered) > MOST_OFFERED else ''
    listed = ', '.join(offered[:MOST_OFFERED])
    return f'; topics with poses are {listed}{more}' if offered else ''


def sent_before(count: int, topic: str) -> str:
    """Return that a publisher had begun before its subscriber was there."""
    were = 'was' if count == 1 else 'were'
    return f'{counted(count, "message")} of {topic} {were} sent before the evaluator subscribed'


def undecodable(count: int, topic: str, msgtype: str) -> str:
    """Return that messages were not of their type."""
    return f'{counted(count, "message")} on {topic} could not be decoded as {msgtype}'


def counted(count: int, noun: str) -> str:
    """Return a number of things, such as '1 message' and '3 messages'."""
    return f'{count} {noun}' if count == 1 else f'{count} {noun}s'


def _publisher_problem(topic: TopicState) -> str:
    """Return what is wrong with the number or the types of the publishers."""
    listed = ' and '.join(topic.published_types)
    scorable = [msgtype for msgtype in topic.published_types if msgtype in STREAMED]
    if listed and not scorable:
        return f'{topic.topic} carries {listed}, which has no pose that can be scored'
    if len(scorable) > 1 and not topic.msgtype:
        return f'{topic.topic} is published as {listed}; set {topic.name}_type to one of them'
    if scorable and topic.msgtype not in scorable:
        remedy = f'set {topic.name}_type' if topic.type_is_given else 'restart the evaluator'
        return f'{topic.topic} is published as {listed}, not {topic.msgtype}; {remedy}'
    if len(topic.published_types) > 1:
        return f'{topic.topic} is published as {listed}; only {topic.msgtype} is read'
    # everybody publishes transforms
    return '' if topic.msgtype in TF_TYPES else mixed(topic.topic, topic.publishers)


def mixed(topic: str, publishers: Sequence[str]) -> str:
    """Return that several nodes publish a topic; '' where one does."""
    if len(publishers) < 2:
        return ''
    return (
        f'{len(publishers)} publishers on {topic}: their poses are mixed ({", ".join(publishers)})'
    )


def timing(run: RunState, gates: Sequence[Gate]) -> Status:
    """Return how late the estimate has been in the last seconds, and what it cost."""
    values = run.timing
    known = {name: value for name, value in values.items() if not math.isnan(value)}
    level, broken = _broken(gates, known)
    latency_s, rate = values.get(MEDIAN, math.nan), values.get(REAL_TIME_FACTOR, math.nan)
    if math.isnan(latency_s):
        message = 'latency unknown: no stamps by the clock of this node'
    else:
        message = (
            f'latency {number(1e3 * latency_s)} ms (median), {number(1e3 * values[P99])} ms (99 %)'
        )
    if not math.isnan(rate):
        message = f'{message}; {number(rate)} times real time'
    return Status('timing', level, broken or message, values)


def diagnosis(run: RunState) -> Status:
    """Return what is wrong: the largest jump at once, all causes as of the last diagnosis."""
    found, jump = run.diagnosis, run.largest_jump
    causes = found.causes if found is not None else ()
    values: dict[str, object] = {}
    messages = []
    if jump is not None:
        messages = [f'the estimate jumped by {number(jump[1])} m at {jump[0] / 1e9:.3f} s']
        values = {'jump_stamp_ns': jump[0], 'jump_m': jump[1]}
        causes = tuple(cause for cause in causes if cause.name != 'jump')
    if run.diagnosis_problem:
        messages.append(diagnosis_failed(run.diagnosis_problem))
    unmoved = any(cause.name == 'insufficient_motion' for cause in causes)
    if not unmoved:
        messages += _messages_of(causes)
        for k, cause in enumerate(causes, 1):
            values |= {f'cause_{k}': cause.name, **_values_of(cause)}
    if found is not None:
        values['diagnosed_pairs'] = run.diagnosed_pairs
        values['cannot_tell'] = ', '.join(found.cannot_tell)
    if messages:
        return Status('diagnosis', Level.WARN, '; '.join(messages), values)
    if run.began_as:
        message = f'run {run.number} began as {run.began_as}'
    elif found is None or unmoved:
        message = 'cannot tell yet: too little time or motion so far'
    else:
        message = 'nothing unusual'
    return Status('diagnosis', Level.OK, message, values)


def _messages_of(causes: Sequence[Cause]) -> list[str]:
    """Return the evidence of the first cause, and the names of the others."""
    if not causes:
        return []
    first, *others = causes
    also = [f'also {", ".join(cause.name for cause in others)}'] if others else []
    return [f'{first.name}: {first.evidence}', *also]


def _values_of(cause: Cause) -> dict[str, object]:
    """Return what there is to say of a cause, under names that begin with its own."""
    unit = f'_{CAUSES[cause.name].unit_in_names}'
    values = {
        unit: cause.value,
        f'_uncertainty{unit}': cause.uncertainty,
        '_confidence': cause.confidence,
        '_advice': cause.advice,
        '_flags': ' '.join(cause.flags),
    }
    return {
        f'{cause.name}{key}': value
        for key, value in values.items()
        if not (isinstance(value, float) and math.isnan(value))
    }


def diagnosis_failed(problem: str) -> str:
    """Return that there is no diagnosis, though the run is not at fault."""
    return f'the diagnosis failed: this is a bug, please report it: {problem}'


def conclusions(found: Diagnosis | None, problem: str) -> list[str]:
    """Return a line for each cause that was found in a run that has ended."""
    if problem:
        return [diagnosis_failed(problem)]
    causes = found.causes if found is not None else ()
    return [f'{cause.name}: {cause.evidence}. {cause.advice}' for cause in causes]
