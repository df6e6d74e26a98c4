"""What a suite requires of the runs of a sequence: gates, rules against a baseline, bands."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
import math
from typing import Any

from vio_eval_ros.comparison.direction import worse_sign
from vio_eval_ros.comparison.repeated import Rule
from vio_eval_ros.core.config import EvaluationConfig, nearest_name
from vio_eval_ros.core.evaluation import metric_names
from vio_eval_ros.core.gates import Gate
from vio_eval_ros.errors import ConfigError
from vio_eval_ros.scoring.entries import Entry
from vio_eval_ros.scoring.suite import DEFAULT_GATES, OVER, RunsGate, SUCCESS_RATE
from vio_eval_ros.settings import finite, load_yaml, Section

GATE_KEYS = ('max', 'min', 'warn', 'of')
#: metrics that cannot exceed 1
SHARES = ('coverage_ratio', 'tracked_ratio', 'matched_ratio', SUCCESS_RATE)
MODALITIES = ('mono', 'stereo', 'mono-inertial', 'stereo-inertial')
BAND_LIMITS = ('good', 'plausible', 'failed')


def gates_for(entry: Entry, config: EvaluationConfig) -> tuple[RunsGate, ...]:
    """Return the gates of the suite, replaced metric by metric by those of the sequence."""
    gates: dict[str, list[RunsGate]] = {gate.metric: [] for gate in DEFAULT_GATES}
    known = [*metric_names(config), SUCCESS_RATE]
    for section in entry.sections('gates'):
        for metric, bounds in _by_metric(section, known):
            gates[metric] = list(_gates_on(section, metric, bounds))
    for default in DEFAULT_GATES:
        stated = [runs.gate._replace(limit=default.limit) for runs in gates[default.metric]]
        if default not in stated:
            gates[default.metric].insert(0, RunsGate(default))
    return tuple(gate for of_metric in gates.values() for gate in of_metric)


def _by_metric(section: Section, known: Iterable[str]) -> Iterator[tuple[str, Any]]:
    """Yield what is stated of each metric; an unknown one is an error."""
    for metric, stated in section.items():
        if metric not in known:
            hint = nearest_name(metric, known)
            raise section.error(metric, f"there is no metric '{metric}' with these options{hint}")
        yield metric, stated


def _gates_on(section: Section, metric: str, bounds: Any) -> Iterator[RunsGate]:
    """Yield the gates on a metric, whose limits may be listed."""
    for each in bounds if isinstance(bounds, list) and bounds else [bounds]:
        limits, over = each, 'median'
        if isinstance(each, Section):
            each.expect(*GATE_KEYS)
            limits = {bound: limit for bound, limit in each.items() if bound != 'of'}
            over = each.get('of', over)
        if over not in OVER:
            raise section.error(metric, f"gate {metric}: 'of' must be {' or '.join(OVER)}")
        try:
            gates = Gate.of(metric, limits)
        except ConfigError as error:
            raise section.error(metric, error) from None
        _check_satisfiable(section, metric, gates)
        yield from (RunsGate(gate, over) for gate in gates)


def _check_satisfiable(section: Section, metric: str, gates: Iterable[Gate]) -> None:
    """Raise ``ConfigError`` where no value can pass all gates on a metric."""
    floors = [gate.limit for gate in gates if gate.comparison == '>=']
    ceilings = [gate.limit for gate in gates if gate.comparison == '<=']
    if metric in SHARES:
        ceilings.append(1.0)
    if floors and ceilings and max(floors) > min(ceilings):
        limits = f'both >= {max(floors):g} and <= {min(ceilings):g}'
        raise section.error(metric, f'gate {metric}: no value is {limits}')


def rules_for(entry: Entry, config: EvaluationConfig) -> tuple[Rule, ...]:
    """Return when a metric is worse than the baseline's; by default, only the ATE is compared."""
    known = metric_names(config)
    rules = {rule.metric: rule for rule in [Rule('ate_trans_rmse_m')]}
    for section in entry.sections('compare'):
        for metric, limits in _by_metric(section, known):
            if isinstance(limits, Section):
                limits.expect(*Rule._fields[1:])
            try:
                rules[metric] = rule_of(metric, limits)
            except ConfigError as error:
                raise section.error(metric, error) from None
    return tuple(rules.values())


def rule_of(metric: str, limits: Any) -> Rule:
    """Return the rule of ``{relative: 0.16, absolute: 0.01, mad: 3, p: 0.05}``."""
    known = Rule._fields[1:]
    if not isinstance(limits, Mapping) or not limits.keys() <= set(known):
        raise ConfigError(f'compare {metric}: expected any of {", ".join(known)}, as numbers')
    numbers = {name: finite(value) for name, value in limits.items()}
    for name, number in numbers.items():
        share = name in ('p', 'p_adjusted')
        if not 0 <= number <= (1 if share else math.inf):
            expected = 'number from 0 to 1' if share else 'finite number >= 0'
            raise ConfigError(f"compare {metric}: {name}: '{limits[name]}' is not a {expected}")
    if not worse_sign(metric):
        raise ConfigError(f'compare {metric}: neither a higher nor a lower value is worse')
    return Rule(metric, **numbers)


def band_for(entry: Entry) -> Mapping[str, float] | None:
    """Return the limits good, plausible and failed [m] of the sequence for its modality."""
    modality = entry.text('modality')
    if modality is not None and modality not in MODALITIES:
        problem = f'modality must be one of {", ".join(MODALITIES)}'
        raise entry.stating('modality').error('modality', problem)
    section = entry.stating('bands')
    file = section.text('bands')
    if file is None:
        return None
    path = section.file.parent / file
    if not path.is_file():
        raise section.error('bands', f'bands: there is no file {path}')
    bands = load_yaml(path)
    if entry.name in bands:
        return _bands_of(bands, entry.name).get(modality)
    if section is entry.own:
        raise section.error('bands', f"{file} has no sequence '{entry.name}'")
    return None


def _bands_of(bands: Section, name: str) -> dict[str | None, dict[str, float]]:
    """Return the limits of a sequence by modality; under None those that name no modality."""
    band = bands.section(name)
    band.expect(*BAND_LIMITS, *MODALITIES)
    parts: dict[str | None, Section] = {}
    for modality in MODALITIES:
        if modality in band:
            parts[modality] = band.section(modality)
            parts[modality].expect(*BAND_LIMITS)
    if not parts or any(limit in band for limit in BAND_LIMITS):
        parts[None] = band
    found = {
        modality: {limit: finite(part.get(limit)) for limit in BAND_LIMITS}
        for modality, part in parts.items()
    }
    for limits in found.values():
        values = list(limits.values())
        if any(map(math.isnan, values)) or sorted(values) != values:
            raise bands.error(
                name, f'{name}: good, plausible and failed must be numbers in rising order'
            )
    return found
