"""What the verbs print and what users write is what the schemas in ``docs/schema`` say."""

from __future__ import annotations

from dataclasses import fields
import importlib.util
import json
from pathlib import Path
import re
import textwrap
from types import ModuleType
from typing import Any

from jsonschema import Draft202012Validator
import numpy as np
import pytest
from referencing import Registry, Resource
import yaml

from recorded_poses import record, stamped
from verbs import call, document, transcript
from vio_eval_ros.core.config import EvaluationConfig
from vio_eval_ros.core.limits import Limits
from vio_eval_ros.errors import VioEvalError
from vio_eval_ros.inspection.expectations import Expectations
from vio_eval_ros.inspection.limits import InspectionLimits
from vio_eval_ros.scoring.loading import load_suite
from vio_eval_ros.settings import gates_of, LIMITED, limits_of, options_of

ROOT = Path(__file__).resolve().parents[1]
FOLDER = ROOT / 'docs' / 'schema'
SCHEMAS = {file.stem: json.loads(file.read_text()) for file in sorted(FOLDER.glob('*.json'))}
REGISTRY = Registry().with_resources(
    (schema['$id'], Resource.from_contents(schema))
    for schema in SCHEMAS.values()
    if '$id' in schema
)
CONFIGS = sorted((ROOT / 'config').rglob('*.yaml'))
DEMO = ROOT / 'demo' / 'simulated_flight'
CHAIN = """
cam0:
  T_cam_imu: [[1, 0, 0, 0.1], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
  rostopic: /cam0
"""
EXPECTED = """
streams:
  left: {topic: /cam0, rate_hz: 20, rate_tolerance: 0.05, max_gap_s: 0.1, frame_id: map}
  right: {topic: /cam1, rate_hz: 20, level: warn}
  nobody: {topic: /cam2}
pairs:
  stereo: {streams: [left, right], max_skew_s: 0.001}
"""
SUITE = """
gates: {ate_trans_rmse_m: [{max: 1.0, warn: 0.5}, {max: 2.0, of: worst}]}
compare: {ate_trans_rmse_m: {relative: 0.2, p: 0.05}}
sequences:
  - name: flight
    recording: FLIGHT
    estimate: /vio/odometry
    ground_truth: /ground_truth/pose
    stack: {name: mine, version: '1'}
"""


SYSTEMS = """
sequences: [{name: flight, recording: FLIGHT, ground_truth: /ground_truth/pose}]
systems:
  - {name: last, estimate: /vio/odometry, options: {alignment: sim3}, modality: mono}
  - {name: first, estimate: /vio/odometry}
"""


def generator() -> ModuleType:
    """Return the module that generates schemas."""
    spec = importlib.util.spec_from_file_location('generate', FOLDER / 'generate.py')
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


GENERATE = generator()


def problems(schema: str, content: Any) -> list[str]:
    """Return what a schema has against something."""
    validator = Draft202012Validator(SCHEMAS[schema], registry=REGISTRY)
    return [f'{error.json_path}: {error.message}' for error in validator.iter_errors(content)]


@pytest.fixture(scope='module')
def cameras(tmp_path_factory) -> Path:
    """Return a rosbag2 with two cameras, the second with a gap."""
    pixels = np.zeros(4, np.uint8)
    messages = [
        (
            f'/cam{k}',
            stamped('sensor_msgs/msg/Image', 50_000_000 * at, 2, 2, 'mono8', 0, 2, pixels),
        )
        for at in range(100, 300)
        for k in (0, 1)
        if k == 0 or not 150 < at < 180
    ]
    return record(tmp_path_factory.mktemp('cameras') / 'recording', messages)


@pytest.mark.parametrize('name', SCHEMAS)
def test_it_is_a_schema_of_the_draft_that_it_names(name):
    assert SCHEMAS[name]['$schema'] == Draft202012Validator.META_SCHEMA['$id']
    Draft202012Validator.check_schema(SCHEMAS[name])
    assert len(SCHEMAS[name].get('description', name)) > 20 or name == 'manifest-1'


def test_every_schema_that_is_printed_has_a_file():
    sources = [file.read_text() for file in (ROOT / 'vio_eval_ros').rglob('*.py')]
    printed = {
        name for text in sources for name in re.findall(r"'(vio_eval_ros\.[a-z_]+/\d)'", text)
    }
    known = {
        schema['properties']['schema']['const']
        for schema in SCHEMAS.values()
        if 'schema' in schema.get('properties', {})
    }
    assert printed == known
    assert {'vio_eval_ros.result/1', 'vio_eval_ros.diagnosis/1'} < known
    for name, schema in SCHEMAS.items():
        if schema['title'].startswith('vio_eval_ros.'):
            assert schema['title'] == f'vio_eval_ros.{name.replace("-", "/")}'


def test_the_generated_schemas_are_up_to_date():
    for name, text in GENERATE.generated().items():
        assert (FOLDER / name).read_text() == text, 'run make schemas'


def test_the_schema_of_limits_has_every_family():
    for file in (ROOT / 'vio_eval_ros').glob('[!c]*/limits.py'):  # not those of core and cli
        importlib.import_module(f'vio_eval_ros.{file.parent.name}.limits')
    families = set(GENERATE.LIMITS.values())
    assert families == {kind for kind in Limits.__subclasses__() if 'test' not in kind.__module__}
    assert GENERATE.LIMITS.keys() <= set(LIMITED)


def test_the_result_has_every_option():
    options = SCHEMAS['result-1']['$defs']['options']
    names = [option.name for option in fields(EvaluationConfig)]
    assert options['required'] == list(options['properties']) == names
    for option in fields(EvaluationConfig):
        if option.metadata['choices']:
            assert options['properties'][option.name]['enum'] == list(option.metadata['choices'])


def test_a_result_a_suite_a_baseline_and_manifests(tmp_path):
    (tmp_path / 'suite.yaml').write_text(SUITE.replace('FLIGHT', str(DEMO)))
    result = document(
        'replay', DEMO, '--gate', 'ate_trans_rmse_m<=1', '--manifest', tmp_path / 'of_run.json'
    )
    assert problems('result-1', result) == []
    done = call(
        'score', 'suite.yaml', '--report', 'json:score.json', '--manifest', 'manifest.json',
        '--record-baseline', 'baseline.json', cwd=tmp_path,
    )  # fmt: skip
    assert done.returncode == 0, transcript(done)
    for schema, file in [
        ('suite-1', 'score'), ('baseline-1', 'baseline'), ('manifest-1', 'manifest'),
        ('manifest-1', 'of_run'),
    ]:  # fmt: skip
        assert problems(schema, json.loads((tmp_path / f'{file}.json').read_text())) == []


def test_a_comparison():
    found = document(
        'replay', DEMO, '--estimate', 'final=/vio/odometry', '--estimate', 'again=/vio/odometry',
        '--gate', 'ate_trans_rmse_m<=1',
    )  # fmt: skip
    assert problems('comparison-1', found) == []


def test_a_suite_of_systems(tmp_path):
    (tmp_path / 'suite.yaml').write_text(SYSTEMS.replace('FLIGHT', str(DEMO)))
    found = document('score', tmp_path / 'suite.yaml', '--jobs', 1)
    assert found['matrix']['systems'] == ['last', 'first']
    assert problems('suite-1', found) == []


@pytest.mark.slow
def test_a_diagnosis(tmp_path):
    faults = ('--fault', 'time_offset=0.1', '--fault', 'scale=1.2', '--fault', 'jump=1')
    assert call('simulate', tmp_path / 'run.mcap', *faults).returncode == 0
    found = document('diagnose', tmp_path / 'run.mcap')
    assert {'time_offset', 'scale'} <= {cause['name'] for cause in found['causes']}
    assert problems('diagnosis-1', found) == []
    assert problems('diagnosis-1', document('diagnose', DEMO)) == []


def test_the_lag_of_signals(tmp_path):
    seconds = np.arange(0, 60, 0.01)
    for name, lag in (('one', 0.0), ('two', 0.05)):
        rows = np.stack([seconds + 1000, np.sin(seconds - lag) * np.sin(7 * (seconds - lag))], 1)
        np.savetxt(tmp_path / f'{name}.csv', rows, '%.9f', ',')
    found = document('diagnose', '--signals', tmp_path / 'one.csv', tmp_path / 'two.csv')
    assert problems('signal_lag-1', found) == []


def test_an_inspection(cameras, tmp_path):
    (tmp_path / 'chain.yaml').write_text(CHAIN)
    (tmp_path / 'expected.yaml').write_text(EXPECTED)
    found = document(
        'inspect', cameras, '--expect', tmp_path / 'expected.yaml',
        '--calibration', tmp_path / 'chain.yaml', status=1,
    )  # fmt: skip
    assert all(found[part] for part in ('streams', 'pairs', 'findings', 'expectations'))
    assert found['calibration']['chains']
    assert problems('inspection-1', found) == []
    assert problems('inspection-1', document('inspect', DEMO)) == []


@pytest.mark.slow
def test_the_noise_of_an_imu(tmp_path):
    done = call('simulate', tmp_path / 'rest.mcap', '--still', '--duration-s', '60')
    assert done.returncode == 0, transcript(done)
    found = document('imu_noise', tmp_path / 'rest.mcap')
    assert len(found['axes']) == 6
    assert problems('imu_noise-1', found) == []


def schema_of(file: Path) -> Path:
    """Return the schema that an editor is told to take for a YAML file."""
    match = re.search(r'^# yaml-language-server: \$schema=(\S+)$', file.read_text(), re.MULTILINE)
    assert match, f'{file} names no schema'
    return (file.parent / match[1]).resolve()


@pytest.mark.parametrize('file', CONFIGS, ids=lambda file: file.name)
def test_an_editor_completes_the_files_of_the_package(file):
    schema = schema_of(file)
    assert schema.parent == FOLDER
    assert problems(schema.stem, yaml.safe_load(file.read_text())) == []


def test_expectations_and_parameters_stand_in_one_file():
    text = (ROOT / 'config/euroc.yaml').read_text()
    assert schema_of(ROOT / 'config/euroc.yaml').stem == 'options'
    assert problems('expectations', yaml.safe_load(text)) == []
    assert problems('expectations', yaml.safe_load(text.replace('max_jitter_s', 'jitter')))


def read(schema: str, file: Path) -> None:
    """Read a file as the verbs do."""
    if schema == 'options':
        EvaluationConfig.from_mapping(options_of(file))
    elif schema == 'limits':
        limits_of(InspectionLimits, 'inspect', 'drone', file)
    else:
        readers = {'gates': gates_of, 'expectations': Expectations.load, 'suite-file': load_suite}
        readers[schema](file)


def cases(kind: str) -> list[tuple[str, str]]:
    """Return YAML that is right or wrong, with its schema."""
    return [(schema, text) for schema, texts in CASES[kind].items() for text in texts]


RIGHT_SUITE = SUITE.replace('FLIGHT', str(DEMO))
RIGHT_SYSTEMS = SYSTEMS.replace('FLIGHT', str(DEMO))
CASES = {
    'right': {
        'options': [
            'alignment: sim3',
            'end_s: .inf',
            'rpe_deltas: [10f, 0.5s]',
            '{rpe_deltas: 15d, segment_lengths_m: [100, 200]}',
            '/**: {ros__parameters: {max_gap_s: 1, estimate_to_body: [0, 0, 0, 0, 0, 0, 1]}}',
        ],
        'gates': ['rpe_0.5s_trans_rmse_m: {max: 1}', 'coverage_ratio: {min: 0.9, warn: 0.95}'],
        'expectations': [
            EXPECTED,
            f'inspect:\n  ros__parameters:\n{textwrap.indent(EXPECTED, "    ")}',
        ],
        'limits': ['inspect: {gap_s: 0.2}', '{}'],
        'suite-file': [
            RIGHT_SUITE,
            f'tags: easy\noptions: {{alignment: se3}}{RIGHT_SUITE}',
            RIGHT_SYSTEMS,
            f'{{recording: {DEMO}, estimate: /vio/odometry, ground_truth: /ground_truth/pose, '
            'sequences: [flight]}',
        ],
    },
    'wrong': {
        'options': [
            'alignement: se3',
            'alignment: se4',
            'max_gap_s: -1',
            'rpe_deltas: [10x]',
            'estimate_to_body: [0, 0, 0]',
            '/**: {ros__parameters: {max_gap: 1}}',
            '/**: {max_gap_s: 1}',
        ],
        'gates': [
            'ate_trans_rmse_m: 0.1',
            'ate_trans_rmse_m: {}',
            'ate_trans_rmse_m: {maximum: 0.1}',
            'ate_trans_rmse_m: {max: low}',
            'ate_trans_rmse_m: {warn: 0.1}',
            '{}',
        ],
        'expectations': [
            '{}',
            EXPECTED.replace('max_gap_s', 'max_gaps_s'),
            EXPECTED.replace('level: warn', 'level: bad'),
            EXPECTED.replace('rate_hz: 20, rate_t', 'rate_t'),
            EXPECTED.replace('rate_hz: 20', 'rate_hz: 0'),
            EXPECTED.replace('[left, right]', '[left]'),
            EXPECTED.replace('topic: /cam2', ''),
        ],
        'limits': ['inspect: {gap: 0.2}', 'inspect: {gap_s: long}', 'inspection: {gap_s: 1}'],
        'suite-file': [
            'options: {}',
            'sequences: []',
            RIGHT_SUITE.replace('    estimate:', '    estimates:'),
            RIGHT_SUITE.replace('warn:', 'warning:'),
            RIGHT_SUITE.replace('of: worst', 'of: best'),
            RIGHT_SUITE.replace('p: 0.05', 'p: 5'),
            RIGHT_SUITE.replace('version:', 'release:'),
            RIGHT_SUITE.replace('    ground_truth: /ground_truth/pose', ''),
            f'options: {{alignment: se4}}{RIGHT_SUITE}',
            f'modality: lidar{RIGHT_SUITE}',
            RIGHT_SYSTEMS.replace('name: first, ', ''),
            RIGHT_SYSTEMS.replace('name: first', 'name: first, ground_truth: gt'),
            RIGHT_SYSTEMS.replace('systems:', 'system:'),
            'sequences: [flight]',
        ],
    },
}


@pytest.mark.parametrize(('schema', 'text'), cases('right'))
def test_what_the_verbs_take_fits_the_schema(schema, text, tmp_path):
    (tmp_path / 'file.yaml').write_text(text)
    read(schema, tmp_path / 'file.yaml')
    assert problems(schema, yaml.safe_load(text)) == []


@pytest.mark.parametrize(('schema', 'text'), cases('wrong'))
def test_what_the_verbs_refuse_does_not_fit_the_schema(schema, text, tmp_path):
    (tmp_path / 'file.yaml').write_text(text)
    with pytest.raises(VioEvalError):
        read(schema, tmp_path / 'file.yaml')
    assert problems(schema, yaml.safe_load(text))
