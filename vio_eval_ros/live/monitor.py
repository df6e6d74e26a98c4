"""
What is wrong with a run that goes on, from its pairs so far.

A diagnosis takes a second at most, in a thread of its own, and all together take no more than a
small share of the time.
"""

from __future__ import annotations

from threading import Thread
import time

import numpy as np

from vio_eval_ros.core.config import EvaluationConfig
from vio_eval_ros.core.trajectory import Pairs
from vio_eval_ros.diagnosis.diagnosed_run import DiagnosedRun
from vio_eval_ros.diagnosis.diagnosis import diagnose_run
from vio_eval_ros.diagnosis.limits import DEFAULT, DiagnosisLimits
from vio_eval_ros.diagnosis.report import Diagnosis
from vio_eval_ros.errors import NoPairs

INTERVAL_S = 10.0
#: share of a processor's time that diagnoses may take
CPU_RATIO = 0.02
#: a shorter run may be all initialisation
SHORTEST_S = 20.0
MOST_PAIRS = 10_000
#: pairs closer together than this add more work than information
DENSE_S = 0.1


class DiagnosisMonitor:
    """
    The diagnosis of one run, updated now and then.

    :param config: the options of the evaluation that the pairs come from.
    :param limits: what healthy runs show.
    """

    def __init__(self, config: EvaluationConfig, limits: DiagnosisLimits = DEFAULT) -> None:
        #: None until there is enough to diagnose
        self.latest: Diagnosis | None = None
        #: how many pairs it is of
        self.pairs = 0
        #: the error that ended the last one, a bug to report
        self.problem = ''
        self._config = config
        self._limits = limits
        self._thread: Thread | None = None
        self._due_s = 0.0

    def look(self, pairs: Pairs) -> None:
        """Begin the next diagnosis, where it is due and the pairs suffice."""
        busy = self._thread is not None and self._thread.is_alive()
        if not busy and time.monotonic() >= self._due_s and long_enough(pairs):
            self._thread = Thread(target=self._diagnose, args=(sample(pairs),))
            self._thread.start()

    def conclude(self, pairs: Pairs) -> Diagnosis | None:
        """Return the diagnosis of all pairs of a run that has ended."""
        if self._thread is not None:
            self._thread.join()
        self.latest = None
        if long_enough(pairs):
            self._diagnose(sample(pairs))
        return self.latest

    def _diagnose(self, pairs: Pairs) -> None:
        began_s, busy_s = time.monotonic(), time.thread_time()
        try:
            run = DiagnosedRun(pairs.estimate, pairs.ground_truth, self._config)
            self.latest, self.pairs, self.problem = diagnose_run(run, self._limits), len(pairs), ''
        except NoPairs:
            self.latest, self.pairs, self.problem = None, 0, ''
        except Exception as error:  # the evaluation must go on
            self.problem = f'{type(error).__name__}: {error}'
        busy_s = time.thread_time() - busy_s
        self._due_s = began_s + max(INTERVAL_S, busy_s / CPU_RATIO)


def long_enough(pairs: Pairs) -> bool:
    """Return whether pairs span more time than initialisation takes."""
    stamps_ns = pairs.estimate.stamps_ns
    return len(pairs) > 1 and float(stamps_ns[-1] - stamps_ns[0]) >= SHORTEST_S * 1e9


def sample(pairs: Pairs) -> Pairs:
    """Return all pairs where they are few, else the newest, evenly spaced and not too sparse."""
    if len(pairs) <= MOST_PAIRS:
        return pairs
    interval_s = float(np.ptp(pairs.estimate.stamps_ns)) / 1e9 / len(pairs)
    stride = max(min(-(-len(pairs) // MOST_PAIRS), int(DENSE_S / interval_s)), 1)
    return pairs[(len(pairs) - 1) % stride :: stride][-MOST_PAIRS:]
