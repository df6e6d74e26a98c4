"""Whether the calibration of a rig is one: rotations, directions, lever arms, baselines, order."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
import math
from typing import Any

import numpy as np

from vio_eval_ros.core.rotation import angle_of_matrix
from vio_eval_ros.inspection.chains import Chain, FROM_CAMERA, inverse, NOISE, RATES, TO_CAMERA
from vio_eval_ros.inspection.findings import Finding
from vio_eval_ros.inspection.inertial import upwards
from vio_eval_ros.inspection.inspection import Inspection

# What a random walk is larger than where it was exchanged with the density: so many times it. That
# of accelerometers is often enlarged for a filter
EXCHANGED = {'gyroscope': 1.0, 'accelerometer': 3.0}
# The rate of the recording is the one that is given, within this part
SAME_RATE = 0.1
DIGITS = 1e-3
# Arms longer than ten times that are in millimetres for certain
LONGEST_ARM_M, BASELINE_M = 2.0, (0.005, 2.0)
SIDEWAYS = 0.7
MISMATCH_M, MISMATCH_DEG = 0.005, 0.5
# A file agrees with itself as well as it has digits
SAME_M, SAME_DEG = 0.001, 0.1
# A camera stands upright where -y of it is within this of up
UPRIGHT_DEG = 20.0
LARGEST_SHIFT_S = 0.1


@dataclass(frozen=True, eq=False)
class Calibration:
    """
    What calibration files say, and what is wrong with it.

    :param sentences: what is so, to be read by a person, by what it is so of: a file, or all.
    """

    chains: list[Chain]
    sentences: dict[str, list[str]]
    findings: list[Finding]

    def to_dict(self) -> dict[str, Any]:
        """Return what was read, for JSON; matrices are row by row."""
        return {
            'chains': [
                {
                    'source': chain.source,
                    'cameras': {
                        name: {
                            'given_as': chain.said[name],
                            'T_imu_cam': matrix.tolist(),
                            'timeshift_s': chain.shifts.get(name),
                        }
                        for name, matrix in chain.cameras.items()
                    },
                    'imus': chain.noise,
                }
                for chain in self.chains
            ],
            'sentences': self.sentences,
        }


def check_calibration(chains: Sequence[Chain], inspection: Inspection) -> Calibration:
    """
    Return what calibration files say, whether it can be so, and whether they agree.

    :param inspection: of the recording; where its IMU stood still, up is told in each camera.
    """
    findings: list[Finding] = []
    sentences: dict[str, list[str]] = {}
    for chain in chains:
        findings += [*_rigid(chain), *_long(chain), *_noise(chain, inspection)]
        told = [_direction(chain, name) for name in chain.cameras]
        for first, second in pairwise(chain.cameras):
            if not _arms(chain).keys() & {first, second}:
                told += _stereo(chain, first, second, findings)
        told += [*_shifts(chain, findings), *_up(chain, inspection, findings), *_said(chain)]
        sentences[chain.source] = told or ['there is no camera in it']
    with_cameras = [chain for chain in chains if chain.cameras]
    for chain in with_cameras[1:]:
        sentences[chain.source] += _agreement(with_cameras[0], chain, findings)
    return Calibration(list(chains), sentences, findings)


def _rigid(chain: Chain) -> Iterator[Finding]:
    """Yield the transformations that are none, as they were written."""
    for (name, key), matrix in chain.given.items():
        rotation = matrix[:3, :3]
        off = float(np.abs(rotation.T @ rotation - np.eye(3)).max())
        determinant = float(np.linalg.det(rotation))
        if off > DIGITS or determinant < 0 or np.abs(matrix[3] - [0, 0, 0, 1]).max() > DIGITS:
            yield Finding(
                'not_a_rotation', f'{chain.source}:{name}', 'fail',
                f'the rotation of {key} is off orthonormal by {off:.2g} and has determinant '
                f'{determinant:.4g}; its last row is {matrix[3].tolist()}',
                value=off,
            )  # fmt: skip


def _arms(chain: Chain) -> dict[str, float]:
    """Return the longest translation that is given of each sensor, where it is too long."""
    arms: dict[str, float] = {}
    for (name, _), matrix in chain.given.items():
        arms[name] = max(arms.get(name, 0.0), float(np.linalg.norm(matrix[:3, 3])))
    return {name: arm for name, arm in arms.items() if arm > LONGEST_ARM_M}


def _long(chain: Chain) -> Iterator[Finding]:
    """Yield that translations are too long; one finding, whatever else follows from it."""
    arms = _arms(chain)
    if arms:
        longest = max(arms.values())
        shown = ', '.join(f'{name} {arm:.4g}' for name, arm in arms.items())
        yield Finding(
            'lever_arm', f'{chain.source}:{next(iter(arms))}',
            'fail' if longest > 10 * LONGEST_ARM_M else 'warn',
            f'translations are longer than {LONGEST_ARM_M:g} m ({shown}): in millimetres?',
            len(arms), longest, 'm',
        )  # fmt: skip


def _noise(chain: Chain, inspection: Inspection) -> Iterator[Finding]:
    """Yield what no IMU has, figures of noise that are far off or not there, or what this has."""
    recorded = [e.timing.rate_hz for e in inspection.streams if e.inertial is not None]
    for name, figures in chain.noise.items():
        where = f'{chain.source}:{name}'
        for key, (unit, least, most) in (NOISE | RATES).items():
            value = figures.get(key, math.nan)
            if not math.isnan(value) and not least <= value <= most:
                yield Finding(
                    'imu_noise', where, 'warn' if value > 0 else 'fail',
                    f'{key} is {value:g} {unit}; from {least:g} to {most:g} there are',
                    value=value, unit=unit,
                )  # fmt: skip
        lacking = [key for key in NOISE if key not in figures]
        if len(lacking) < len(NOISE) and lacking:
            yield Finding('imu_noise', where, 'warn', f'there is no {" and no ".join(lacking)}')
        for sensor, times in EXCHANGED.items():
            density, walk = f'{sensor}_noise_density', f'{sensor}_random_walk'
            pair = [figures.get(key, math.nan) for key in (density, walk)]
            is_known = all(
                NOISE[key][1] <= value <= NOISE[key][2]
                for key, value in zip((density, walk), pair, strict=True)
            )
            if is_known and pair[1] > times * pair[0]:
                yield Finding(
                    'imu_noise', where, 'warn',
                    f'{walk} {pair[1]:g} is larger than {density} {pair[0]:g}: exchanged?',
                    value=pair[1] / pair[0], unit='ratio',
                )  # fmt: skip
        for key, (_, least, most) in RATES.items():
            rate_hz = figures.get(key, math.nan)
            differs = all(abs(one - rate_hz) > SAME_RATE * one for one in recorded)
            if recorded and differs and least <= rate_hz <= most:
                shown = ' and '.join(f'{one:.4g}' for one in recorded)
                yield Finding(
                    'imu_noise', where, 'warn',
                    f'{key} is {rate_hz:g} Hz; the IMU of the recording has {shown} Hz',
                    value=rate_hz, unit='Hz',
                )  # fmt: skip


def _direction(chain: Chain, name: str) -> str:
    """Return in words which way the transformation of a camera maps."""
    said, arm = chain.said[name], chain.cameras[name][:3, 3]
    if not said:
        return f'{name} is the origin; no IMU is given'
    if said == 'T_cn_cnm1':
        words = f'{said} maps the camera before it into {name}'
    elif said in FROM_CAMERA:
        words = f'{said} maps {name} into the {"body" if said == "T_BS" else "IMU"}'
    else:
        words = f'{said} maps the IMU into {name}'
    at = ' '.join(f'{1e3 * x:.1f}' for x in arm)
    frame = 'the IMU' if chain.has_imu else next(iter(chain.cameras))
    return f'{words}; {name} is at {at} mm in the frame of {frame}'


def _stereo(chain: Chain, first: str, second: str, findings: list[Finding]) -> Iterator[str]:
    """Yield how two cameras stand to each other."""
    where = f'{chain.source}:{second}'
    relative = inverse(chain.cameras[first]) @ chain.cameras[second]
    place = relative[:3, 3]
    baseline = float(np.linalg.norm(place))
    if not BASELINE_M[0] <= baseline <= BASELINE_M[1]:
        message = f'its baseline to {first} is {baseline:.4g} m'
        findings.append(Finding('baseline', where, 'warn', message, value=baseline, unit='m'))
    axis = int(np.argmax(np.abs(place)))
    along = '+-'[int(place[axis] < 0)] + 'xyz'[axis]
    yield (
        f'{second} is {1e3 * baseline:.2f} mm from {first}, along {along} of {first}, '
        f'{math.degrees(angle_of_matrix(relative[:3, :3])):.2f} deg turned'
    )
    is_sideways = abs(place[0]) >= SIDEWAYS * baseline
    faces_alike = relative[2, 2] > SIDEWAYS
    ways: list[tuple[str, np.ndarray]] = []
    if _is_given_twice(chain, second):
        disagree = list(_between(chain, first, second, relative))
        findings += disagree
        if disagree:
            return
    elif not chain.said[first] or chain.said[second] != 'T_cn_cnm1':
        names = (first, second) if chain.said[first] else (second,)
        ways = [
            (way, (inverse(cameras[first]) @ cameras[second])[:3, 3])
            for way, cameras in _ways(chain, names)
        ]
    if not is_sideways:
        beside = [way for way, to in ways if abs(to[0]) >= SIDEWAYS * np.linalg.norm(to)]
        if beside:
            message = f'{second} is not beside {first}, but would be if {" or ".join(beside)}'
            findings.append(Finding('direction', where, 'warn', message))
        return
    if faces_alike and place[0] < 0:
        message = f'{first} is the right camera, {second} the left'
        if left := [way for way, to in ways if to[0] >= SIDEWAYS * np.linalg.norm(to)]:
            message += f', unless {" or ".join(left)}'
        offset = float(place[0])
        findings.append(Finding('camera_order', where, 'warn', message, value=offset, unit='m'))
    elif faces_alike:
        yield f'{first} is the left camera, {second} the right'


def _ways(chain: Chain, names: Sequence[str]) -> Iterator[tuple[str, dict[str, np.ndarray]]]:
    """Yield in words how else some cameras may have been meant, and all as they would be then."""
    said = ' and '.join(f'{chain.said[name]} of {name}' for name in names)
    inverted = {name: inverse(chain.cameras[name]) for name in names}
    yield f'{said} were the inverse of what the name says', chain.cameras | inverted
    turned = {}
    for name in names:
        matrix = chain.given[name, chain.said[name]].copy()
        matrix[:3, :3] = matrix[:3, :3].T
        turned[name] = matrix if chain.said[name] in FROM_CAMERA else inverse(matrix)
    yield f'the rotation in {said} were transposed', chain.cameras | turned


def _is_given_twice(chain: Chain, second: str) -> bool:
    """Return whether a file has a camera both in the IMU and in the camera before it."""
    return second in chain.between and chain.said[second] != 'T_cn_cnm1'


def _between(chain: Chain, first: str, second: str, relative: np.ndarray) -> Iterator[Finding]:
    """Yield that a camera is given twice, and not alike, and how it would be."""
    given = inverse(chain.between[second])
    if _agree(given, relative):
        return
    metres, degrees = _apart(given, relative)
    where, said = f'{chain.source}:{second}', chain.said[second]
    message = f'T_cn_cnm1 and {said} disagree by {1e3 * metres:.3g} mm and {degrees:.3g} deg'
    known = [name for name in (first, second) if chain.said[name] in (*FROM_CAMERA, *TO_CAMERA)]
    ways = ['T_cn_cnm1 were its inverse'] * _agree(inverse(given), relative)
    ways += [
        way
        for names in dict.fromkeys((*((name,) for name in known), tuple(known)))
        for way, cameras in _ways(chain, names)
        if _agree(given, inverse(cameras[first]) @ cameras[second])
    ]
    if ways:
        message += f', but would not if {" or ".join(ways)}'
    elif metres <= MISMATCH_M and degrees <= MISMATCH_DEG:
        return
    name = 'direction' if ways else 'chain_mismatch'
    yield Finding(name, where, 'warn', message, value=metres, unit='m')


def _agree(a: np.ndarray, b: np.ndarray) -> bool:
    metres, degrees = _apart(a, b)
    return metres <= SAME_M and degrees <= SAME_DEG


def _shifts(chain: Chain, findings: list[Finding]) -> Iterator[str]:
    for name, shift in chain.shifts.items():
        yield f"{1e3 * shift:+.3f} ms added to the stamps of {name} make them the IMU's"
        if abs(shift) > LARGEST_SHIFT_S:
            where, message = f'{chain.source}:{name}', f'{shift:.3g} s between camera and IMU'
            findings.append(Finding('timeshift', where, 'warn', message, value=shift, unit='s'))


def _said(chain: Chain) -> Iterator[str]:
    """Yield what is said of the noise of each IMU."""
    for name, figures in chain.noise.items():
        if figures:
            units = {key: unit for key, (unit, _, _) in (NOISE | RATES).items()}
            shown = (f'{key} {value:g} {units[key]}' for key, value in figures.items())
            yield f'{name}: {", ".join(shown)}'


def _agreement(first: Chain, chain: Chain, findings: list[Finding]) -> Iterator[str]:
    """Yield by how much the cameras of a file differ from those of the first one."""
    ours, theirs = chain.cameras, first.cameras
    if not (chain.has_imu and first.has_imu):
        ours, theirs = _relative(ours), _relative(theirs)
    if _arms(chain) or _arms(first):
        return  # in different units there is no more to say
    for name in [name for name in ours if name in theirs]:
        metres, degrees = _apart(theirs[name], ours[name])
        differs = f'differs from {first.source} by {1e3 * metres:.3g} mm and {degrees:.3g} deg'
        yield f'{name} {differs}'
        if metres > MISMATCH_M or degrees > MISMATCH_DEG:
            where = f'{chain.source}:{name}'
            findings.append(
                Finding('chain_mismatch', where, 'warn', differs, value=metres, unit='m')
            )


def _relative(cameras: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Return the cameras in the frame of the first of them."""
    origin = inverse(next(iter(cameras.values())))
    return {name: origin @ matrix for name, matrix in cameras.items()}


def _apart(a: np.ndarray, b: np.ndarray) -> tuple[float, float]:
    """Return by how many metres and degrees two transformations differ."""
    difference = inverse(a) @ b
    return float(np.linalg.norm(difference[:3, 3])), math.degrees(
        angle_of_matrix(difference[:3, :3])
    )


def _up(chain: Chain, inspection: Inspection, findings: list[Finding]) -> Iterator[str]:
    """Yield which axis of each camera points up, if it is fixed to an IMU that stood still."""
    felt = next((e.inertial for e in inspection.streams if e.inertial and e.inertial.up), None)
    if felt is None or not chain.has_imu:
        return
    force = np.array(felt.force_m_s2)
    told = {one.topic for one in findings if one.name in ('direction', 'chain_mismatch')}
    for name, matrix in chain.cameras.items():
        axis, off = upwards(matrix[:3, :3].T @ force)
        yield (
            f'{axis} of {name} points up while {felt.up} of the IMU does ({off:.1f} deg off; '
            '-y of a camera that stands upright)'
        )
        other, other_off = upwards(matrix[:3, :3] @ force)
        is_upright = other == '-y' and other_off < UPRIGHT_DEG
        if axis != '-y' and is_upright and not any(f'{chain.source}:' in one for one in told):
            # some are mounted upside down
            findings.append(
                Finding(
                    'direction', f'{chain.source}:{name}', 'info' if axis == '+y' else 'warn',
                    f'at rest {axis} of {name} points up; it would stand upright if its rotation '
                    f'in {chain.said[name]} were transposed, or all of it inverted',
                )
            )  # fmt: skip
