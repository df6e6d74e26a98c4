"""What is known of a live evaluation at a moment: values from which its health follows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
import math

from vio_eval_ros.core.alignment import Alignment
from vio_eval_ros.core.gates import Gate
from vio_eval_ros.diagnosis.report import Diagnosis
from vio_eval_ros.live.queues import TimeJump


@dataclass(frozen=True)
class TopicState:
    """
    What is known of an input topic.

    :param name: ``estimate`` or ``ground_truth``.
    :param msgtype: the type that is read; empty until it is known.
    :param type_is_given: whether a parameter sets it.
    :param published_types: of all publishers, sorted.
    :param publishers: the full names of the nodes that publish it, one for each publisher.
    :param sent_before: how many messages were sent before the subscription reached the publisher.
    :param silent_s: how long nothing has arrived.
    :param oldest_ns: the oldest stamp of the newest run; :data:`AFTER_ALL` where there is none.
    :param newest_ns: the newest stamp of that run; :data:`BEFORE_ALL` where there is none.
    :param unstamped: whether poses have arrived in that run, all of them stamped 0.
    :param jump: a jump back in time after which the run has not ended yet.
    :param problem: why the messages of a tree make no poses.
    """

    name: str
    topic: str
    oldest_ns: int
    newest_ns: int
    msgtype: str = ''
    type_is_given: bool = False
    published_types: tuple[str, ...] = ()
    publishers: tuple[str, ...] = ()
    received: int = 0
    sent_before: int = 0
    lost: int = 0
    full: int = 0
    undecodable: int = 0
    incompatible: int = 0
    incompatibility: str = ''
    silent_s: float = 0.0
    unstamped: bool = False
    jump: TimeJump | None = None
    problem: str = ''


@dataclass(frozen=True)
class SideState:
    """
    What the association made of one side.

    :param used: how many poses were usable.
    :param dropped: how many were not, by reason.
    :param overflow: how many of these were given up while waiting for the other side.
    """

    used: int = 0
    dropped: Mapping[str, int] = field(default_factory=dict)
    overflow: int = 0

    @property
    def has_arrived(self) -> bool:
        """Whether there was any pose, usable or not."""
        return bool(self.used or sum(self.dropped.values()) - self.overflow)


@dataclass(frozen=True, eq=False)
class RunState:
    """
    What is known of a run so far.

    :param began_as: why the run before ended; empty for the first.
    :param values: the running values; empty until a second is over.
    :param timing: latency and rate of the last seconds, and what the processes cost.
    :param alignment: of all pairs; None where there are none.
    :param estimate_moved_m: in the window, in metres of the ground truth.
    :param ground_truth_moved_m: likewise.
    :param waiting_for: which side is missing, with what has arrived.
    :param no_pairs: why what has arrived makes no pair.
    :param largest_jump: stamp [ns] and size [m] of the largest step of the estimate that the
        ground truth does not have.
    :param turns: which sides are, in the window, several trajectories that take turns.
    :param diagnosis: the last one; None where there is none yet.
    :param diagnosed_pairs: how many pairs it is of.
    :param diagnosis_problem: the bug that prevented the last one.
    """

    number: int = 1
    began_as: str = ''
    values: Mapping[str, float] = field(default_factory=dict)
    timing: Mapping[str, float] = field(default_factory=dict)
    estimate: SideState = SideState()
    ground_truth: SideState = SideState()
    alignment: Alignment | None = None
    estimate_moved_m: float = 0.0
    ground_truth_moved_m: float = 0.0
    waiting_for: str = ''
    no_pairs: str = ''
    largest_jump: tuple[int, float] | None = None
    turns: tuple[str, ...] = ()
    diagnosis: Diagnosis | None = None
    diagnosed_pairs: int = 0
    diagnosis_problem: str = ''


@dataclass(frozen=True, eq=False)
class Snapshot:
    """
    All that the health of an evaluation is judged by, at a moment.

    :param topics: the inputs; the estimate comes first.
    :param file_span_ns: first and last stamp of a ground truth that is a file.
    :param time_offset_s: added to the stamps of the estimate.
    :param stale_after_s: how long a stream may be silent.
    :param problems: what else went wrong, such as a report that cannot be written.
    :param clock_jumped: whether ``/clock`` went back, and the run has not ended yet.
    :param offered: other topics with poses, where nobody publishes one of the inputs.
    :param other_node: the name of the node, where another one has it as well.
    """

    run: RunState
    topics: tuple[TopicState, ...]
    file_span_ns: tuple[int, int] | None = None
    gates: Sequence[Gate] = ()
    time_offset_s: float = 0.0
    stale_after_s: float = math.inf
    problems: tuple[str, ...] = ()
    clock_jumped: bool = False
    offered: Sequence[str] = ()
    other_node: str = ''
