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

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from glob import glob, has_magic
import math
from pathlib import Path
import re
from typing import Any, NamedTuple

from vio_eval_ros.core.config import EvaluationConfig, nearest_name
from vio_eval_ros.core.evaluation import metric_names
from vio_eval_ros.core.gates import Gate
from vio_eval_ros.errors import ConfigError, ReadError
from vio_eval_ros.evaluation.result import SUCCESS_GATES
from vio_eval_ros.recordings.spec import Spec
from vio_eval_ros.scoring.baseline import Recorded, Rule
from vio_eval_ros.scoring.manifest import check_stack, config_paths
from vio_eval_ros.settings import finite, load_yaml, parse_yaml, Section

SHARED_KEYS = ('options', 'gates', 'compare', 'bands', 'modality', 'tags', 'stack', 'calibration')
SEQUENCE_KEYS = (
    'name', 'estimate', 'causal', 'ground_truth', 'recording', 'times', *SHARED_KEYS,
)  # fmt: skip
SUCCESS_RATE = 'success_rate'
#: what keeps a lost track from winning; a suite may set other limits, but not leave them out
DEFAULT_GATES = (*SUCCESS_GATES, Gate(SUCCESS_RATE, '>=', 1.0))
#: of which there is no more than all
SHARES = ('coverage_ratio', 'matched_ratio', SUCCESS_RATE)
OVER = ('median', 'worst')
GATE_KEYS = ('max', 'min', 'warn', 'of')
MODALITIES = ('mono', 'stereo', 'mono-inertial', 'stereo-inertial')
BAND_LIMITS = ('good', 'plausible', 'failed')
WILDCARD = re.compile(r'\*\*/?|\*|\?|\[!?.[^]]*\]')
WILD = {'**/': '((?:.*/)?)', '**': '(.*)', '*': '([^/]*)'}


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
    :param band: limits of what the literature has reached: good, plausible, failed [m]; None
        where nothing is known of such sensors.
    :param bands: the file that has them.
    :param stack: what made the estimates, and ``calibration`` with what, for the manifest.
    :param times: the stamps of KITTI poses.
    """

    name: str
    runs: tuple[Run, ...]
    ground_truth: str
    config: EvaluationConfig
    gates: tuple[RunsGate, ...]
    rules: tuple[Rule, ...] = ()
    band: Mapping[str, float] | None = None
    modality: str | None = None
    tags: tuple[str, ...] = ()
    stack: Mapping[str, Any] = field(default_factory=dict)
    calibration: tuple[Path, ...] = ()
    times: Path | None = None
    bands: Path | None = None

    @property
    def paths(self) -> Iterator[Path]:
        """The files and folders that the runs are read from."""
        for run in self.runs:
            specs = (run.estimate, run.causal, self.ground_truth)
            found = [run.recording, *(Spec.parse(spec).path for spec in specs if spec is not None)]
            yield from (path for path in (*found, self.times) if path is not None)

    @property
    def conditions(self) -> Recorded:
        """What of a baseline is known before anything is scored."""
        spec = Spec.parse(self.ground_truth)
        stated = '&'.join(f'{name}={value}' for name, value in sorted(spec.statements.items()))
        truth = (spec.topic or '') + (f'?{stated}' if stated else '')
        return Recorded(self.config.to_dict(), ground_truth=truth)

    @property
    def truth_is_recorded(self) -> bool:
        """Whether each run brings a ground truth of its own, in its recording."""
        return Spec.parse(self.ground_truth).path is None

    @property
    def success_gates(self) -> tuple[Gate, ...]:
        """What a single run must keep to be a success: not diverged, and covering enough."""
        wanted = {gate.metric for gate in SUCCESS_GATES}
        return tuple(
            runs.gate
            for runs in self.gates
            if runs.gate.metric in wanted and runs.gate.severity == 'fail'
        )


@dataclass(frozen=True)
class Suite:
    """
    All sequences of a file.

    :param overrides: what was set from outside, ``key.key=value`` each.
    """

    file: Path
    sequences: tuple[Sequence, ...]
    manifest: Path | None = None
    overrides: tuple[str, ...] = ()

    @classmethod
    def load(cls, file: Path, overrides: Iterable[str] = (), tags: Iterable[str] = ()) -> Suite:
        """
        Read a suite.

        :param overrides: ``key.key=value`` each; ``sequences.NAME.key`` reaches into a sequence.
        :param tags: only sequences with such a tag, or name, are looked at; all where none is
            given.
        :raises ConfigError: what is wrong in it, with its line; also a glob without a match.
        """
        top, overrides = load_yaml(file), tuple(overrides)
        for text in overrides:
            _override(top, text)
        top.expect('sequences', 'manifest', *SHARED_KEYS)
        listed = top.get('sequences')
        if not isinstance(listed, list) or not listed:
            raise top.error('sequences', 'sequences: a list with at least one is expected')
        named: dict[str, Section] = {}
        for one in listed:
            if not isinstance(one, Section):
                raise top.error('sequences', 'sequences: each is a mapping with name, estimate...')
            one.expect(*SEQUENCE_KEYS)
            name = _required(one, 'name')
            if name in named:
                raise one.error('name', f"there are two sequences '{name}'")
            named[name] = one
        chosen = _tagged(top, named, set(tags)) if tags else named.values()
        manifest = _text(top, 'manifest')
        return cls(
            file,
            tuple(_sequence(top, one) for one in chosen),
            None if manifest is None else file.parent / manifest,
            overrides,
        )

    @property
    def paths(self) -> Iterable[Path]:
        """The files and folders that are read."""
        found = dict.fromkeys(path for sequence in self.sequences for path in sequence.paths)
        for one in self.sequences:
            config = config_paths(one.stack, self.file.parent)
            documents = (one.bands, *one.calibration, *config)
            found |= dict.fromkeys(path for path in documents if path is not None)
        return found


def _tagged(top: Section, named: Mapping[str, Section], wanted: set[str]) -> list[Section]:
    """Return the sequences that have one of these tags; their name is one of them."""
    tags = {name: {name, *_tags(top, one)} for name, one in named.items()}
    known = set().union(*tags.values())
    for tag in sorted(wanted - known):
        raise ConfigError(f"no sequence has the tag '{tag}'{nearest_name(tag, known)}")
    return [one for name, one in named.items() if wanted & tags[name]]


def _tags(top: Section, one: Section) -> list[str]:
    return _texts(one, 'tags') or _texts(top, 'tags')


def _sequence(top: Section, one: Section) -> Sequence:
    name, base = _required(one, 'name'), top.file.parent
    config = _config(top, one)
    runs = tuple(_runs(one, base))
    truth, *others = _matches(one, 'ground_truth', base)
    if others:
        raise one.error('ground_truth', f'ground_truth: one is expected, not {1 + len(others)}')
    path = Path(_split(truth.spec)[0])
    if not truth.is_topic and not path.exists():
        raise one.error('ground_truth', f'ground_truth: there is no {path}')
    topics = [truth.is_topic, *(Spec.parse(run.estimate).path is None for run in runs)]
    if one.get('recording') is not None and not any(topics):
        raise one.error('recording', 'recording: nothing is read of it, no topic is named')
    modality = _text(one, 'modality') or _text(top, 'modality')
    bands = _text(one, 'bands') or _text(top, 'bands')
    times = _text(one, 'times')
    return Sequence(
        name,
        runs,
        truth.spec,
        config,
        _gates(top, one, config),
        _rules(top, one, config),
        _band(top, one, name, modality),
        modality,
        tuple(_tags(top, one)),
        _stack(top, one),
        tuple(base / path for path in _texts(one, 'calibration') or _texts(top, 'calibration')),
        None if times is None else base / times,
        None if bands is None else base / bands,
    )


def _required(section: Section, key: str) -> str:
    text = _text(section, key)
    if not text:
        raise section.error(key, f'a sequence needs its {key}')
    return text


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
    sections = (top.section('options'), one.section('options'))
    for section in sections:
        for key, value in section.items():
            try:
                EvaluationConfig.from_mapping({key: value})
            except ConfigError as error:
                raise section.error(key, error) from None
    try:
        return EvaluationConfig.from_mapping({**sections[0], **sections[1]})
    except ConfigError as error:  # each is right, but not beside the others
        raise one.error('options', error) from None


def _gates(top: Section, one: Section, config: EvaluationConfig) -> tuple[RunsGate, ...]:
    """Return the gates of the suite, over them those of the sequence; the defaults stay."""
    gates: dict[str, list[RunsGate]] = {gate.metric: [] for gate in DEFAULT_GATES}
    known = [*metric_names(config), SUCCESS_RATE]
    for section in (top.section('gates'), one.section('gates')):
        for metric, bounds in _of_metrics(section, known):
            gates[metric] = list(_gates_of(section, metric, bounds))
    for default in DEFAULT_GATES:
        stated = [runs.gate._replace(limit=default.limit) for runs in gates[default.metric]]
        if default not in stated:
            gates[default.metric].insert(0, RunsGate(default))
    return tuple(gate for of_metric in gates.values() for gate in of_metric)


def _of_metrics(section: Section, known: Iterable[str]) -> Iterable[tuple[str, Any]]:
    """Yield what is stated of each metric; one that is unknown is an error."""
    for metric, stated in section.items():
        if metric not in known:
            hint = nearest_name(metric, known)
            raise section.error(metric, f"there is no metric '{metric}' with these options{hint}")
        yield metric, stated


def _gates_of(section: Section, metric: str, bounds: Any) -> Iterable[RunsGate]:
    for each in bounds if isinstance(bounds, list) and bounds else [bounds]:
        limits, over = each, 'median'
        if isinstance(each, Section):
            each.expect(*GATE_KEYS)
            limits = {bound: limit for bound, limit in each.items() if bound != 'of'}
            over = each.get('of', over)
        if over not in OVER:
            raise section.error(metric, f'gate {metric}: of is {" or ".join(OVER)}')
        try:
            gates = Gate.of(metric, limits)
        except ConfigError as error:
            raise section.error(metric, error) from None
        least, most = (
            [gate.limit for gate in gates if gate.comparison == sign] for sign in ('>=', '<=')
        )
        if metric in SHARES:
            most.append(1.0)
        if least and most and max(least) > min(most):
            raise section.error(
                metric,
                f'gate {metric}: nothing is at least {max(least):g} and at most {min(most):g}',
            )
        yield from (RunsGate(gate, over) for gate in gates)


def _rules(top: Section, one: Section, config: EvaluationConfig) -> tuple[Rule, ...]:
    """Return when a metric is worse than the baseline's; by default, when the ATE is."""
    known = metric_names(config)
    rules = {rule.metric: rule for rule in [Rule('ate_trans_rmse_m')]}
    for section in (top.section('compare'), one.section('compare')):
        for metric, limits in _of_metrics(section, known):
            if isinstance(limits, Section):
                limits.expect(*Rule._fields[1:])
            try:
                rules[metric] = Rule.of(metric, limits)
            except ConfigError as error:
                raise section.error(metric, error) from None
    return tuple(rules.values())


def _stack(top: Section, one: Section) -> dict[str, Any]:
    """Return what is stated of the software under test; its files are read for manifests only."""
    sections = (top.section('stack'), one.section('stack'))
    for section in sections:
        for key, value in section.items():
            try:
                check_stack({key: value})
            except ConfigError as error:
                raise section.error(key, error) from None
    return {**sections[0], **sections[1]}


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
    path = top.file.parent / file
    if not path.is_file():
        raise section.error('bands', f'bands: there is no file {path}')
    bands = load_yaml(path)
    if name not in bands:
        if section is one:
            raise section.error('bands', f"{file} has no sequence '{name}'")
        return None
    band = bands.section(name)
    band.expect(*BAND_LIMITS, *MODALITIES)
    parts: dict[str | None, Section] = {}
    for key in MODALITIES:
        if key in band:
            parts[key] = band.section(key)
            parts[key].expect(*BAND_LIMITS)
    if not parts or any(limit in band for limit in BAND_LIMITS):
        parts[None] = band
    found = {
        key: [finite(part.get(limit)) for limit in BAND_LIMITS] for key, part in parts.items()
    }
    for limits in found.values():
        if any(map(math.isnan, limits)) or sorted(limits) != limits:
            raise bands.error(name, f'{name}: good, plausible and failed are rising numbers')
    return dict(zip(BAND_LIMITS, found[modality], strict=True)) if modality in found else None


def _runs(one: Section, base: Path) -> Iterator[Run]:
    """Yield a run for each match of the estimate, or of the recording that it is in."""
    keys = ['estimate', *(key for key in ('causal', 'recording') if one.get(key) is not None)]
    found = {key: _matches(one, key, base) for key in keys}
    count = max(map(len, found.values()))
    many = [key for key in keys if len(found[key]) == count > 1]
    for key, matches in found.items():
        if len(matches) == 1 and (key == 'recording' or matches[0].is_topic):
            found[key] = matches * count
        elif len(matches) < count:
            raise one.error(key, f'{key}: {len(matches)} matches for {count} runs')
    for key in many[1:]:
        found[key] = _paired(one, many[0], found[many[0]], key, found[key])
    for k in range(count):
        run = {key: matches[k] for key, matches in found.items()}
        name = run['estimate'].name
        yield Run(
            f'{run["recording"].name}:{name}' if run['estimate'].is_topic else name,
            run['estimate'].spec,
            Path(run['recording'].spec) if 'recording' in run else None,
            run['causal'].spec if 'causal' in run else None,
        )


class _Match(NamedTuple):
    """
    What an entry of a suite means, or one of those that it means.

    :param name: as the suite would name it.
    :param spec: which does not depend on where the tool is started.
    :param is_topic: of the recording beside it.
    :param wild: what its wildcards stand for.
    """

    name: str
    spec: str
    is_topic: bool = False
    wild: tuple[str, ...] = ()


def _paired(
    one: Section, key: str, matches: list[_Match], other_key: str, others: list[_Match]
) -> list[_Match]:
    """Return the other matches in the order of those whose wildcards stand for the same."""
    of_run = {match.wild: match for match in others}
    for match in matches:
        if match.wild not in of_run:
            raise one.error(
                other_key,
                f'{other_key}: none of its matches belongs to {match.name} of {key}: wildcards of '
                f"both must stand for the same, here '{' '.join(match.wild)}'",
            )
    return [of_run[match.wild] for match in matches]


def _matches(one: Section, key: str, base: Path) -> list[_Match]:
    text = _required(one, key)
    pattern, rest = _split(text)
    if '\0' in text:
        raise one.error(key, f'{key}: no path has a zero byte in it')
    if (base / pattern).exists():
        return [_Match(text, _checked(one, key, f'{base / pattern}{rest}'))]
    paths = sorted(glob(pattern, root_dir=base, recursive=True))
    if not paths and key != 'recording' and one.get('recording') and text.startswith('/'):
        return [_Match(text, _checked(one, key, text), True)]
    if not paths and has_magic(pattern):
        raise one.error(key, f"{key}: nothing matches '{pattern}' in {base}")
    return [
        _Match(path + rest, _checked(one, key, f'{base / path}{rest}'), wild=_wild(pattern, path))
        for path in paths or [pattern]
    ]


def _wild(pattern: str, path: str) -> tuple[str, ...]:
    """Return what the wildcards of a glob stand for in a path that it matches."""
    texts, wildcards = WILDCARD.split(pattern), WILDCARD.findall(pattern)
    groups = [WILD.get(wildcard, '([^/])') for wildcard in wildcards] + ['']
    regular = ''.join(map(''.join, zip(map(re.escape, texts), groups, strict=True)))
    found = re.fullmatch(regular, path, re.DOTALL)
    return found.groups() if found else (path,)


def _checked(one: Section, key: str, spec: str) -> str:
    """Return a source spec if what it states can be stated."""
    try:
        Spec.parse(spec)
    except ConfigError as error:
        raise one.error(key, error) from None
    return spec


def _split(text: str) -> tuple[str, str]:
    """Return the path of a spec, and the topic or statement behind it."""
    match = re.search(r':/|\?(?=[a-z]+=)', text)
    return (text, '') if match is None else (text[: match.start()], text[match.start() :])


def _override(top: Section, text: str) -> None:
    """Set one value of a suite; ``sequences.NAME.key`` reaches into a sequence."""
    name, equals, given = text.partition('=')
    place = f"--set '{text}'"
    if not equals or not all(name.split('.')):
        raise ConfigError(f'{place}: write KEY=VALUE, such as options.alignment=sim3')
    try:
        value = parse_yaml(given, top.file, place)
    except ReadError as error:
        raise ConfigError(f'{place}: {error.problem.removeprefix(place + ": ")}') from None
    section: Any = top
    while not isinstance(section, Section) or '.' in name:
        if isinstance(section, list):
            section, name = _named(section, name, place)
            continue
        key, _, name = name.partition('.')
        section.places[key] = place
        if section.get(key) is None:
            section[key] = Section(top.file, place)
        section = section[key]
        if not isinstance(section, (Section, list)):
            raise ConfigError(f'{place}: {key} is no mapping')
    section[name] = value
    section.places[name] = place


def _named(listed: list[Any], name: str, place: str) -> tuple[Section, str]:
    """Return the sequence that a dotted name begins with, and the rest of that name."""
    names = [str(one.get('name')) for one in listed if isinstance(one, Section)]
    for one in listed:
        if isinstance(one, Section) and name.startswith(f'{one.get("name")}.'):
            return one, name.removeprefix(f'{one.get("name")}.')
    raise ConfigError(
        f'{place}: write sequences.NAME.KEY=VALUE, with NAME one of {", ".join(names)}'
    )
