"""
Scores the files of a manifest again, and says whether the results are reproduced.

A manifest may come from anywhere: nothing is done with it but to read the files that it names.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
import hashlib
import json
import math
from pathlib import Path
from typing import Any, NamedTuple, NoReturn, TypeVar

from vio_eval_ros.core.cleaning import LARGEST
from vio_eval_ros.core.config import EvaluationConfig
from vio_eval_ros.core.evaluation import metric_names
from vio_eval_ros.core.gates import check_names, Gate, LIMITS, SEVERITIES
from vio_eval_ros.errors import ConfigError, ReadError, VioEvalError
from vio_eval_ros.evaluation.recorded import score_run, sha256
from vio_eval_ros.evaluation.result import Result
from vio_eval_ros.recordings.progress import Progress, silent
from vio_eval_ros.recordings.sources import read_sources
from vio_eval_ros.recordings.spec import Spec
from vio_eval_ros.scoring.baseline import damage, Rule
from vio_eval_ros.scoring.manifest import judged, machine, MAX_BYTES, SCHEMA
from vio_eval_ros.scoring.scoring import RunResult, score_suite, SequenceResult
from vio_eval_ros.scoring.suite import DEFAULT_GATES, OVER, Run, RunsGate, Sequence, Suite
from vio_eval_ros.settings import finite
from vio_eval_ros.version import __version__

#: parts of a result that are compared; the others say how it was made, or have paths in them
COMPARED = ('config', 'inputs', 'verdict', 'gates', 'metrics', 'association', 'alignment')
#: parts of a sequence that are compared: what its runs were found to be together
JUDGED = ('gates', 'comparisons', 'verdict')
#: parts of a result in which there always is something
FULL = ('config', 'metrics', 'association', 'alignment')
INPUTS = ('ground_truth', 'estimate')
VERDICTS = ('pass', 'fail')
NAMES = ('inputs.estimate.source', 'inputs.ground_truth.source')
#: what reading anything but a manifest raises
DAMAGED = (
    ValueError, KeyError, TypeError, AttributeError, OverflowError, RecursionError, ConfigError,
)  # fmt: skip
MOST_SHOWN = 20
Kind = TypeVar('Kind')


@dataclass(frozen=True)
class Verification:
    """
    What came of scoring again what a manifest names.

    :param runs: how many were.
    :param reproduced: how many gave the same result, to the last bit.
    :param differences: of the inputs and results, a line each.
    :param notes: what else has changed, on which no result should depend.
    """

    runs: int
    reproduced: int
    differences: tuple[str, ...]
    notes: tuple[str, ...]


class RecordedRun(NamedTuple):
    """
    A run of a manifest.

    :param specs: of the ground truth, the estimate, and where it was revised also of the estimate
        as first published.
    :param files: path and sha256 of the inputs.
    :param values: the result, by dotted names; None where it could not be scored.
    :param whole: whether the manifest is of this version, and so has all that there is now.
    """

    name: str
    specs: tuple[str, ...]
    times: Path | None
    config: EvaluationConfig
    gates: tuple[Gate, ...]
    files: Mapping[Path, str | None]
    values: Mapping[str, Any] | None
    whole: bool


class RecordedSequence(NamedTuple):
    """
    A sequence of a manifest.

    :param gates: over all runs, and ``rules`` with the values of the baseline that they were
        compared with, None where there was none.
    :param judged: what came of both, by dotted names; nothing where runs were not judged together.
    """

    name: str
    runs: tuple[RecordedRun, ...]
    config: EvaluationConfig
    gates: tuple[RunsGate, ...]
    rules: tuple[tuple[Rule, tuple[float, ...]], ...] | None
    judged: Mapping[str, Any]

    def judge(self, results: Iterable[Result | None]) -> SequenceResult:
        """Return what the runs are together, given the result of each."""
        runs = [RunResult(Run('', ''), result) for result in results]
        sequence = Sequence(self.name, (), '', self.config, self.gates)
        alone = SequenceResult(sequence, runs)
        if self.rules is None:
            return alone
        comparisons = [alone.compared(rule, baseline) for rule, baseline in self.rules]
        return SequenceResult(sequence, runs, comparisons)


def verify(file: Path, progress: Progress = silent) -> Verification:
    """
    Score the runs of a manifest again, judge them again, and compare the results bit by bit.

    :raises ReadError: no manifest, or a damaged one.
    """
    try:
        sequences, verdict, notes = _load(file)
    except DAMAGED as error:
        raise ReadError(file, f'is no manifest, or a damaged one ({damage(error)})') from None
    runs = [run for one in sequences for run in one.runs]
    if all(run.values is None for run in runs):
        raise ReadError(file, 'has no result that could be reproduced')
    differences: list[str] = []
    results: list[Result | None] = []
    reproduced = 0
    for run in progress(runs, len(runs)):
        result, others = _scored_again(run)
        results.append(result)
        reproduced += not others
        differences += [f'{run.name}: {difference}' for difference in others]
    differences += _judged_again(sequences, iter(results), verdict)
    return Verification(len(runs), reproduced, tuple(differences), tuple(notes))


def _judged_again(
    sequences: Iterable[RecordedSequence], results: Iterator[Result | None], verdict: str | None
) -> Iterator[str]:
    """Yield what is other than it was when the runs were judged, given their results."""
    passed = True
    for one in sequences:
        again = [next(results) for _ in one.runs]
        if one.judged:
            judgement = one.judge(again)
            passed &= judgement.passed
            for difference in _others(one.judged, judged(judgement), one.runs[0].whole):
                yield f'{one.name}: {difference}'
    if verdict is not None:
        now = {'verdict': 'pass' if passed else 'fail'}
        for difference in _others({'verdict': verdict}, now, False):
            yield f'suite: {difference}'


def _load(file: Path) -> tuple[list[RecordedSequence], str | None, list[str]]:
    """Return the sequences of a manifest, the verdict on all, and what has changed around them."""
    content = _parsed(file)
    sequences, notes = [], []
    was, now = _of(content['machine'], dict), machine()
    was['vio_eval_ros'], now['vio_eval_ros'] = _of(content['tool'], dict)['version'], __version__
    whole = was['vio_eval_ros'] == __version__
    for name, value in now.items():
        if was.get(name) != value:
            notes.append(f'{name} was {was.get(name)!s:.60}, is {value}')
    notes += _changed(
        _files(file.parent, [content[name] for name in ('suite', 'baseline') if name in content])
    )
    is_judged = 'suite' in content or 'verdict' in content
    if is_judged and content['verdict'] not in VERDICTS:
        raise ValueError('a verdict is neither pass nor fail')
    for sequence in _of(content['sequences'], list):
        documents = [*_of(sequence['stack'], dict)['config'], *_of(sequence['calibration'], list)]
        notes += _changed(_files(file.parent, documents))
        config = EvaluationConfig.from_mapping(_of(sequence['options'], dict))
        runs = []
        for run in _of(sequence['runs'], list):
            name = f'{_of(sequence["name"], str)}, {_of(run["estimate"]["spec"], str)}'
            if run['result'] is None:
                notes.append(f'{name}: could not be scored then: {_of(run["error"], str):.200}')
            runs.append(_recorded(file.parent, name, config, run, whole))
        sequences.append(_recorded_sequence(sequence, config, runs, is_judged))
    return sequences, content.get('verdict'), list(dict.fromkeys(notes))


def _recorded_sequence(
    sequence: Mapping[str, Any],
    config: EvaluationConfig,
    runs: Iterable[RecordedRun],
    is_judged: bool,
) -> RecordedSequence:
    name, runs = sequence['name'], tuple(runs)
    if not is_judged:
        return RecordedSequence(name, runs, config, (), None, {})
    if not runs:
        raise ValueError('a sequence was judged without runs')
    if sequence['verdict'] not in VERDICTS:
        raise ValueError('a verdict is neither pass nor fail')
    gates = tuple(_runs_gate(_of(gate, dict)) for gate in _of(sequence['gates'], list))
    if not {gate.metric for gate in DEFAULT_GATES} <= {runs.gate.metric for runs in gates}:
        raise ValueError('a sequence was judged without the gates that are always there')
    compared = sequence['comparisons']
    rules = None if compared is None else tuple(_rule(_of(one, dict)) for one in compared)
    parts = {part: sequence[part] for part in JUDGED}
    return RecordedSequence(name, runs, config, gates, rules, dict(_flat(parts)))


def _runs_gate(gate: Mapping[str, Any]) -> RunsGate:
    if gate['of'] not in OVER:
        raise ValueError(f'a gate is of {" or ".join(OVER)}')
    return RunsGate(_gate(gate), gate['of'])


def _rule(comparison: Mapping[str, Any]) -> tuple[Rule, tuple[float, ...]]:
    """Return a rule, and the values of the baseline."""
    limits = dict(_of(comparison['rule'], dict))
    values = tuple(finite(value) for value in _of(comparison['baseline_values'], list))
    if not all(abs(value) < LARGEST for value in values):
        raise ValueError('a baseline has values that are no numbers')
    return Rule.of(_of(limits.pop('metric'), str), limits), values


def _parsed(file: Path) -> dict[str, Any]:
    """Return what a manifest has, after its schema and the texts in it were checked."""
    try:
        with file.open('rb') as stream:
            data = stream.read(MAX_BYTES + 1)
    except OSError as error:
        raise ReadError(file, error.strerror or str(error)) from None
    if len(data) > MAX_BYTES:
        raise ReadError(file, f'is larger than {MAX_BYTES >> 20} MiB')
    content = _of(json.loads(data, parse_constant=_refuse), dict)
    if content['schema'] != SCHEMA:
        raise ReadError(file, f'is of schema {content["schema"]}, not {SCHEMA}')
    for digest, text in _of(content['texts'], dict).items():
        if hashlib.sha256(text.encode()).hexdigest() != digest:
            raise ValueError(f'text {digest[:12]} is not what it was')
    return content


def _recorded(
    folder: Path, name: str, config: EvaluationConfig, run: Mapping[str, Any], whole: bool
) -> RecordedRun:
    inputs = [_of(run[key], dict) for key in INPUTS]
    if run['causal'] is not None:
        inputs.append(_of(run['causal'], dict))
    gates, values = [], None
    if run['result'] is not None:
        result = _of(run['result'], dict)
        gates = _of(result['gates'], list)
        values = dict(_flat(_compared(result, whole)))
        if not all(_of(one['files'], list) for one in inputs[:2]):
            raise ValueError('a result is of no file')
    return RecordedRun(
        name,
        tuple(str(folder / _of(one['spec'], str)) for one in inputs),
        None if run['times'] is None else folder / _of(run['times'], str),
        config,
        tuple(_gate(_of(gate, dict)) for gate in gates),
        _files(folder, [file for one in inputs for file in _of(one['files'], list)]),
        values,
        whole,
    )


def _compared(result: Mapping[str, Any], whole: bool) -> dict[str, Any]:
    """Return what is compared of a result, all of which must be there."""
    parts = {part: result[part] for part in COMPARED}
    inputs = _of(parts['inputs'], dict)
    full = {name: parts[name] for name in FULL} | {name: inputs[name] for name in INPUTS}
    for name, part in full.items():
        if not _of(part, dict):
            raise ValueError(f'a result has no {name}')
    if whole:  # other versions may put it otherwise
        parts['warnings'] = [_without_folder(text) for text in _of(result['warnings'], list)]
    return parts


def _without_folder(warning: str) -> str:
    """Return a warning with the name of the file that it begins with, in place of its path."""
    path, colon, text = warning.partition(': ')
    return path.rpartition('/')[2] + colon + text


def _scored_again(run: RecordedRun) -> tuple[Result | None, list[str]]:
    """Return the result of a run if there is one, and what is other than it was."""
    differences = list(_changed(run.files))
    if not all(map(_is_there, run.files)):
        return None, differences
    try:
        _check_paths(run)
        result = _score_apart(run) if run.values is None else _score(run)
    except (VioEvalError, OSError) as error:
        if run.values is None:
            return None, differences
        return None, [*differences, f'cannot be scored any more: {error}']
    if result is None or run.values is None:
        return result, differences if result is None else [*differences, 'can be scored now']
    now = _compared(result.to_dict(), run.whole)
    return result, [*differences, *_others(run.values, now, run.whole)]


def _others(values: Mapping[str, Any], content: Mapping[str, Any], whole: bool) -> Iterator[str]:
    """
    Yield which of the values, by dotted names, are others in what there is now.

    :param whole: whether there should be no more now than there was.
    """
    # as it is after a round trip through JSON
    now = dict(_flat(json.loads(json.dumps(content))))
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
            raise ReadError(path, 'there is no such file')  # nor is a device one, or a pipe


def _score_apart(run: RecordedRun) -> Result | None:
    """Return the result of a run in a process of its own, which it may take down."""
    truth, estimate, *causal = run.specs
    again = Run(run.name, estimate, causal=causal[0] if causal else None)
    sequence = Sequence(run.name, (again,), truth, run.config, (), times=run.times)
    return score_suite(Suite(Path(), (sequence,)), 1).sequences[0].runs[0].result


def _score(run: RecordedRun) -> Result:
    truth, estimate, *causal = read_sources(run.specs, None, run.times)
    if causal:
        estimate = estimate.revising(causal[0])
    check_names(run.gates, metric_names(run.config) if run.gates else ())
    return score_run(estimate, truth, run.config, run.gates)


def _changed(files: Mapping[Path, str | None]) -> Iterator[str]:
    """Yield which files are not what they were."""
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
    return f'{text} ({now - was:+.2g}, {share:.2g} of it)' if share else text


def _share(was: Any, now: Any) -> float:
    """Return by how much of the larger of two numbers they differ; 0 of what is no number."""
    if isinstance(was, bool) or isinstance(now, bool):
        return 0.0
    try:
        share = abs(now - was) / max(abs(now), abs(was))
    except (TypeError, OverflowError):
        return 0.0
    return share if math.isfinite(share) else 0.0


def _files(folder: Path, listed: Iterable[Any]) -> dict[Path, str | None]:
    return {folder / _of(one['path'], str): one['sha256'] for one in listed}


def _gate(gate: Mapping[str, Any]) -> Gate:
    limit, severity = gate['limit'], gate['severity']
    if gate['comparison'] not in LIMITS.values() or severity not in SEVERITIES:
        raise ValueError('a gate compares otherwise than <= and >=')
    return Gate(_of(gate['metric'], str), gate['comparison'], float(limit), severity)


def _flat(value: Any, name: str = '') -> Iterator[tuple[str, Any]]:
    """Yield each value in nested mappings and lists, by its dotted name."""
    if isinstance(value, (dict, list)):
        items = value.items() if isinstance(value, dict) else enumerate(value)
        for key, item in items:
            yield from _flat(item, f'{name}.{key}' if name else str(key))
    else:
        yield name, value


def _of(value: Any, kind: type[Kind]) -> Kind:
    """Return a value that must be of a kind."""
    if not isinstance(value, kind):
        raise TypeError(f'{kind.__name__} expected, not {type(value).__name__}')
    return value


def _refuse(constant: str) -> NoReturn:
    raise ValueError(f'{constant} is no number of JSON')
