"""Diagnosis of what was recorded: sources of poses, a gyroscope, signals in files."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from vio_eval_ros.core.cleaning import clean, Cleaning
from vio_eval_ros.core.config import EvaluationConfig
from vio_eval_ros.core.limits import PROFILES
from vio_eval_ros.core.orientations import LARGEST_NUMBER, UNUSABLE, why_positions_only
from vio_eval_ros.diagnosis.diagnosis import diagnose
from vio_eval_ros.diagnosis.gyroscope import compare
from vio_eval_ros.diagnosis.limits import DiagnosisLimits
from vio_eval_ros.diagnosis.report import Diagnosis
from vio_eval_ros.errors import ReadError
from vio_eval_ros.recordings.agreement import assumed, comparable
from vio_eval_ros.recordings.imu import read_imu
from vio_eval_ros.recordings.progress import Progress
from vio_eval_ros.recordings.sources import Source
from vio_eval_ros.recordings.spec import Spec
from vio_eval_ros.recordings.text import read_text


class Rates(NamedTuple):
    """What a gyroscope measured: (N,) stamps [ns] and (N, 3) rad/s."""

    stamps_ns: np.ndarray
    rad_s: np.ndarray


class SignalFile(NamedTuple):
    """
    A signal in a file.

    :param stamps_ns: (N,) increasing.
    :param values: (N,) finite.
    :param left_out: how many rows repeat a stamp or are not finite.
    """

    stamps_ns: np.ndarray
    values: np.ndarray
    left_out: int


def diagnose_sources(
    estimate: Source,
    ground_truth: Source,
    config: EvaluationConfig,
    profile: str = PROFILES[0],
    limits: DiagnosisLimits | None = None,
    gyroscope: Rates | None = None,
) -> Diagnosis:
    """
    Return what is wrong with an estimate, from poses as they were recorded.

    :param config: options of the evaluation; its offset, frames and crop are applied first.
    :param profile: the platform, one of PROFILES.
    :param limits: what counts as healthy; by default that of the profile.
    :param gyroscope: to be compared with the estimate as well.
    :raises ReadError: poses of several publishers take turns on one side.
    :raises NoPairs: where there are too few poses, or the two sides have no time in common.
    :raises ConfigError: there is no such profile.
    """
    estimate, ground_truth = comparable(estimate, ground_truth, config)
    received = {'estimate': estimate.poses, 'ground_truth': ground_truth.poses}
    unusable = [side for side, each in received.items() if why_positions_only(each) == UNUSABLE]
    counts = {side: Cleaning() for side in received}
    poses, truth = (
        clean(replace(each, rotations=None) if side in unusable else each, counts[side])
        for side, each in received.items()
    )
    diagnosis = diagnose(poses, truth, config, limits or DiagnosisLimits.of(profile))
    dropped = {side: count.dropped for side, count in counts.items()}
    diagnosis = replace(
        diagnosis,
        profile=profile,
        findings=diagnosis.findings | {'dropped': dropped},
        assumed=assumed(estimate, ground_truth),
    )
    diagnosis = _without_stated_flags(
        {'estimate': estimate, 'ground_truth': ground_truth}, diagnosis
    )
    if gyroscope is None:
        return diagnosis
    return replace(diagnosis, gyroscope=compare(poses, gyroscope.stamps_ns, gyroscope.rad_s))


def _without_stated_flags(sources: Mapping[str, Source], diagnosis: Diagnosis) -> Diagnosis:
    """
    Return the diagnosis without flags that only repeat how a side was read.

    A topic has the order of its type. What cannot be stated leaves frames that no flag corrects.
    """
    causes, misread = [], set()
    for cause in diagnosis.causes:
        source = sources[cause.side]
        spec = Spec.parse(source.spec)
        stated = cause.flags == (f'?quaternion={source.order or "xyzw"}',)
        if cause.name == 'quaternion_order' and (stated or spec.topic):
            misread.add(cause.side)
        if source.kind == 'arrays':  # conventions are stated of files only
            cause = replace(cause, flags=tuple(f for f in cause.flags if not f.startswith('?')))
        kept = cause.side not in misread or cause.flags[:1] == ('--time-offset-s',)
        causes.append(cause if kept else replace(cause, flags=()))
    return replace(diagnosis, causes=tuple(causes))


def read_gyroscope(text: str, recording: Path | None, progress: Progress) -> Rates:
    """
    Return the rates of a gyroscope.

    :param text: ``/topic`` of the recording, ``RECORDING:/topic``, or a CSV file.
    :param progress: shows how far reading has come.
    :raises ReadError: it cannot be read.
    """
    spec = Spec.parse(text)
    path = spec.path or recording
    if path is None:
        raise ReadError(text, 'a topic needs a RECORDING, given first or as RECORDING:/topic')
    blocks: list[tuple[np.ndarray, np.ndarray]] = []
    source = read_imu(
        path,
        spec.topic,
        lambda stamps, samples: blocks.append((stamps, samples[:, :3])),
        progress,
        f'--imu {spec.path}:' if spec.path else '--imu ',
    )
    stamps_ns, rates = (np.concatenate(part) for part in zip(*blocks, strict=True))
    degrees = source.units.get('gyro') == 'deg/s'
    return Rates(stamps_ns, np.radians(rates) if degrees else rates)


def read_signal(path: Path) -> SignalFile:
    """
    Return a signal from a file of time and value.

    :raises ReadError: it cannot be read, or has no value.
    """
    rows = read_text(path).rows
    if rows.values.shape[1] < 2:
        raise ReadError(path, 'a signal has two columns, time and value')
    stamps = rows.exact[0]
    all_ns = stamps.nanoseconds(path, stamps.likely_unit)
    stamps_ns, first = np.unique(all_ns, return_index=True)
    values = rows.values[first, 1]
    known = np.abs(values) < LARGEST_NUMBER
    if not known.any():
        raise ReadError(path, 'its second column has no finite value')
    kept = stamps_ns[known]
    return SignalFile(kept, values[known], len(rows.values) - len(kept))
