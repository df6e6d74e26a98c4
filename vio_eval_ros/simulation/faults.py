"""
Faults of estimates and ground truths, to be put into a run by name and size.

Their names are those under which ``diagnose`` finds them. A further fault is a function and a
line in :data:`FAULTS`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
import math
from typing import Any, NamedTuple

import numpy as np

from vio_eval_ros.core import rotation
from vio_eval_ros.core.config import nearest_name
from vio_eval_ros.core.steps import path_of_changed_steps
from vio_eval_ros.core.trajectory import Trajectory
from vio_eval_ros.errors import ConfigError
from vio_eval_ros.simulation.simulated_run import SimulatedRun

# takes poses, random numbers for what the sizes leave open, and the sizes
Change = Callable[..., Trajectory]


class Fault(NamedTuple):
    """
    One fault.

    :param does: its effect, in words.
    :param units: of its sizes.
    :param change: applies it to the poses of each side; None exchanges the two sides.
    """

    does: str
    units: tuple[str, ...]
    change: Change | None
    sides: tuple[str, ...] = ('estimate',)


def late(poses: Trajectory, source: np.random.Generator, seconds: float) -> Trajectory:
    """Return poses whose stamps are late."""
    return replace(poses, stamps_ns=poses.stamps_ns + round(seconds * 1e9))


def drifting_clock(poses: Trajectory, source: np.random.Generator, ppm: float) -> Trajectory:
    """Return poses whose stamps drift; in the middle of the run they are right."""
    later_ns = np.rint(ppm * 1e-6 * (poses.stamps_ns - _middle_ns(poses))).astype(np.int64)
    return replace(poses, stamps_ns=poses.stamps_ns + later_ns)


def scaled(poses: Trajectory, source: np.random.Generator, factor: float) -> Trajectory:
    """Return a run that is larger."""
    return replace(poses, positions=factor * poses.positions)


def growing_scale(poses: Trajectory, source: np.random.Generator, percent: float) -> Trajectory:
    """Return a run whose scale grows by some percent per minute; in the middle it is right."""
    minutes = (poses.stamps_ns - _middle_ns(poses)) / 60e9
    return replace(
        poses,
        positions=path_of_changed_steps(poses.positions, factors=1 + percent / 100 * minutes),
    )


def drifting_heading(poses: Trajectory, source: np.random.Generator, degrees: float) -> Trajectory:
    """Return a run whose heading drifts by some degrees per minute."""
    minutes = (poses.stamps_ns - poses.stamps_ns[0]) / 60e9
    headings = rotation.about_z(math.radians(degrees) * minutes)
    rotations = rotation.multiply(headings, _rotations(poses))
    return replace(
        poses,
        positions=path_of_changed_steps(poses.positions, rotations=headings),
        rotations=rotations,
    )


def rotated(poses: Trajectory, source: np.random.Generator, degrees: float) -> Trajectory:
    """Return the poses of a sensor that is rotated in the body, about a random axis."""
    mounting = rotation.from_rotation_vector(_vector(source, math.radians(degrees)))
    return replace(poses, rotations=rotation.multiply(_rotations(poses), mounting))


def displaced(poses: Trajectory, source: np.random.Generator, metres: float) -> Trajectory:
    """Return the poses of a sensor elsewhere on the body, in a random direction."""
    lever = rotation.rotate(_rotations(poses), _vector(source, metres))
    return replace(poses, positions=poses.positions + lever)


def tilted(poses: Trajectory, source: np.random.Generator, degrees: float) -> Trajectory:
    """Return the poses in a world that is tilted about a random horizontal axis."""
    heading = source.uniform(0, 2 * math.pi)
    axis = np.array([math.cos(heading), math.sin(heading), 0.0])
    tilt = rotation.from_rotation_vector(axis * math.radians(degrees))
    rotations = None if poses.rotations is None else rotation.multiply(tilt, poses.rotations)
    return replace(poses, positions=rotation.rotate(tilt, poses.positions), rotations=rotations)


def jumped(poses: Trajectory, source: np.random.Generator, metres: float) -> Trajectory:
    """Return poses that are all displaced from a random one on."""
    first = int(source.uniform(0.15, 0.85) * len(poses))
    positions = poses.positions.copy()
    positions[first:] += _vector(source, metres)
    return replace(poses, positions=positions)


def scattered(
    poses: Trajectory, source: np.random.Generator, share: float, metres: float
) -> Trajectory:
    """Return poses a share of which is displaced, each in its own direction."""
    count = max(1, round(share * len(poses)))
    positions = poses.positions.copy()
    for k in source.choice(len(poses), count, replace=False):
        positions[k] += _vector(source, metres)
    return replace(poses, positions=positions)


def interrupted(poses: Trajectory, source: np.random.Generator, share: float) -> Trajectory:
    """Return the poses without those of a random interval, which may be the end."""
    duration_ns = poses.stamps_ns[-1] - poses.stamps_ns[0]
    latest = 1.0 - share
    begin = poses.stamps_ns[0] + source.uniform(min(0.1, latest), latest) * duration_ns
    return poses[(poses.stamps_ns < begin) | (poses.stamps_ns > begin + share * duration_ns)]


def diverged(
    poses: Trajectory, source: np.random.Generator, share: float, metres: float
) -> Trajectory:
    """Return a run that diverges in its last share, ever faster, and ends metres away."""
    count = max(1, round(share * len(poses)))
    positions = poses.positions.copy()
    positions[-count:] += np.linspace(0, 1, count)[:, None] ** 2 * _vector(source, metres)
    return replace(poses, positions=positions)


def conjugated(poses: Trajectory, source: np.random.Generator) -> Trajectory:
    """Return the poses with inverse rotations."""
    return replace(poses, rotations=rotation.conjugate(_rotations(poses)))


def reordered(poses: Trajectory, source: np.random.Generator, places: float) -> Trajectory:
    """Return the poses with rolled quaternion components; 1 puts w first."""
    return replace(poses, rotations=np.roll(_rotations(poses), round(places), axis=1))


def inverted(poses: Trajectory, source: np.random.Generator) -> Trajectory:
    """Return the inverse poses: the world in the camera."""
    back = rotation.conjugate(_rotations(poses))
    return replace(poses, positions=-rotation.rotate(back, poses.positions), rotations=back)


def swapped(poses: Trajectory, source: np.random.Generator) -> Trajectory:
    """Return the poses with two axes of their positions swapped."""
    return replace(poses, positions=poses.positions[:, [1, 0, 2]])


def frozen(poses: Trajectory, source: np.random.Generator) -> Trajectory:
    """Return poses that are all equal to the first."""
    return replace(poses[np.zeros(len(poses), int)], stamps_ns=poses.stamps_ns)


BOTH = ('estimate', 'ground_truth')
FAULTS: dict[str, Fault] = {
    'time_offset': Fault('stamps are late', ('s',), late),
    'clock_drift': Fault('stamps drift', ('ppm',), drifting_clock),
    'scale': Fault('the run is larger', ('factor',), scaled),
    'scale_drift': Fault('the scale grows, per minute', ('percent',), growing_scale),
    'sensor_rotation': Fault('the tracked frame is rotated', ('deg',), rotated),
    'lever_arm': Fault('another point of the body is tracked', ('m',), displaced),
    'gravity_tilt': Fault('the world is tilted', ('deg',), tilted),
    'yaw_drift': Fault('the heading drifts, per minute', ('deg',), drifting_heading),
    'jump': Fault('all poses after a moment are displaced', ('m',), jumped),
    'outliers': Fault('a share of the poses is displaced', ('share', 'm'), scattered),
    'lost_tracking': Fault('a share of the time has no poses', ('share',), interrupted),
    'diverged': Fault('the last share of the run diverges', ('share', 'm'), diverged),
    'quaternion_conjugated': Fault('rotations are inverse', (), conjugated),
    'quaternion_order': Fault('quaternions begin with w (1) or y (-1)', ('places',), reordered),
    'pose_inverted': Fault('poses are inverse, camera from world', (), inverted),
    'axes_swapped': Fault('x and y of the positions are swapped', (), swapped),
    'swapped_inputs': Fault('estimate and ground truth are exchanged', (), None, BOTH),
    'truth_static': Fault('the ground truth does not move', (), frozen, ('ground_truth',)),
    'insufficient_motion': Fault('neither moves', (), frozen, BOTH),
}
# exclusive bounds of the sizes, by unit
BOUNDS = {
    'factor': (0.0, 1e6),
    'share': (0.0, 1.0),
    'ppm': (-1e6, 1e6),  # a clock does not run backwards
    's': (-4e9, 4e9),
    'places': (0.0, 4.0),
}
MAX_SIZE = 1e6  # of all other units; beyond, poses are unusable


def usage(name: str) -> str:
    """Return how a fault is written, such as ``outliers=SHARE,M``."""
    units = ','.join(FAULTS[name].units).upper()
    return f'{name}={units}' if units else name


def parse_fault(text: str) -> tuple[str, tuple[float, ...]]:
    """
    Return the name and the sizes in a text such as ``outliers=0.01,2``.

    :raises ConfigError: an unknown name; sizes that are missing, too many or out of bounds.
    """
    name, _, given = text.partition('=')
    if name not in FAULTS:
        near = nearest_name(name, FAULTS) or f'; there are {", ".join(FAULTS)}'
        raise ConfigError(f"there is no fault '{name}'{near}")
    units = FAULTS[name].units
    try:
        sizes = tuple(map(float, given.split(','))) if given else ()
    except ValueError:
        raise ConfigError(f"{text}: '{given}' is not a number; write {usage(name)}") from None
    if len(sizes) != len(units):
        raise ConfigError(f'{text}: write {usage(name)} ({FAULTS[name].does})')
    for size, unit in zip(sizes, units, strict=True):
        low, high = BOUNDS.get(unit, (-MAX_SIZE, MAX_SIZE))
        if not low < size < high or (unit == 'places' and size != round(size)):
            what = 'whole number' if unit == 'places' else 'number'
            raise ConfigError(f'{text}: expected a {what} between {low:g} and {high:g}')
    return name, sizes


def inject(
    run: SimulatedRun, name: str, sizes: tuple[float, ...], source: np.random.Generator
) -> SimulatedRun:
    """
    Return a run with a fault.

    :param name: of ``FAULTS``.
    :param sizes: one for each of its units.
    :param source: of what they leave open, such as directions and moments.
    :raises ConfigError: where the run lacks what the fault would change.
    """
    fault = FAULTS[name]
    for side in fault.sides:
        if not len(getattr(run, side)):
            raise ConfigError(f'{name} needs a run with {side.replace("_", " ")}')
    if fault.change is None:
        return replace(run, estimate=run.ground_truth, ground_truth=run.estimate)
    try:
        for side in fault.sides:
            changed: Any = {side: fault.change(getattr(run, side), source, *sizes)}
            run = replace(run, **changed)
    except ConfigError as error:
        raise ConfigError(f'{name}: {error}') from None
    return run


def _rotations(poses: Trajectory) -> np.ndarray:
    if poses.rotations is None:
        raise ConfigError('it needs orientations, which the poses do not have')
    return poses.rotations


def _vector(source: np.random.Generator, length: float) -> np.ndarray:
    """Return a vector in a random direction."""
    direction = source.normal(size=3)
    return np.asarray(length * direction / np.linalg.norm(direction))


def _middle_ns(poses: Trajectory) -> int:
    return int(poses.stamps_ns[0] + poses.stamps_ns[-1]) // 2
