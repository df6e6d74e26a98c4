"""Reads a manifest, and checks that it is whole: it may come from anywhere."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
import hashlib
import json
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple, NoReturn, TypeVar

from vio_eval_ros.comparison.repeated import Rule
from vio_eval_ros.core.config import EvaluationConfig
from vio_eval_ros.core.gates import Gate, LIMITS, SEVERITIES
from vio_eval_ros.core.orientations import LARGEST_NUMBER
from vio_eval_ros.errors import ConfigError, ReadError
from vio_eval_ros.evaluation.result import Result
from vio_eval_ros.scoring.baseline import damage
from vio_eval_ros.scoring.criteria import rule_of
from vio_eval_ros.scoring.manifest import MAX_BYTES, SCHEMA
from vio_eval_ros.scoring.results import RunResult, SequenceResult
from vio_eval_ros.scoring.suite import DEFAULT_GATES, OVER, RunsGate, RunSpec, Sequence
from vio_eval_ros.settings import finite
from vio_eval_ros.version import __version__

#: parts of a result that are compared; the others say how it was made, or have paths in them
COMPARED = ('config', 'inputs', 'verdict', 'gates', 'metrics', 'association', 'alignment')
#: parts of a sequence that are compared: what its runs were judged by together
JUDGED = ('gates', 'comparisons', 'verdict')
#: parts of a result that are never empty
FULL = ('config', 'metrics', 'association', 'alignment')
INPUTS = ('ground_truth', 'estimate')
VERDICTS = ('pass', 'fail')
#: what reading something else than a manifest raises
DAMAGED = (
    ValueError, KeyError, TypeError, AttributeError, OverflowError, RecursionError, ConfigError,
)  # fmt: skip
Kind = TypeVar('Kind')


class RecordedRun(NamedTuple):
    """
    A run of a manifest.

    :param specs: of the ground truth, the estimate and, where it was revised, the estimate as
        first published.
    :param files: path and sha256 of the inputs.
    :param values: the result, by dotted names; None where it could not be scored.
    :param error: why it could not.
    :param whole: whether the manifest is of this version, and so has all that a result has now.
    """

    name: str
    specs: tuple[str, ...]
    times: Path | None
    config: EvaluationConfig
    gates: tuple[Gate, ...]
    files: Mapping[Path, str | None]
    values: Mapping[str, Any] | None
    error: str
    whole: bool


class RecordedSequence(NamedTuple):
    """
    A sequence of a manifest.

    :param documents: path and sha256 of configuration and calibration.
    :param gates: over all runs.
    :param rules: with the values of the baseline; None where there was no baseline.
    :param judged: the outcome of gates and rules, by dotted names; empty where runs were not
        judged together.
    """

    name: str
    runs: tuple[RecordedRun, ...]
    config: EvaluationConfig
    documents: Mapping[Path, str | None]
    gates: tuple[RunsGate, ...] = ()
    rules: tuple[tuple[Rule, tuple[float, ...]], ...] | None = None
    judged: Mapping[str, Any] = MappingProxyType({})

    def judge(self, results: Iterable[Result | None]) -> SequenceResult:
        """Return the verdict on the runs together, given the result of each."""
        runs = [RunResult(RunSpec('', ''), result) for result in results]
        sequence = Sequence(self.name, (), '', self.config, self.gates)
        alone = SequenceResult(sequence, runs)
        if self.rules is None:
            return alone
        comparisons = [alone.compared(rule, baseline) for rule, baseline in self.rules]
        return SequenceResult(sequence, runs, comparisons)


@dataclass(frozen=True)
class RecordedManifest:
    """
    What a manifest has.

    :param tools: versions of this tool, Python and numpy, and the machine.
    :param documents: path and sha256 of the suite and the baseline.
    :param verdict: on all sequences; None where runs were not judged together.
    """

    tools: Mapping[str, Any]
    documents: Mapping[Path, str | None]
    sequences: tuple[RecordedSequence, ...]
    verdict: str | None

    @property
    def runs(self) -> list[RecordedRun]:
        """The runs of all sequences."""
        return [run for one in self.sequences for run in one.runs]


def load_manifest(file: Path) -> RecordedManifest:
    """
    Read a manifest.

    :raises ReadError: it is not a manifest, or is damaged.
    """
    try:
        return _manifest(file.parent, _parsed(file))
    except DAMAGED as error:
        raise ReadError(file, f'is not a manifest, or is damaged ({damage(error)})') from None


def _manifest(folder: Path, content: Mapping[str, Any]) -> RecordedManifest:
    tool = _of(content['tool'], dict)['version']
    is_judged = 'suite' in content or 'verdict' in content
    if is_judged and content['verdict'] not in VERDICTS:
        raise ValueError('a verdict is neither pass nor fail')
    documents = [content[name] for name in ('suite', 'baseline') if name in content]
    return RecordedManifest(
        tools={**_of(content['machine'], dict), 'vio_eval_ros': tool},
        documents=_files(folder, documents),
        sequences=tuple(
            _sequence(folder, _of(one, dict), is_judged, tool == __version__)
            for one in _of(content['sequences'], list)
        ),
        verdict=content.get('verdict'),
    )


def _sequence(
    folder: Path, content: Mapping[str, Any], is_judged: bool, whole: bool
) -> RecordedSequence:
    documents = [*_of(content['stack'], dict)['config'], *_of(content['calibration'], list)]
    config = EvaluationConfig.from_mapping(_of(content['options'], dict))
    name = _of(content['name'], str)
    sequence = RecordedSequence(
        name=name,
        runs=tuple(
            _run(folder, name, config, _of(run, dict), whole) for run in _of(content['runs'], list)
        ),
        config=config,
        documents=_files(folder, documents),
    )
    return _judged(sequence, content) if is_judged else sequence


def _judged(sequence: RecordedSequence, content: Mapping[str, Any]) -> RecordedSequence:
    """Return a sequence with the gates and comparisons by which its runs were judged together."""
    if not sequence.runs:
        raise ValueError('a sequence was judged without runs')
    if content['verdict'] not in VERDICTS:
        raise ValueError('a verdict is neither pass nor fail')
    gates = tuple(_runs_gate(_of(gate, dict)) for gate in _of(content['gates'], list))
    if not {gate.metric for gate in DEFAULT_GATES} <= {runs.gate.metric for runs in gates}:
        raise ValueError('a sequence was judged without the mandatory gates')
    compared = content['comparisons']
    return sequence._replace(
        gates=gates,
        rules=None if compared is None else tuple(_rule(_of(one, dict)) for one in compared),
        judged=dict(flat({part: content[part] for part in JUDGED})),
    )


def _runs_gate(gate: Mapping[str, Any]) -> RunsGate:
    if gate['of'] not in OVER:
        raise ValueError(f"the 'of' of a gate is neither {' nor '.join(OVER)}")
    return RunsGate(_gate(gate), gate['of'])


def _rule(comparison: Mapping[str, Any]) -> tuple[Rule, tuple[float, ...]]:
    """Return a rule, and the values of the baseline."""
    limits = dict(_of(comparison['rule'], dict))
    limits.setdefault('p_adjusted', 1.0)  # as long as there was none
    values = tuple(finite(value) for value in _of(comparison['baseline_values'], list))
    if not all(abs(value) < LARGEST_NUMBER for value in values):
        raise ValueError('a baseline has invalid values')
    return rule_of(_of(limits.pop('metric'), str), limits), values


def _parsed(file: Path) -> dict[str, Any]:
    """Return the content of a manifest, whose schema and texts were checked."""
    try:
        with file.open('rb') as stream:
            data = stream.read(MAX_BYTES + 1)
    except OSError as error:
        raise ReadError(file, error.strerror or str(error)) from None
    if len(data) > MAX_BYTES:
        raise ReadError(file, f'is larger than {MAX_BYTES >> 20} MiB')
    content = _of(json.loads(data, parse_constant=_refuse), dict)
    if content['schema'] != SCHEMA:
        raise ReadError(file, f'has the schema {content["schema"]}, not {SCHEMA}')
    for digest, text in _of(content['texts'], dict).items():
        if hashlib.sha256(text.encode()).hexdigest() != digest:
            raise ValueError(f'text {digest[:12]} has changed')
    return content


def _run(
    folder: Path, sequence: str, config: EvaluationConfig, run: Mapping[str, Any], whole: bool
) -> RecordedRun:
    inputs = [_of(run[key], dict) for key in INPUTS]
    name = f'{sequence}, {_of(run["estimate"]["spec"], str)}'
    if run['causal'] is not None:
        inputs.append(_of(run['causal'], dict))
    gates, values, error = [], None, ''
    if run['result'] is None:
        error = _of(run['error'], str)
    else:
        result = _of(run['result'], dict)
        gates = _of(result['gates'], list)
        values = dict(flat(compared_parts(result, whole)))
        if not all(_of(one['files'], list) for one in inputs[:2]):
            raise ValueError('a result has no files')
    return RecordedRun(
        name=name,
        specs=tuple(str(folder / _of(one['spec'], str)) for one in inputs),
        times=None if run['times'] is None else folder / _of(run['times'], str),
        config=config,
        gates=tuple(_gate(_of(gate, dict)) for gate in gates),
        files=_files(folder, [file for one in inputs for file in _of(one['files'], list)]),
        values=values,
        error=error,
        whole=whole,
    )


def compared_parts(result: Mapping[str, Any], whole: bool) -> dict[str, Any]:
    """Return the parts of a result that are compared, all of which must be there."""
    parts = {part: result[part] for part in COMPARED}
    inputs = _of(parts['inputs'], dict)
    full = {name: parts[name] for name in FULL} | {name: inputs[name] for name in INPUTS}
    for name, part in full.items():
        if not _of(part, dict):
            raise ValueError(f'a result has no {name}')
    if whole:  # other versions may word warnings differently
        parts['warnings'] = [_without_folder(text) for text in _of(result['warnings'], list)]
    return parts


def _without_folder(warning: str) -> str:
    """Return a warning whose leading path is reduced to the name of the file."""
    path, colon, text = warning.partition(': ')
    return path.rpartition('/')[2] + colon + text


def _files(folder: Path, listed: Iterable[Any]) -> dict[Path, str | None]:
    return {folder / _of(one['path'], str): one['sha256'] for one in listed}


def _gate(gate: Mapping[str, Any]) -> Gate:
    limit, severity = gate['limit'], gate['severity']
    if gate['comparison'] not in LIMITS.values() or severity not in SEVERITIES:
        raise ValueError('a gate has an unknown comparison or severity')
    return Gate(_of(gate['metric'], str), gate['comparison'], float(limit), severity)


def flat(value: Any, name: str = '') -> Iterator[tuple[str, Any]]:
    """Yield each value in nested mappings and lists, by its dotted name."""
    if isinstance(value, (dict, list)):
        items = value.items() if isinstance(value, dict) else enumerate(value)
        for key, item in items:
            yield from flat(item, f'{name}.{key}' if name else str(key))
    else:
        yield name, value


def _of(value: Any, kind: type[Kind]) -> Kind:
    """Return a value whose type is checked."""
    if not isinstance(value, kind):
        raise TypeError(f'{kind.__name__} expected, not {type(value).__name__}')
    return value


def _refuse(constant: str) -> NoReturn:
    raise ValueError(f'{constant} is not a JSON number')
