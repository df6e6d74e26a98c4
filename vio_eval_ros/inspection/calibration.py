"""Whether a calibration can be right: rotations, directions, lever arms, baselines, order."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
import math
from typing import Any

import numpy as np

from vio_eval_ros.core.rotation import angle_of_matrix
from vio_eval_ros.inspection.calibration_files import (
    CalibrationFile,
    FROM_CAMERA,
    FROM_CAMERA_BEFORE,
    inverse,
    TO_CAMERA,
)
from vio_eval_ros.inspection.calibration_noise import noise_findings, noise_sentences
from vio_eval_ros.inspection.finding import Finding
from vio_eval_ros.inspection.findings import FINDINGS
from vio_eval_ros.inspection.inertial import upwards
from vio_eval_ros.inspection.inspection import InspectedStreams
from vio_eval_ros.inspection.limits import InspectionLimits

#: length of a translation, over the limit, above which it can only be in millimetres
MILLIMETRES = 10.0
#: least cosine between the baseline and x of cameras that are side by side, and between the
#: optical axes of cameras that look the same way
SIDEWAYS_COSINE = 0.7
# A file agrees with itself as well as it has digits
SAME_M, SAME_DEG = 0.001, 0.1


@dataclass(frozen=True, eq=False)
class Calibration:
    """
    What calibration files say, and what is wrong with it.

    :param sentences: what is so, to be read by a person, by file.
    """

    files: list[CalibrationFile]
    sentences: dict[str, list[str]]
    findings: list[Finding]

    def to_dict(self) -> dict[str, Any]:
        """Return what was read, for JSON; matrices are row by row."""
        return {
            'chains': [
                {
                    'source': file.source,
                    'cameras': {
                        name: {
                            'given_as': file.keys[name],
                            'T_imu_cam': matrix.tolist(),
                            'timeshift_s': file.shifts.get(name),
                        }
                        for name, matrix in file.cameras.items()
                    },
                    'imus': file.noise,
                }
                for file in self.files
            ],
            'sentences': self.sentences,
        }


def check_calibration(
    files: Sequence[CalibrationFile], inspection: InspectedStreams
) -> Calibration:
    """
    Return what calibration files say, whether it can be so, and whether they agree.

    :param inspection: of the recording; where its IMU stood still, it tells which axis of each
        camera points up.
    """
    limits = inspection.limits
    rates_hz = [one.timing.rate_hz for one in inspection.streams if one.inertial is not None]
    findings: list[Finding] = []
    sentences: dict[str, list[str]] = {}
    for file in files:
        findings += [*_rigid(file, limits), *_long(file, limits)]
        findings += noise_findings(file, rates_hz, limits)
        said = [_direction(file, name) for name in file.cameras]
        for first, second in pairwise(file.cameras):
            if not _too_long(file, limits).keys() & {first, second}:
                said += _stereo(file, first, second, limits, findings)
        said += [
            *_shifts(file, limits, findings),
            *_up(file, inspection, findings),
            *noise_sentences(file),
        ]
        sentences[file.source] = said or ['there is no camera in it']
    with_cameras = [file for file in files if file.cameras]
    for file in with_cameras[1:]:
        sentences[file.source] += _agreement(with_cameras[0], file, limits, findings)
    return Calibration(list(files), sentences, findings)


def _rigid(file: CalibrationFile, limits: InspectionLimits) -> Iterator[Finding]:
    """Yield matrices that are not rigid transforms, as they were written."""
    for (name, key), matrix in file.given.items():
        rotation = matrix[:3, :3]
        off = float(np.abs(rotation.T @ rotation - np.eye(3)).max())
        determinant = float(np.linalg.det(rotation))
        last_row_off = float(np.abs(matrix[3] - [0, 0, 0, 1]).max())
        if max(off, last_row_off) > limits.rotation_tolerance or determinant < 0:
            yield FINDINGS['not_a_rotation'].found(
                f'{file.source}:{name}',
                key=key,
                determinant=determinant,
                row=matrix[3].tolist(),
                value=off,
            )


def _too_long(file: CalibrationFile, limits: InspectionLimits) -> dict[str, float]:
    """Return the longest translation that is given of each sensor, where it is too long."""
    arms: dict[str, float] = {}
    for (name, _), matrix in file.given.items():
        arms[name] = max(arms.get(name, 0.0), float(np.linalg.norm(matrix[:3, 3])))
    return {name: arm for name, arm in arms.items() if arm > limits.lever_arm_m}


def _long(file: CalibrationFile, limits: InspectionLimits) -> Iterator[Finding]:
    """Yield that translations are too long; one finding, whatever else follows from it."""
    arms = _too_long(file, limits)
    if arms:
        longest = max(arms.values())
        yield FINDINGS['lever_arm'].found(
            f'{file.source}:{next(iter(arms))}',
            severe=longest > MILLIMETRES * limits.lever_arm_m,
            limit=limits.lever_arm_m,
            arms=', '.join(f'{name} {arm:.4g}' for name, arm in arms.items()),
            count=len(arms),
            value=longest,
        )


def _direction(file: CalibrationFile, name: str) -> str:
    """Return in words which way the transformation of a camera maps."""
    key = file.keys[name]
    if not key:
        return f'{name} is the origin; no IMU is given'
    if key == FROM_CAMERA_BEFORE:
        words = f'{key} maps the camera before it into {name}'
    elif key in FROM_CAMERA:
        words = f'{key} maps {name} into the {"body" if key == "T_BS" else "IMU"}'
    else:
        words = f'{key} maps the IMU into {name}'
    at = ' '.join(f'{1e3 * x:.1f}' for x in file.cameras[name][:3, 3])
    frame = 'the IMU' if file.has_imu else next(iter(file.cameras))
    return f'{words}; {name} is at {at} mm in the frame of {frame}'


def _stereo(
    file: CalibrationFile,
    first: str,
    second: str,
    limits: InspectionLimits,
    findings: list[Finding],
) -> Iterator[str]:
    """Yield how two cameras stand to each other."""
    where = f'{file.source}:{second}'
    relative = inverse(file.cameras[first]) @ file.cameras[second]
    place = relative[:3, 3]
    baseline = float(np.linalg.norm(place))
    if not limits.baseline_min_m <= baseline <= limits.baseline_max_m:
        findings.append(FINDINGS['baseline'].found(where, first=first, value=baseline))
    axis = int(np.argmax(np.abs(place)))
    along = '+-'[int(place[axis] < 0)] + 'xyz'[axis]
    yield (
        f'{second} is {1e3 * baseline:.2f} mm from {first}, along {along} of {first}, rotated by '
        f'{math.degrees(angle_of_matrix(relative[:3, :3])):.2f} deg'
    )
    other_places: list[tuple[str, np.ndarray]] = []
    if _is_given_twice(file, second):
        mismatch = _mismatch(file, first, second, relative, limits)
        if mismatch is not None:
            findings.append(mismatch)
            return
    else:
        other_places = _other_places(file, first, second)
    if not _is_beside(place):
        ways = [way for way, other in other_places if _is_beside(other)]
        if ways:
            findings.append(
                FINDINGS['direction'].found(
                    where, 'beside', first=first, second=second, ways=' or '.join(ways)
                )
            )
    elif relative[2, 2] > SIDEWAYS_COSINE:  # they look the same way
        if place[0] >= 0:
            yield f'{first} is the left camera, {second} the right'
            return
        ways = [way for way, other in other_places if _is_beside(other) and other[0] >= 0]
        findings.append(
            FINDINGS['camera_order'].found(
                where,
                first=first,
                second=second,
                unless=f', unless {" or ".join(ways)}' if ways else '',
                value=float(place[0]),
            )
        )


def _is_beside(place: np.ndarray) -> bool:
    """Return whether a camera at (3,) ``place`` of another one is beside it."""
    return bool(abs(place[0]) >= SIDEWAYS_COSINE * np.linalg.norm(place))


def _other_places(file: CalibrationFile, first: str, second: str) -> list[tuple[str, np.ndarray]]:
    """Return in words how else two cameras may have been meant, and where the second is then."""
    if file.keys[first] and file.keys[second] == FROM_CAMERA_BEFORE:
        return []
    names = (first, second) if file.keys[first] else (second,)
    return [
        (way, (inverse(cameras[first]) @ cameras[second])[:3, 3])
        for way, cameras in _ways(file, names)
    ]


def _ways(
    file: CalibrationFile, names: Sequence[str]
) -> Iterator[tuple[str, dict[str, np.ndarray]]]:
    """Yield in words how else some cameras may have been meant, and all as they would be then."""
    keys = ' and '.join(f'{file.keys[name]} of {name}' for name in names)
    inverted = {name: inverse(file.cameras[name]) for name in names}
    yield f'{keys} were the inverse of what the name says', file.cameras | inverted
    transposed = {}
    for name in names:
        matrix = file.given[name, file.keys[name]].copy()
        matrix[:3, :3] = matrix[:3, :3].T
        transposed[name] = matrix if file.keys[name] in FROM_CAMERA else inverse(matrix)
    yield f'the rotation in {keys} were transposed', file.cameras | transposed


def _is_given_twice(file: CalibrationFile, second: str) -> bool:
    """Return whether a file has a camera both in the IMU and in the camera before it."""
    return second in file.between and file.keys[second] != FROM_CAMERA_BEFORE


def _mismatch(
    file: CalibrationFile, first: str, second: str, relative: np.ndarray, limits: InspectionLimits
) -> Finding | None:
    """Return that a camera is given twice, and not alike, and how it would be."""
    given = inverse(file.between[second])
    if _agree(given, relative):
        return None
    metres, degrees = _apart(given, relative)
    where, key = f'{file.source}:{second}', file.keys[second]
    apart = f'{FROM_CAMERA_BEFORE} and {key} differ by {1e3 * metres:.3g} mm and {degrees:.3g} deg'
    known = [name for name in (first, second) if file.keys[name] in (*FROM_CAMERA, *TO_CAMERA)]
    ways = [f'{FROM_CAMERA_BEFORE} were its inverse'] * _agree(inverse(given), relative)
    ways += [
        way
        for names in dict.fromkeys((*((name,) for name in known), tuple(known)))
        for way, cameras in _ways(file, names)
        if _agree(given, inverse(cameras[first]) @ cameras[second])
    ]
    if ways:
        ways_shown = ' or '.join(ways)
        return FINDINGS['direction'].found(
            where, 'chain', apart=apart, ways=ways_shown, value=metres, unit='m'
        )
    if metres <= limits.mismatch_m and degrees <= limits.mismatch_deg:
        return None
    return FINDINGS['chain_mismatch'].found(where, apart=apart, value=metres)


def _agree(a: np.ndarray, b: np.ndarray) -> bool:
    metres, degrees = _apart(a, b)
    return metres <= SAME_M and degrees <= SAME_DEG


def _apart(a: np.ndarray, b: np.ndarray) -> tuple[float, float]:
    """Return by how many metres and degrees two transformations differ."""
    difference = inverse(a) @ b
    degrees = math.degrees(angle_of_matrix(difference[:3, :3]))
    return float(np.linalg.norm(difference[:3, 3])), degrees


def _shifts(
    file: CalibrationFile, limits: InspectionLimits, findings: list[Finding]
) -> Iterator[str]:
    """Yield by how much the clocks of the cameras differ from that of the IMU."""
    for name, shift in file.shifts.items():
        yield f"{1e3 * shift:+.3f} ms added to the stamps of {name} make them the IMU's"
        if abs(shift) > limits.timeshift_s:
            findings.append(FINDINGS['timeshift'].found(f'{file.source}:{name}', value=shift))


def _agreement(
    first: CalibrationFile,
    file: CalibrationFile,
    limits: InspectionLimits,
    findings: list[Finding],
) -> Iterator[str]:
    """Yield by how much the cameras of a file differ from those of the first one."""
    ours, theirs = file.cameras, first.cameras
    if not (file.has_imu and first.has_imu):
        ours, theirs = _in_first_camera(ours), _in_first_camera(theirs)
    if _too_long(file, limits) or _too_long(first, limits):
        return  # in different units there is no more to say
    for name in [name for name in ours if name in theirs]:
        metres, degrees = _apart(theirs[name], ours[name])
        apart = f'differs from {first.source} by {1e3 * metres:.3g} mm and {degrees:.3g} deg'
        yield f'{name} {apart}'
        if metres > limits.mismatch_m or degrees > limits.mismatch_deg:
            where = f'{file.source}:{name}'
            findings.append(FINDINGS['chain_mismatch'].found(where, apart=apart, value=metres))


def _in_first_camera(cameras: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Return the cameras in the frame of the first of them."""
    origin = inverse(next(iter(cameras.values())))
    return {name: origin @ matrix for name, matrix in cameras.items()}


def _up(
    file: CalibrationFile, inspection: InspectedStreams, findings: list[Finding]
) -> Iterator[str]:
    """Yield which axis of each camera points up, if it is fixed to an IMU that stood still."""
    felt = next((e.inertial for e in inspection.streams if e.inertial and e.inertial.up), None)
    if felt is None or not file.has_imu:
        return
    force = np.array(felt.force_m_s2)
    is_explained = any(
        one.name in ('direction', 'chain_mismatch') and one.topic.startswith(f'{file.source}:')
        for one in findings
    )
    for name, matrix in file.cameras.items():
        axis, off = upwards(matrix[:3, :3].T @ force)
        yield (
            f'{axis} of {name} points up while {felt.up} of the IMU does ({off:.1f} deg off; '
            '-y of a camera that stands upright)'
        )
        other, other_off = upwards(matrix[:3, :3] @ force)
        is_upright = other == '-y' and other_off < inspection.limits.upright_deg
        if axis != '-y' and is_upright and not is_explained:
            finding = FINDINGS['direction'].found(
                f'{file.source}:{name}',
                'upright',
                minor=axis == '+y',  # some are mounted upside down
                axis=axis,
                camera=name,
                key=file.keys[name],
            )
            findings.append(finding)
