"""A run as the Rerun viewer shows it: both paths, moving poses, errors over time."""

from __future__ import annotations

from typing import Any

import numpy as np

from vio_eval_ros.core.trajectory import Trajectory
from vio_eval_ros.errors import ConfigError
from vio_eval_ros.evaluation.result import Result
from vio_eval_ros.reports.drawn_run import DrawnRun
from vio_eval_ros.reports.plots import ramp_colours
from vio_eval_ros.reports.tables import aligned

TIMELINE = 'stamp'
TRUTH_COLOUR = (138, 145, 155)
ERRORS = ('position_m', 'rotation_deg')
AXES_M = 0.3
AXES = [(255, 0, 0), (0, 255, 0), (0, 0, 255)]


def rerun_report(result: Result) -> bytes:
    """
    Return a recording (.rrd) for Rerun, whose stamps are those of the ground truth.

    Positions are metres from an origin that is subtracted where coordinates are too large for
    single precision, as the name of the space says.

    :raises ConfigError: where rerun-sdk is not installed, or the alignment is not determined.
    """
    try:
        import rerun as rr
        import rerun.blueprint as rrb
    except ImportError:
        raise ConfigError(
            "a rerun report needs rerun-sdk: pip install 'vio_eval_ros[rerun]'"
        ) from None
    estimate, truth = aligned(result), result.summary.pairs.ground_truth
    run = DrawnRun.of(result)
    stream = rr.RecordingStream('vio_eval_ros')
    written = rr.binary_stream(stream)
    over_time = (rrb.TimeSeriesView(origin=f'/errors/{name}', name=name) for name in ERRORS)
    paths = rrb.Spatial3DView(origin='/world', name=', '.join(run.labels))
    stream.send_blueprint(rrb.Blueprint(rrb.Horizontal(paths, rrb.Vertical(*over_time))))
    stream.log('world', rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    for name, poses, colours in (
        ('ground_truth', truth, TRUTH_COLOUR),
        ('estimate', estimate, ramp_colours(run.errors / run.hottest)),
    ):
        positions = poses.positions - run.origin
        points = rr.Points3D(positions, colors=colours, radii=rr.Radius.ui_points(1.5))
        stream.log(f'world/{name}/path', points, static=True)
        _log_poses(rr, stream, f'world/{name}/body', poses, positions)
    for name, errors in zip(ERRORS, (run.errors, run.angles), strict=True):
        known = np.isfinite(errors)
        if known.any():
            index = rr.TimeColumn(TIMELINE, timestamp=_times(truth)[known])
            columns = rr.Scalars.columns(scalars=errors[known])
            stream.send_columns(f'errors/{name}', [index], columns)
    content = written.read()
    assert content is not None
    return bytes(content)


def _log_poses(
    rr: Any, stream: Any, entity: str, poses: Trajectory, positions: np.ndarray
) -> None:
    """Log a body that moves along a path; with its axes where orientations are known."""
    moving = {'translation': positions}
    if poses.rotations is not None:
        moving['quaternion'] = poses.rotations
        stream.log(entity, rr.Arrows3D(vectors=AXES_M * np.eye(3), colors=AXES), static=True)
    index = rr.TimeColumn(TIMELINE, timestamp=_times(poses))
    stream.send_columns(entity, [index], rr.Transform3D.columns(**moving))


def _times(poses: Trajectory) -> np.ndarray:
    return poses.stamps_ns.astype('datetime64[ns]')
