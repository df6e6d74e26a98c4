"""
The causes that a diagnosis may name: ``CAUSES``, with one file a family.

A further cause is an entry in the file of its family, and what its ``measure`` notes of it.
"""

from collections.abc import Callable

from vio_eval_ros.diagnosis.causes import (
    breaks,
    clocks,
    conventions,
    divergence,
    frames,
    inputs,
    scale,
    tracking,
    world,
)
from vio_eval_ros.diagnosis.causes.cause import KnownCause
from vio_eval_ros.diagnosis.causes.measuring import Measuring

CAUSES: dict[str, KnownCause] = {
    cause.name: cause
    for family in (
        inputs.CAUSES,
        conventions.CAUSES,
        clocks.CAUSES,
        scale.CAUSES,
        frames.CAUSES,
        world.CAUSES,
        breaks.CAUSES,
        tracking.CAUSES,
        divergence.CAUSES,
    )
    for cause in family
}
#: in the order in which they measure: each with what was found before undone
FAMILIES: tuple[Callable[[Measuring], None], ...] = (
    conventions.measure,
    clocks.measure,
    breaks.measure,
    tracking.measure,
    frames.measure,
    world.measure,
    scale.measure,
)
