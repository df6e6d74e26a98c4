"""What is advised of a source does not only repeat how it was read."""

from pathlib import Path

import numpy as np
import pytest

from vio_eval_ros.core.config import EvaluationConfig
from vio_eval_ros.diagnosis.recorded import diagnose_sources
from vio_eval_ros.recordings.sources import read_sources
from vio_eval_ros.simulation import simulate

RUN = simulate(duration_s=30.0)


def write(path: Path, header: str, order: str) -> str:
    """Write the estimate, with its quaternions in an order, whatever the header says."""
    poses = RUN.estimate
    assert poses.rotations is not None
    turns = poses.rotations[:, ['xyzw'.index(letter) for letter in order]]
    rows = np.column_stack([poses.stamps_ns / 1e9, poses.positions, turns])
    np.savetxt(path, rows, '%.9f', delimiter=',', header=header, comments='')
    return str(path)


@pytest.mark.slow
@pytest.mark.parametrize(
    ('header', 'order', 'flags'),
    [
        ('t,x,y,z,qw,qx,qy,qz', 'xyzw', ('?quaternion=xyzw',)),
        ('t,x,y,z,qx,qy,qz,qw', 'wxyz', ('?quaternion=wxyz',)),
    ],
)
def test_the_order_that_is_advised_is_not_that_of_the_header(tmp_path, header, order, flags):
    truth = tmp_path / 'gt.txt'
    assert RUN.ground_truth.rotations is not None
    np.savetxt(
        truth,
        np.column_stack(
            [RUN.ground_truth.stamps_ns / 1e9, RUN.ground_truth.positions,
             RUN.ground_truth.rotations]
        ),
        '%.9f',
    )  # fmt: skip
    sides = read_sources([write(tmp_path / 'est.csv', header, order), str(truth)])
    assert sides[0].order == header.replace('t,x,y,z,', '').replace('q', '').replace(',', '')
    cause = diagnose_sources(*sides, EvaluationConfig()).causes[0]
    assert (cause.name, cause.flags) == ('quaternion_order', flags)
