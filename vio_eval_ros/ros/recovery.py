"""How the node goes on after it was killed: what arrives is saved, and taken up again."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
import time
from typing import Any

from vio_eval_ros.core.trajectory import Poses
from vio_eval_ros.errors import ConfigError, WriteError
from vio_eval_ros.live.checkpoint import Checkpoint, FOLDER, Resumed, Unusable
from vio_eval_ros.live.health import counted
from vio_eval_ros.live.options import NodeConfig
from vio_eval_ros.ros.frame_input import Input


class Recovery:
    """
    Saves the streams of the node every so often.

    :param identity: what must be the same for a run to go on, see :class:`Checkpoint`.
    :param streams: by the names that they have in the checkpoint.
    :param complain: logs what the user should know.
    :raises VioEvalError: there is no folder for it, or it cannot be written.
    """

    def __init__(
        self,
        settings: NodeConfig,
        identity: Mapping[str, Any],
        streams: Mapping[str, Input],
        complain: Callable[[str], object],
    ) -> None:
        if not settings.report_dir:
            raise ConfigError('checkpoint_s: set report_dir as well, where the run is saved')
        #: what the user should know of a run that was resumed
        self.resumed = ''
        #: why the run cannot be saved
        self.problem = ''
        self._checkpoint = Checkpoint(Path(settings.report_dir) / FOLDER, identity)
        self._streams = streams
        self._every_s = settings.checkpoint_s
        self._saved_s = time.monotonic()
        self._complain = complain

    def resume(self) -> Resumed | None:
        """Give the streams what they had before the node was killed; None where it was not."""
        try:
            found = self._checkpoint.resume()
        except Unusable as error:
            self._complain(f'{error}; the run begins anew')
            return None
        if found is None:
            return None
        told = []
        for name, (msgtype, poses) in found.streams.items():
            stream = self._streams[name]
            stream.resume(msgtype, poses)
            last_s = poses.stamps_ns.max() / 1e9
            told.append(f'{counted(len(poses), "pose")} of {stream.topic} up to {last_s:.3f} s')
        self.resumed = (
            f'the evaluator ended without a report and went on from {self._checkpoint.folder}: '
            f'{", ".join(told)}; what came later, until it was back, is missing'
        )
        self._complain(self.resumed)
        return found

    def note(self, poses: Mapping[str, Poses]) -> None:
        """Remember what has come, for the next time it is saved."""
        for name, arrived in poses.items():
            self._checkpoint.add(name, arrived)

    def save(self, run: int, gates_failed: bool) -> None:
        """Save what has come, where it is time to."""
        if time.monotonic() - self._saved_s < self._every_s:
            return
        self._saved_s = time.monotonic()
        types = {name: stream.state.msgtype for name, stream in self._streams.items()}
        try:
            self._checkpoint.save(run, gates_failed, types)
            self.problem = ''
        except WriteError as error:
            if str(error) != self.problem:
                self._complain(str(error))
            self.problem = str(error)

    def next_run(self) -> None:
        """Forget the run: it has ended."""
        self.resumed = ''
        self._checkpoint.clear()

    def end(self) -> None:
        """Leave nothing behind: the report is written."""
        self._checkpoint.remove()
