"""
JSON Schemas of the YAML files that users write, from the tables that the verbs read them with.

``python docs/schema/generate.py`` writes them again; a test compares. The schemas of what the
verbs print, ``NAME-1.json``, are written by hand.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import Field, fields
import json
import math
from pathlib import Path
import re
from typing import Any

from vio_eval_ros.comparison.repeated import Rule
from vio_eval_ros.core.config import EvaluationConfig, Options
from vio_eval_ros.core.evaluation import metric_names
from vio_eval_ros.core.limits import Described, Limits
from vio_eval_ros.core.presets import AS, PRESETS
from vio_eval_ros.diagnosis.limits import DiagnosisLimits
from vio_eval_ros.imu.limits import ImuNoiseLimits
from vio_eval_ros.inspection import expectations
from vio_eval_ros.inspection.limits import InspectionLimits
from vio_eval_ros.live import timeliness
from vio_eval_ros.live.options import NodeConfig
from vio_eval_ros.live.processes import Usage
from vio_eval_ros.scoring import criteria, loading, suite

Schema = dict[str, Any]
#: verb to its limits
LIMITS: dict[str, type[Limits]] = {
    'diagnose': DiagnosisLimits,
    'imu_noise': ImuNoiseLimits,
    'inspect': InspectionLimits,
}
FOLDER = Path(__file__).resolve().parent
DRAFT = 'https://json-schema.org/draft/2020-12/schema'
NUMBER = {'type': 'number'}
NOT_NEGATIVE = {'type': 'number', 'minimum': 0}
TEXT = {'type': 'string'}
ANY_PROCESS = 'PROCESS'
NAME = {'type': 'string', 'minLength': 1}
BRACES = '{sequence} and {system} stand for names'
TEXTS = {'anyOf': [TEXT, {'type': 'array', 'items': TEXT}]}
DELTA = {'type': 'string', 'pattern': r'^(\d+(\.\d*)?|\.\d+)[fsmd%]$'}


def table(properties: Schema, description: str = '', **more: Any) -> Schema:
    """Return the schema of a mapping in which no other key is allowed."""
    described = {'description': description} if description else {}
    return {
        'type': 'object',
        **described,
        **more,
        'properties': properties,
        'additionalProperties': False,
    }


def described(schema: Schema, description: str) -> Schema:
    return {**schema, 'description': description}


def option(item: Field[Any], default: Any) -> Schema:
    """Return the schema of an option of a dataclass."""
    schema: Schema
    if item.metadata['choices']:
        schema = {'enum': list(item.metadata['choices'])}
    elif item.name.endswith('_to_body'):
        schema = {'type': 'array', 'items': NUMBER, 'minItems': 7, 'maxItems': 7}
    elif item.name == 'rpe_deltas':
        schema = {'anyOf': [DELTA, {'type': 'array', 'items': DELTA}]}
    elif item.type == 'tuple[float, ...]':
        schema = {'anyOf': [NUMBER, {'type': 'array', 'items': NUMBER}]}
    elif item.type == 'tuple[str, ...]':
        schema = TEXTS
    elif item.name == 'end_s':
        schema = {'type': ['number', 'null']}
    else:
        names = {'str': 'string', 'bool': 'boolean', 'int': 'integer', 'float': 'number'}
        schema = {'type': names[str(item.type)]}
    if item.metadata['minimum'] is not None:
        schema = {**schema, 'minimum': item.metadata['minimum']}
    shown = list(default) if isinstance(default, tuple) else default
    if shown not in ('', math.inf):
        schema = {**schema, 'default': shown}
    return described(schema, item.metadata['description'])


def options(kind: type[Options]) -> Schema:
    """Return the properties of a dataclass of options."""
    defaults = kind()
    tool = {'as': described({'enum': list(PRESETS)}, AS)} if kind is EvaluationConfig else {}
    return tool | {item.name: option(item, getattr(defaults, item.name)) for item in fields(kind)}  # type: ignore[arg-type]


def of_metrics(
    value: Schema, more: Iterable[str] = (), live: bool = False, **others: Any
) -> Schema:
    """
    Return the schema of a mapping from metrics; those of other deltas match a pattern.

    :param live: whether those that only a live run has are allowed.
    """
    more = (*more, *(timeliness.NAMES if live else ()))
    names = metric_names(EvaluationConfig(segment_lengths_m=(100,)))
    patterns = (
        {
            *(process.replace(ANY_PROCESS, r'\w+') for process in Usage(ANY_PROCESS).names),
        }
        if live
        else set()
    )
    patterns |= {
        re.sub(r'^(rpe|segment)_\d+[a-z]_', r'\1_[0-9.]+[fsmd]_', name)
        for name in names
        if name.startswith(('rpe_', 'segment_'))
    }
    return {
        'type': 'object',
        'properties': {name: value for name in (*names, *more)},
        'patternProperties': {f'^{pattern}$': value for pattern in sorted(patterns)},
        'additionalProperties': False,
        **others,
    }


def gate(keys: Iterable[str]) -> Schema:
    """Return the schema of the limits of one metric."""
    meanings = {
        'max': described(NUMBER, 'the largest value that passes'),
        'min': described(NUMBER, 'the smallest value that passes'),
        'warn': described(NUMBER, 'a value beyond this, still within max or min, is pointed out'),
        'of': {'enum': list(suite.OVER), 'description': 'which of the repeated runs is judged'},
    }
    return table(
        {key: meanings[key] for key in keys},
        anyOf=[{'required': ['max']}, {'required': ['min']}],
    )


def options_file() -> Schema:
    parameters = table(
        {
            **options(EvaluationConfig),
            **options(NodeConfig),
            'use_sim_time': {'type': 'boolean', 'description': 'take the time from /clock'},
            'qos_overrides': {'type': 'object', 'description': 'quality of service, by topic'},
        }
    )
    node = table({'ros__parameters': parameters}, required=['ros__parameters'])
    names = ('/**', 'vio_evaluator', '/vio_evaluator')
    return {
        'description': 'Options of the evaluation: --config of the verbs, or parameters of the '
        'node `evaluator`.',
        'anyOf': [
            table(options(EvaluationConfig), 'the options alone'),
            {
                'type': 'object',
                'description': 'a ROS parameter file, which may have other nodes in it',
                'properties': {
                    **{name: {'$ref': '#/$defs/node'} for name in names},
                    expectations.NODE: {
                        'type': 'object',
                        'description': 'see expectations.json',
                        'required': ['ros__parameters'],
                    },
                },
                'anyOf': [{'required': [name]} for name in names],
                'additionalProperties': {'type': 'object', 'required': ['ros__parameters']},
            },
        ],
        '$defs': {'node': node},
    }


def gates_file() -> Schema:
    return {
        'description': 'Gates of one run: `replay --gates FILE`, and `gates_file` of the node.',
        **of_metrics({'$ref': '#/$defs/gate'}, live=True, minProperties=1),
        '$defs': {'gate': gate(('max', 'min', 'warn'))},
    }


def rules() -> Schema:
    """Return the schema of when a metric is worse than the baseline's."""
    meanings = {
        'relative': 'of the median of the baseline',
        'absolute': 'in the unit of the metric',
        'mad': 'times the median absolute deviation of the baseline',
        'p': 'largest probability that it is so by chance',
        'p_adjusted': 'the same of any comparison of the suite; 1 leaves each to itself',
    }
    assert tuple(meanings) == Rule._fields[1:]
    limits = {
        name: {**NOT_NEGATIVE, 'description': meaning, 'default': Rule._field_defaults[name]}
        for name, meaning in meanings.items()
    }
    limits['p']['maximum'] = limits['p_adjusted']['maximum'] = 1
    return table(limits)


def keys_of_suite_or_sequence() -> Schema:
    """Return the properties that both a suite and its sequences may state."""
    return {
        'options': table(options(EvaluationConfig), 'options of the evaluation'),
        'gates': of_metrics(
            {'$ref': '#/$defs/gates_of_metric'},
            (suite.SUCCESS_RATE,),
            description='what passes; the default gates stay beside these',
        ),
        'compare': of_metrics(
            {'$ref': '#/$defs/rule'},
            description='when a metric is worse than in the baseline: beyond all of these',
        ),
        'bands': described(TEXT, 'file with what published systems reach, see bands.json'),
        'modality': {'enum': list(criteria.MODALITIES), 'description': 'sensors of the system'},
        'tags': described(TEXTS, 'names by which `score --tags` selects sequences'),
        'stack': table(
            {
                'name': TEXT,
                'version': TEXT,
                'commit': TEXT,
                'config': described(TEXTS, 'files of its configuration'),
            },
            'the software under test, for the manifest',
        ),
        'calibration': described(TEXTS, 'files of the calibration, for the manifest'),
    }


def paths() -> Schema:
    """Return the properties that say what is read; a suite may state them for all."""
    meanings = {
        'estimate': 'file, or topic of the recording; a glob is one run for each match',
        'causal': 'the same runs as first published',
        'ground_truth': 'file or folder, or topic of the recording',
        'recording': 'bag in which topics are; a glob is one run for each match',
        'times': 'stamps of KITTI poses',
    }
    assert tuple(meanings) == loading.PATH_KEYS
    return {key: described(NAME, f'{meaning}; {BRACES}') for key, meaning in meanings.items()}


def listed(name: str) -> Schema:
    """Return the schema of a list of sequences or systems; a name alone is one, too."""
    item = {'anyOf': [NAME, {'$ref': f'#/$defs/{name}'}]}
    return {'type': 'array', 'items': item, 'minItems': 1}


def suite_file() -> Schema:
    own, shared = paths(), keys_of_suite_or_sequence()
    assert tuple(shared) == loading.SHARED_KEYS
    referred = {key: {'$ref': f'#/$defs/{key}'} for key in (*own, *shared)}
    of_sequence = {'name': described(NAME, 'name of the sequence'), **referred}
    of_system = {'name': described(NAME, 'name of the system, without a slash'), **referred}
    assert set(of_sequence) == set(loading.SEQUENCE_KEYS)
    top = table(
        {
            'sequences': listed('sequence'),
            'systems': described(
                listed('system'),
                'systems to compare on all sequences; by default those that {system} in '
                '`estimate` or `recording` finds',
            ),
            'manifest': described(TEXT, 'file to which the manifest is written'),
            **referred,
        },
        'A suite for `score`. Paths are relative to it. What a sequence states goes over what the '
        'suite states, and what a system states over both, name by name.',
        required=['sequences'],
    )
    one = {'$ref': '#/$defs/gate'}
    definitions = {
        'sequence': table(of_sequence, required=['name']),
        'system': table({key: of_system[key] for key in loading.SYSTEM_KEYS}, required=['name']),
        'gates_of_metric': {'anyOf': [one, {'type': 'array', 'items': one, 'minItems': 1}]},
        'gate': gate(criteria.GATE_KEYS),
        'rule': rules(),
    }
    # each is stated for all, or for every one
    everywhere = [
        {
            'anyOf': [
                {'required': [key]},
                {'properties': {'sequences': {'items': {'required': [key], 'type': 'object'}}}},
                *more,
            ]
        }
        for key, more in (
            ('estimate', [{'required': ['systems']}]),
            ('ground_truth', []),
        )
    ]
    return {**top, 'allOf': everywhere, '$defs': {**definitions, **own, **shared}}


def bands_file() -> Schema:
    limits = {
        'good': 'up to this the ATE (se3, m) is as good as the best',
        'plausible': 'up to this as good as others; beyond it is suspicious',
        'failed': 'beyond this the system has failed',
    }
    assert tuple(limits) == criteria.BAND_LIMITS
    band = {name: described(NUMBER, meaning) for name, meaning in limits.items()}
    modality = {'$ref': '#/$defs/limits'}
    return {
        'description': 'What an ATE means, by sequence: `bands` of a suite.',
        'type': 'object',
        'additionalProperties': table({**band, **dict.fromkeys(criteria.MODALITIES, modality)}),
        '$defs': {'limits': table(band, required=list(band))},
    }


def expected_numbers() -> dict[str, Schema]:
    """Return the schema of each figure that can be expected of a stream or a pair."""
    meanings = {
        'rate_hz': 'messages per second',
        'rate_tolerance': 'relative deviation of the rate',
        'max_jitter_s': 'deviation of the stamps from an even rate, 99th percentile',
        'max_gap_s': 'longest interval between two messages',
        'max_missing_ratio': 'missing messages over all',
        'max_latency_s': 'time from stamp to recording, 99th percentile',
        'max_drift_ppm': 'drift of the stamps against the clock of the recorder',
        'min_duration_s': 'from the first stamp to the last',
        'min_rotation_rad_s': 'rotation about the second most excited axis, rms',
        'min_acceleration_m_s2': 'excitation of the accelerometer',
        'min_still_at_begin_s': 'time at rest at the beginning',
        'max_skew_s': 'median difference of the stamps',
        'max_unsynchronised_ratio': 'frames without a partner over all',
    }
    numbers = ('rate_hz', 'rate_tolerance', *expectations.FIGURES, *expectations.PAIR_FIGURES)
    assert set(meanings) == set(numbers)
    number = {name: described(NOT_NEGATIVE, meaning) for name, meaning in meanings.items()}
    number['rate_hz'] = {**number['rate_hz'], 'minimum': 0, 'exclusiveMinimum': 0}
    return number


def expectations_file() -> Schema:
    level = {'enum': ['fail', 'warn'], 'default': 'fail', 'description': 'if it is not met'}
    number = expected_numbers()
    stream = {
        'topic': described(TEXT, 'topic of the stream'),
        'level': level,
        'frame_id': described(TEXT, 'the only frame in the headers'),
        'up_axis': {
            'enum': list(expectations.UP_AXES),
            'description': 'axis of the IMU that points up at rest',
        },
    }
    stream |= {key: number[key] for key in expectations.STREAM_KEYS if key in number}
    pair = {
        'streams': {
            'type': 'array', 'items': TEXT, 'minItems': 2, 'maxItems': 2, 'uniqueItems': True,
            'description': 'names of two cameras among the streams',
        },
        'level': level,
        **{key: number[key] for key in expectations.PAIR_FIGURES},
    }  # fmt: skip
    assert set(stream) == set(expectations.STREAM_KEYS)
    assert set(pair) == set(expectations.PAIR_KEYS)
    streams = table(stream, required=['topic'], dependentRequired={'rate_tolerance': ['rate_hz']})
    wanted = table(
        {
            'streams': {'type': 'object', 'additionalProperties': streams, 'minProperties': 1},
            'pairs': {
                'type': 'object',
                'additionalProperties': table(pair, required=['streams']),
            },
        },
        required=['streams'],
    )
    node = table({'ros__parameters': {'$ref': '#/$defs/wanted'}}, required=['ros__parameters'])
    return {
        'description': 'What `inspect --expect FILE` expects of the streams of a recording.',
        'if': {'type': 'object', 'required': [expectations.NODE]},
        'then': {'properties': {expectations.NODE: node}},
        'else': {'$ref': '#/$defs/wanted'},
        '$defs': {'wanted': wanted},
    }


def limits_file() -> Schema:
    return {
        'description': 'What counts as healthy: `--limits FILE`. One file serves all verbs.',
        **table(
            {
                verb: table({item.name: limit(item) for item in kind.described()})
                for verb, kind in LIMITS.items()
            }
        ),
    }


def limit(item: Described) -> Schema:
    meaning = f'{item.meaning} [{item.unit}]' if item.unit else item.meaning
    kind = {'type': 'boolean'} if isinstance(item.value, bool) else NUMBER
    return {**kind, 'default': item.value, 'description': meaning}


FILES = {
    'bands': bands_file,
    'expectations': expectations_file,
    'gates': gates_file,
    'limits': limits_file,
    'options': options_file,
    'suite-file': suite_file,
}


def generated() -> dict[str, str]:
    """Return the text of every file, by its name."""
    return {
        f'{name}.json': json.dumps({'$schema': DRAFT, 'title': name, **schema()}, indent=1) + '\n'
        for name, schema in FILES.items()
    }


if __name__ == '__main__':
    for name, text in generated().items():
        (FOLDER / name).write_text(text)
