"""Poses of several publishers that take turns on one topic, or in one transform."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from vio_eval_ros.core.interleaving import copies, interleaving
from vio_eval_ros.core.sensor_stream import SensorStream
from vio_eval_ros.core.trajectory import Poses
from vio_eval_ros.inspection.finding import Finding
from vio_eval_ros.inspection.findings import FINDINGS


def publishers(stream: SensorStream) -> Iterator[Finding]:
    """Yield where the poses of a stream, as it was recorded, are several trajectories."""
    named = {f'{name}: ': poses for name, poses in stream.transforms.items()}
    if stream.kind == 'pose' and stream.stamps_ns is not None:
        numbers = stream.numbers
        assert numbers is not None
        rotations = numbers[:, 3:] if numbers.shape[1] == 7 else None
        poses = Poses(stream.stamps_ns, numbers[:, :3], rotations, zero_is_unset=True)
        named = {'': poses}
    for name, poses in named.items():
        found = interleaving(poses)
        if found is not None:
            first, last = (
                int(np.abs(stream.times_ns - stamp_ns).argmin())
                for stamp_ns in (found.first_ns, found.last_ns)
            )
            # transforms are no input of an estimator, but what it is scored by
            yield FINDINGS['two_publishers'].found(
                stream.topic,
                'mixed',
                name=name,
                found=found,
                count=found.switches,
                value=found.apart,
                unit=found.unit,
                moments=(stream.moment(first, last),),
            )
        elif again := int(np.count_nonzero(copies(poses))):
            total = len(poses)
            yield FINDINGS['two_publishers'].found(
                stream.topic, 'twice', minor=True, name=name, count=again, total=total
            )
