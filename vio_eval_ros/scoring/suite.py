"""
A suite: which runs of which sequences are scored, with which options, against which gates.

::

    options: {alignment: se3, max_difference_s: 0.01}
    gates: {ate_trans_rmse_m: {max: 0.3, warn: 0.2}, success_rate: {min: 1.0}}
    sequences:
      - name: V1_02
        estimate: runs/V1_02/*.tum          # a glob is one run a match
        ground_truth: gt/V1_02.csv
        gates: {ate_trans_rmse_m: {max: 0.1}}

Paths are relative to the suite's file. A sequence's options, gates, rules and tags go over those
of the suite, name by name.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from glob import glob, has_magic
from pathlib import Path
import re
from typing import Any

from vio_eval_ros.core.config import EvaluationConfig, nearest_name
from vio_eval_ros.core.evaluation import metric_names
from vio_eval_ros.core.gates import Gate
from vio_eval_ros.errors import ConfigError
from vio_eval_ros.scoring.baseline import Rule
from vio_eval_ros.settings import load_yaml, Section

SHARED_KEYS = ('options', 'gates', 'compare', 'bands', 'modality', 'tags', 'stack', 'calibration')
SEQUENCE_KEYS = ('name', 'estimate', 'causal', 'ground_truth', 'recording', *SHARED_KEYS)
SUCCESS_RATE = 'success_rate'
#: what keeps a lost track from winning; a suite may set other limits, but not do without
DEFAULT_GATES = (
    Gate('coverage_ratio', '>=', 0.9),
    Gate('ate_extent_ratio', '<=', 0.5),
    Gate(SUCCESS_RATE, '>=', 1.0),
)
OVER = ('median', 'worst')
MODALITIES = ('mono', 'stereo', 'mono-inertial', 'stereo-inertial')
BAND_LIMITS = ('good', 'plausible', 'failed')


@dataclass(frozen=True)
class RunsGate:
    """
    A gate on a metric over repeated runs.

    :param over: ``median``, or ``worst`` of them.
    """

    gate: Gate
    over: str = 'median'


@dataclass(frozen=True)
class Run:
    """
    One run of a sequence.

    :param name: its estimate as the suite names it, the match in place of the glob.
    :param estimate: spec of the estimate.
    :param recording: where topics without a recording of their own are, if anywhere.
    :param causal: spec of the same run as first published, if there is one.
    """

    name: str
    estimate: str
    recording: Path | None = None
    causal: str | None = None


@dataclass(frozen=True)
class Sequence:
    """
    The runs of one sequence, and what is asked of them.

    :param ground_truth: spec of the ground truth.
    :param rules: when a metric is worse than the baseline's.
    :param band: limits of what the literature has reached: good, plausible, failed [m].
    :param files: of the stack and its calibration, for the manifest, see there.
    """

    name: str
    runs: tuple[Run, ...]
    ground_truth: str
    config: EvaluationConfig
    gates: tuple[RunsGate, ...]
    rules: tuple[Rule, ...]
    band: Mapping[str, float] | None
    modality: str | None
    tags: tuple[str, ...]
    stack: Mapping[str, Any]
    calibration: tuple[Path, ...]

    @property
    def success_gates(self) -> tuple[Gate, ...]:
        """What a single run must keep to be a success: not diverged, and covering enough."""
        wanted = {gate.metric for gate in DEFAULT_GATES} - {SUCCESS_RATE}
        return tuple(
            runs.gate
            for runs in self.gates
            if runs.gate.metric in wanted and runs.gate.severity == 'fail'
        )


@dataclass(frozen=True)
class Suite:
    """All sequences of a file."""

    file: Path
    sequences: tuple[Sequence, ...]
    manifest: Path | None = None

    @classmethod
    def load(cls, file: Path, overrides: Iterable[str] = ()) -> Suite:
        """
        Read a suite.

        :param overrides: ``key.key=value`` each; ``sequences.NAME.key`` reaches into a sequence.
        :raises ConfigError: what is wrong in it, with its line; also a glob without a match.
        """
        top = load_yaml(file)
        for text in overrides:
            _override(top, text)
        top.expect('sequences', 'manifest', *SHARED_KEYS)
        listed = top.get('sequences')
        if not isinstance(listed, list) or not listed:
            raise top.error('sequences', 'sequences: a list with at least one is expected')
        sequences = tuple(_sequence(top, one) for one in listed)
        seen: set[str] = set()
        for sequence, one in zip(sequences, listed, strict=True):
            if sequence.name in seen:
                raise one.error('name', f"there are two sequences '{sequence.name}'")
            seen.add(sequence.name)
        manifest = _text(top, 'manifest')
        return cls(file, sequences, None if manifest is None else file.parent / manifest)

    def tagged(self, tags: Iterable[str]) -> Suite:
        """Return the suite with the sequences that have one of these tags."""
        wanted = set(tags)
        known = {tag for sequence in self.sequences for tag in sequence.tags}
        for tag in wanted - known:
            raise ConfigError(f"no sequence has the tag '{tag}'{nearest_name(tag, known)}")
        chosen = tuple(one for one in self.sequences if wanted & set(one.tags))
        return Suite(self.file, chosen, self.manifest)


def _sequence(top: Section, one: Any) -> Sequence:
    if not isinstance(one, Section):
        raise top.error('sequences', 'sequences: each is a mapping with name, estimate, ...')
    one.expect(*SEQUENCE_KEYS)
    name = _text(one, 'name')
    if not name:
        raise ConfigError(f'{top.file}: a sequence has no name')
    truth = _text(one, 'ground_truth')
    if not truth:
        raise one.error('name', f'{name}: there is no ground_truth')
    base = top.file.parent
    config = _config(top, one)
    runs = tuple(_runs(one, base))
    modality = _text(one, 'modality') or _text(top, 'modality')
    return Sequence(
        name,
        runs,
        truth if runs[0].recording and truth.startswith('/') else _spec(base, truth),
        config,
        _gates(top, one, config),
        _rules(top, one, config),
        _band(top, one, name, modality),
        modality,
        tuple(_texts(one, 'tags') or _texts(top, 'tags')),
        {**top.section('stack'), **one.section('stack')},
        tuple(base / path for path in _texts(one, 'calibration') or _texts(top, 'calibration')),
    )


def _text(section: Section, key: str) -> str | None:
    value = section.get(key)
    if value is not None and not isinstance(value, str):
        raise section.error(key, f'{key}: a text is expected')
    return value


def _texts(section: Section, key: str) -> list[str]:
    value = section.get(key) or []
    texts = [value] if isinstance(value, str) else value
    if not isinstance(texts, list) or not all(isinstance(text, str) for text in texts):
        raise section.error(key, f'{key}: a list of texts is expected')
    return texts


def _config(top: Section, one: Section) -> EvaluationConfig:
    options = {**top.section('options'), **one.section('options')}
    try:
        return EvaluationConfig.from_mapping(options)
    except ConfigError as error:
        for section in (one.section('options'), top.section('options')):
            for key in section:
                if re.search(rf'\b{re.escape(key)}\b', str(error)):
                    raise section.error(key, error) from None
        raise ConfigError(f'{top.file}: {error}') from None


def _gates(top: Section, one: Section, config: EvaluationConfig) -> tuple[RunsGate, ...]:
    """Return the gates: the defaults, over them those of the suite, over them the sequence's."""
    known = [*metric_names(config), SUCCESS_RATE]
    gates = {gate.metric: [RunsGate(gate)] for gate in DEFAULT_GATES}
    for section in (top.section('gates'), one.section('gates')):
        for metric, bounds in section.items():
            if metric not in known:
                hint = nearest_name(metric, known)
                raise section.error(metric, f"there is no metric '{metric}'{hint}")
            gates[metric] = list(_gates_of(section, metric, bounds))
    return tuple(gate for of_metric in gates.values() for gate in of_metric)


def _gates_of(section: Section, metric: str, bounds: Any) -> Iterable[RunsGate]:
    for each in bounds if isinstance(bounds, list) else [bounds]:
        limits = dict(each) if isinstance(each, Mapping) else each
        over = limits.pop('of', 'median') if isinstance(limits, dict) else 'median'
        if over not in OVER:
            raise section.error(metric, f'gate {metric}: of is {" or ".join(OVER)}')
        try:
            yield from (RunsGate(gate, over) for gate in Gate.of(metric, limits))
        except ConfigError as error:
            raise section.error(metric, error) from None


def _rules(top: Section, one: Section, config: EvaluationConfig) -> tuple[Rule, ...]:
    """Return when a metric is worse than the baseline's; by default, when the ATE is."""
    known = metric_names(config)
    rules = {rule.metric: rule for rule in [Rule('ate_trans_rmse_m')]}
    for section in (top.section('compare'), one.section('compare')):
        for metric, limits in section.items():
            if metric not in known:
                hint = nearest_name(metric, known)
                raise section.error(metric, f"there is no metric '{metric}'{hint}")
            try:
                rules[metric] = Rule.of(metric, limits)
            except ConfigError as error:
                raise section.error(metric, error) from None
    return tuple(rules.values())


def _band(
    top: Section, one: Section, name: str, modality: str | None
) -> Mapping[str, float] | None:
    """Return the limits of what is good, plausible and failed, of the sequence and modality."""
    if modality is not None and modality not in MODALITIES:
        section = one if 'modality' in one else top
        raise section.error('modality', f'modality is one of {", ".join(MODALITIES)}')
    section = one if 'bands' in one else top
    file = _text(section, 'bands')
    if file is None:
        return None
    bands = load_yaml(top.file.parent / file)
    if name not in bands:
        if section is one:
            raise section.error('bands', f"{file} has no sequence '{name}'")
        return None
    band = bands.section(name)
    if modality is not None and modality in band:
        band = band.section(modality)
    band.expect(*BAND_LIMITS, *MODALITIES)
    limits = [band.get(limit) for limit in BAND_LIMITS]
    numbers = [limit for limit in limits if isinstance(limit, (int, float))]
    if len(numbers) < len(limits) or sorted(numbers) != limits:
        raise bands.error(name, f'{name}: good, plausible and failed are rising numbers')
    return dict(zip(BAND_LIMITS, numbers, strict=True))


def _runs(one: Section, base: Path) -> Iterable[Run]:
    """Yield a run for each match of the estimate, or of the recording that it is in."""
    estimate, recording = _text(one, 'estimate'), _text(one, 'recording')
    if estimate is None:
        raise one.error('name', f'{one["name"]}: there is no estimate')
    causal = _matches(one, 'causal', base) if 'causal' in one else None
    if recording is not None and estimate.startswith('/'):
        found = [
            Run(f'{shown}:{estimate}', estimate, Path(path))
            for shown, path in _matches(one, 'recording', base)
        ]
    else:
        where = None if recording is None else base / recording
        found = [Run(shown, spec, where) for shown, spec in _matches(one, 'estimate', base)]
    if causal is None:
        yield from found
    elif len(causal) != len(found):
        raise one.error('causal', f'causal: {len(causal)} matches for {len(found)} runs')
    else:
        for run, (_, spec) in zip(found, causal, strict=True):
            yield Run(run.name, run.estimate, run.recording, spec)


def _matches(one: Section, key: str, base: Path) -> list[tuple[str, str]]:
    """Return how the suite would name each match of a glob, and its spec."""
    text = str(one[key])
    pattern, rest = _split(text)
    if not has_magic(pattern) or (base / pattern).exists():
        return [(text, _spec(base, text))]
    found = sorted(glob(pattern, root_dir=base, recursive=True))
    if not found:
        raise one.error(key, f"{key}: nothing matches '{pattern}' in {base}")
    return [(match + rest, str(base / match) + rest) for match in found]


def _spec(base: Path, text: str) -> str:
    """Return a source spec whose path does not depend on where the tool is started."""
    path, rest = _split(text)
    return str(base / path) + rest


def _split(text: str) -> tuple[str, str]:
    """Return the path of a spec, and the topic or statement behind it."""
    match = re.search(r':/|\?(?=[a-z]+=)', text)
    return (text, '') if match is None else (text[: match.start()], text[match.start() :])


def _override(top: Section, text: str) -> None:
    """Set one value of a suite; ``sequences.NAME.key`` reaches into a sequence."""
    import yaml

    name, equals, given = text.partition('=')
    keys = name.split('.')
    try:
        value = yaml.safe_load(given)
    except yaml.YAMLError:
        value = None
    if not equals or not all(keys) or isinstance(value, (dict, list)) is None:
        raise ConfigError(f"--set '{text}': write KEY=VALUE, such as options.alignment=sim3")
    section: Any = top
    for position, key in enumerate(keys[:-1]):
        if isinstance(section, list):
            named = [one for one in section if isinstance(one, Section) and one.get('name') == key]
            if not named:
                raise ConfigError(f"--set '{text}': there is no sequence '{key}'")
            section = named[0]
        elif isinstance(section, Section):
            section = section.setdefault(key, Section(top.file))
        if not isinstance(section, (Section, list)):
            raise ConfigError(f"--set '{text}': {'.'.join(keys[: position + 1])} is no mapping")
    if not isinstance(section, Section):
        raise ConfigError(f"--set '{text}': say which sequence, as in sequences.NAME.KEY=VALUE")
    section[keys[-1]] = _located(top.file, value)


def _located(file: Path, value: Any) -> Any:
    """Return a value as a file would have given it."""
    if isinstance(value, list):
        return [_located(file, item) for item in value]
    if not isinstance(value, dict):
        return value
    section = Section(file)
    section.update({str(key): _located(file, item) for key, item in value.items()})
    return section
