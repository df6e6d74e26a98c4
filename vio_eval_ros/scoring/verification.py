"""
Scores the files of a manifest again, and reports whether the results are reproduced.

Nothing is done with a manifest but to read the files that it names.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
import json
import math
from pathlib import Path
from typing import Any

from vio_eval_ros.core.evaluation import metric_names
from vio_eval_ros.core.gates import check_names
from vio_eval_ros.errors import ReadError, VioEvalError
from vio_eval_ros.evaluation.recorded import score_run, sha256
from vio_eval_ros.evaluation.result import Result
from vio_eval_ros.recordings.progress import Progress, silent
from vio_eval_ros.recordings.sources import read_sources
from vio_eval_ros.recordings.spec import Spec
from vio_eval_ros.scoring.manifest import judgement, machine
from vio_eval_ros.scoring.recorded_manifest import (
    compared_parts,
    flat,
    load_manifest,
    RecordedManifest,
    RecordedRun,
)
from vio_eval_ros.scoring.results import judged_together
from vio_eval_ros.scoring.scoring import score_suite
from vio_eval_ros.scoring.suite import RunSpec, Sequence, Suite
from vio_eval_ros.version import __version__

NAMES = ('inputs.estimate.source', 'inputs.ground_truth.source')
MOST_SHOWN = 20


@dataclass(frozen=True)
class Verification:
    """
    The outcome of scoring the runs of a manifest again.

    :param runs: how many there are.
    :param reproduced: how many gave the same result, to the last bit.
    :param differences: of the inputs and results, a line each.
    :param notes: what else has changed, which should affect no result.
    """

    runs: int
    reproduced: int
    differences: tuple[str, ...]
    notes: tuple[str, ...]


def verify(file: Path, progress: Progress = silent) -> Verification:
    """
    Score the runs of a manifest again, judge them again, and compare the results bit by bit.

    :raises ReadError: it is not a manifest, or is damaged.
    """
    manifest = load_manifest(file)
    runs = manifest.runs
    if all(run.values is None for run in runs):
        raise ReadError(file, 'contains no result that could be reproduced')
    notes = list(dict.fromkeys(_notes(manifest)))
    differences: list[str] = []
    results: list[Result | None] = []
    reproduced = 0
    for run in progress(runs, len(runs)):
        result, others = _scored_again(run)
        results.append(result)
        reproduced += not others
        differences += [f'{run.name}: {difference}' for difference in others]
    differences += _judged_again(manifest, iter(results))
    return Verification(len(runs), reproduced, tuple(differences), tuple(notes))


def _notes(manifest: RecordedManifest) -> Iterator[str]:
    """Yield what has changed around the results."""
    for name, now in {**machine(), 'vio_eval_ros': __version__}.items():
        was = manifest.tools.get(name)
        if was != now:
            yield f'{name} was {was!s:.60}, is {now}'
    yield from _changed(manifest.documents)
    for one in manifest.sequences:
        yield from _changed(one.documents)
        for run in one.runs:
            if run.values is None:
                yield f'{run.name}: could not be scored then: {run.error:.200}'


def _judged_again(manifest: RecordedManifest, results: Iterator[Result | None]) -> Iterator[str]:
    """Yield what differs from when the runs were judged together, given their results now."""
    again = judged_together(
        [one.judge([next(results) for _ in one.runs]) for one in manifest.sequences]
    )
    passed = True
    for one, now in zip(manifest.sequences, again, strict=True):
        if one.judged:
            passed &= now.passed
            for difference in _others(one.judged, judgement(now), one.runs[0].whole):
                yield f'{one.name}: {difference}'
    if manifest.verdict is not None:
        verdict = {'verdict': 'pass' if passed else 'fail'}
        for difference in _others({'verdict': manifest.verdict}, verdict, False):
            yield f'suite: {difference}'


def _scored_again(run: RecordedRun) -> tuple[Result | None, list[str]]:
    """Return the result of a run if there is one, and what has changed."""
    differences = list(_changed(run.files))
    if not all(map(_is_there, run.files)):
        return None, differences
    try:
        _check_paths(run)
        result = _score_apart(run) if run.values is None else _score(run)
    except (VioEvalError, OSError) as error:
        if run.values is None:
            return None, differences
        return None, [*differences, f'can no longer be scored: {error}']
    if result is None or run.values is None:
        return result, differences if result is None else [*differences, 'can be scored now']
    now = compared_parts(result.to_dict(), run.whole)
    return result, [*differences, *_others(run.values, now, run.whole)]


def _others(values: Mapping[str, Any], content: Mapping[str, Any], whole: bool) -> Iterator[str]:
    """
    Yield which of the values, by dotted names, differ from those in the content of now.

    :param whole: whether additional values are differences, too.
    """
    # as it would be after a round trip through JSON
    now = dict(flat(json.loads(json.dumps(content))))
    other = {
        name: (was, now.get(name, 'absent'))
        for name, was in values.items()
        if name not in NAMES and (name not in now or now[name] != was)
    }
    if whole:
        other |= {name: ('absent', now[name]) for name in now if name not in values}
    for name in list(other)[:MOST_SHOWN]:
        yield f'{_shown(name)} {_comparison(*other[name])}'
    if len(other) > MOST_SHOWN:
        most = max(other, key=lambda name: _share(*other[name]))
        yield (
            f'{len(other)} of {len(values)} values differ, most of all '
            f'{_shown(most)}, which {_comparison(*other[most])}'
        )


def _check_paths(run: RecordedRun) -> None:
    for path in (*(Spec.parse(spec).path for spec in run.specs), run.times):
        if path is not None and not (path.is_file() or path.is_dir()):
            raise ReadError(path, 'there is no such file')  # devices and pipes are not read


def _score_apart(run: RecordedRun) -> Result | None:
    """Return the result of a run in a process of its own, which it may kill."""
    truth, estimate, *causal = run.specs
    again = RunSpec(run.name, estimate, causal=causal[0] if causal else None)
    sequence = Sequence(run.name, (again,), truth, run.config, (), times=run.times)
    return score_suite(Suite(Path(), (sequence,)), 1).sequences[0].runs[0].result


def _score(run: RecordedRun) -> Result:
    truth, estimate, *causal = read_sources(run.specs, None, run.times)
    if causal:
        estimate = estimate.revising(causal[0])
    check_names(run.gates, metric_names(run.config) if run.gates else ())
    return score_run(estimate, truth, run.config, run.gates)


def _changed(files: Mapping[Path, str | None]) -> Iterator[str]:
    """Yield which files are missing or have changed."""
    for path, digest in files.items():
        if not _is_there(path):
            yield f'{path} is missing'
        elif sha256([path]) != digest:
            yield f'{path} has changed'


def _is_there(path: Path) -> bool:
    try:
        return path.is_file()
    except (OSError, ValueError):  # such as a name that is too long
        return False


def _shown(name: str) -> str:
    return name.removeprefix('metrics.')[:60]


def _comparison(was: Any, now: Any) -> str:
    text, share = f'was {was!s:.60}, is {now!s:.60}', _share(was, now)
    return f'{text} ({now - was:+.2g}, {_percent(share)})' if share else text


def _percent(share: float) -> str:
    return f'{100 * share:.2g} % change'


def _share(was: Any, now: Any) -> float:
    """Return the difference of two numbers as a share of the larger; 0 for other values."""
    if isinstance(was, bool) or isinstance(now, bool):
        return 0.0
    try:
        share = abs(now - was) / max(abs(now), abs(was))
    except (TypeError, OverflowError):
        return 0.0
    return share if math.isfinite(share) else 0.0
