"""Reports of a suite say the same in every format, in which no name can break out."""

from collections.abc import Callable, Iterator
import csv
import io
from itertools import pairwise
import json
from pathlib import Path
import re
from typing import Any
from xml.etree import ElementTree

from jsonschema import Draft202012Validator
from markdown_it import MarkdownIt
import pytest
from referencing import Registry, Resource
from xmlschema import XMLSchema

from vio_eval_ros.reports import REPORTS
from vio_eval_ros.scoring.baseline import Baseline, definition_sha256
from vio_eval_ros.scoring.documents import SUITE_REPORTS, suite_text
from vio_eval_ros.scoring.results import SuiteResult
from vio_eval_ros.scoring.scoring import compare_suite
from vio_eval_ros.scoring.tables import COLUMNS

SCHEMAS = {
    name: json.loads((Path(__file__).resolve().parents[2] / 'docs/schema' / name).read_text())
    for name in ('result-1.json', 'comparison-1.json', 'suite-1.json')
}
ATE = 'ate_trans_rmse_m'
HOSTILE = 'a<script>alert(1)</script>|`b`*c*&"\\\x1b[2J_{x}%$#~^\n# d,x\udcff'
JUNIT = XMLSchema(Path(__file__).resolve().parents[1] / 'junit.xsd')


@pytest.fixture
def result(lab) -> SuiteResult:
    """Return a suite with all that can happen in it: three sequences, of which one passes."""
    lab.runs('good', 0.1, 0.11, 0.12)
    lab.runs('worse', 0.1, 0.11, 0.12)
    lab.runs('new', 0.3)
    (lab.folder / 'bands.yaml').write_text('good: {good: 1, plausible: 2, failed: 3}')
    before = lab.score('good', 'worse', 'gone, estimate: "good/*"').sequences
    recorded = {one.sequence.name: one.recorded for one in before}
    lab.runs('worse', 0.2, 0.21, 0.22)
    (lab.folder / 'new/1.tum').write_text('')
    lab.run('new/2.tum', 0.1, until=0.4)
    after = lab.score(
        'good, tags: [easy]',
        'worse, gates: {ate_trans_rmse_m: {max: 1, warn: 0.1}}',
        'new, gates: {ate_trans_rmse_m: [{max: 0.1}, {max: 0.2, of: worst}]}',
        top='bands: bands.yaml',
    )
    return compare_suite(after, Baseline(definition_sha256(), recorded))


@pytest.fixture
def hostile(lab) -> SuiteResult:
    """Return a suite whose names want to be markup."""
    name = json.dumps(HOSTILE.replace('\udcff', ''))
    (lab.folder / 'a').mkdir()
    for bad in ('<img src=x onerror=alert(1)>|$x_1$', 'b\udcff\n'):
        (lab.folder / 'a' / bad).write_text('')
    return lab.score(f'{name}, estimate: "a/*"')


@pytest.fixture
def warned(lab) -> SuiteResult:
    """Return a suite of three runs, two of which drop a pose and are stamped in nanoseconds."""
    lab.runs('a', 0.1, 0.1, 0.1)
    for k in (0, 1):
        rows = [line.split() for line in (lab.folder / f'a/{k}.tum').read_text().splitlines()[1:]]
        rows[3][1] = 'nan'
        stamped = [' '.join([row[0].replace('.', ''), *row[1:]]) for row in rows]
        (lab.folder / f'a/{k}.tum').write_text('\n'.join(stamped))
    return lab.score('a')


@pytest.fixture(scope='module')
def validator() -> Draft202012Validator:
    for schema in SCHEMAS.values():
        Draft202012Validator.check_schema(schema)
    resources = [(schema['$id'], Resource.from_contents(schema)) for schema in SCHEMAS.values()]
    return Draft202012Validator(
        SCHEMAS['suite-1.json'], registry=Registry().with_resources(resources)
    )


def rows(result: SuiteResult) -> list[list[str]]:
    """Return the table of the Markdown report as a reader of it would see it."""
    tokens = MarkdownIt('gfm-like', {'linkify': False}).parse(SUITE_REPORTS['markdown'](result))
    cells = [
        ''.join(child.content for child in token.children or () if child.type == 'text')
        for before, token in pairwise(tokens)
        if before.type in ('th_open', 'td_open')
    ]
    width = sum(token.type == 'th_open' for token in tokens)
    return [cells[k : k + width] for k in range(0, len(cells), width)]


def described(schema: Any) -> Iterator[str]:
    """Yield the names of all properties that a schema describes."""
    if isinstance(schema, dict):
        yield from schema.get('properties', {})
        for part in schema.values():
            yield from described(part)
    elif isinstance(schema, list):
        for part in schema:
            yield from described(part)


def keys(value: Any, name: str = '') -> Iterator[str]:
    """Yield the names of all properties of a result, but those that are data: metrics, counts."""
    if isinstance(value, dict):
        for key, part in value.items():
            if name not in ('metrics', 'dropped', 'baseline') or isinstance(part, float):
                yield key
            yield from keys(part, key)
    elif isinstance(value, list):
        for part in value:
            yield from keys(part)


@pytest.mark.slow
def test_json_keeps_its_schema(result, hostile, validator):
    for one in (result, hostile):
        content = json.loads(SUITE_REPORTS['json'](one))
        assert [error.message for error in validator.iter_errors(content)] == []


@pytest.mark.slow
def test_the_schema_describes_all_that_json_has(result):
    content = json.loads(SUITE_REPORTS['json'](result))
    known = {name for schema in SCHEMAS.values() for name in described(schema)}
    metrics = set(content['sequences'][0]['metrics'])
    assert set(keys(content)) - metrics - known == set()


@pytest.mark.slow
@pytest.mark.parametrize(
    'harm',
    [
        lambda content: content.pop('notes'),
        lambda content: content.update(schema='vio_eval_ros.suite/2'),
        lambda content: content['sequences'][0]['runs'][0].pop('estimate'),
        lambda content: content['sequences'][0]['runs'][0]['metrics'].update(a='1'),
        lambda content: content['sequences'][0]['gates'][0].update(of='best'),
        lambda content: content['sequences'][0]['baseline']['ate_trans_rmse_m'].pop('p_value'),
    ],
)
def test_the_schema_would_notice(result, validator, harm: Callable):
    content = json.loads(SUITE_REPORTS['json'](result))
    harm(content)
    assert not validator.is_valid(content)


def test_the_result_of_replay_keeps_its_schema(lab):
    lab.runs('a', 0.1)
    (run,) = lab.score('a').sequences[0].runs
    content = json.loads(REPORTS['json'](run.result))
    assert Draft202012Validator(SCHEMAS['result-1.json']).is_valid(content)
    content['alignment']['mode'] = 'affine'
    assert not Draft202012Validator(SCHEMAS['result-1.json']).is_valid(content)


@pytest.mark.slow
def test_json_has_the_verdicts_and_their_reasons(result):
    content = json.loads(SUITE_REPORTS['json'](result))
    good, worse, new = content['sequences']
    assert content['verdict'] == 'fail'
    assert [one['verdict'] for one in content['sequences']] == ['pass', 'fail', 'fail']
    assert good['band']['verdict'] == 'good'
    assert good['tags'] == ['easy']
    assert worse['baseline']['ate_trans_rmse_m']['worse'] is True
    assert worse['baseline']['ate_trans_rmse_m']['relative_difference'] == pytest.approx(10 / 11)
    assert (new['baseline'], new['band']) == (None, None)
    assert [set(run) == {'estimate', 'error'} for run in new['runs']] == [False, True, False]
    assert [run.get('success') for run in new['runs']] == [True, None, False]
    assert new['metrics']['ate_trans_rmse_m']['n'] == 2
    assert content['notes'] == [
        'new: not in the baseline',
        'gone: in the baseline, but not scored',
    ]


@pytest.mark.slow
def test_junit_keeps_the_schema_of_jenkins(result, hostile, warned):
    for one in (result, hostile, warned):
        JUNIT.validate(SUITE_REPORTS['junit'](one))


@pytest.mark.slow
@pytest.mark.parametrize(
    ('old', 'new'),
    [
        (' tests="', ' cases="'),
        ('errors="0"', ''),
        ('<testcase name=', '<testcase id='),
        ('failures="0"', 'failures="none"'),
        ('<properties>', '<properties><testcase name="a"/>'),
        ('value=', 'is='),
    ],
)
def test_the_schema_of_jenkins_would_notice(result, old, new):
    text = SUITE_REPORTS['junit'](result)
    assert old in text
    assert not JUNIT.is_valid(text.replace(old, new))


@pytest.mark.slow
def test_junit_has_a_case_for_each_gate_and_comparison(result):
    root = ElementTree.fromstring(SUITE_REPORTS['junit'](result))
    cases = {
        suite.get('name'): {
            case.get('name'): case.find('failure') for case in suite.iter('testcase')
        }
        for suite in root
    }
    assert list(cases) == ['good', 'worse', 'new']
    assert set(cases['good']) == {
        'tracked_ratio>=0.9',
        'ate_extent_ratio<=0.5',
        'success_rate>=1',
        'ate_trans_rmse_m against the baseline',
    }
    assert not any(failure is not None for failure in cases['good'].values())
    failed = {name for name, failure in cases['worse'].items() if failure is not None}
    assert failed == {'ate_trans_rmse_m against the baseline'}
    assert 'ate_trans_rmse_m<=0.1 (warning)' in cases['worse']
    failed = {name for name, failure in cases['new'].items() if failure is not None}
    assert failed == {
        'tracked_ratio>=0.9',
        'success_rate>=1',
        'ate_trans_rmse_m<=0.1',
        'ate_trans_rmse_m<=0.2 of the worst run',
    }
    assert 'new/1.tum: ' in cases['new']['success_rate>=1'].get('message')
    assert 'new/2.tum: failed, tracked_ratio is 0.39' in cases['new']['success_rate>=1'].text
    assert (root.get('tests'), root.get('failures'), root.get('errors')) == ('15', '5', '0')


@pytest.mark.slow
def test_names_of_junit_cases_are_unique(result):
    root = ElementTree.fromstring(SUITE_REPORTS['junit'](result))
    names = [(case.get('classname'), case.get('name')) for case in root.iter('testcase')]
    assert len(set(names)) == len(names)


@pytest.mark.slow
def test_markdown_has_a_row_for_each_sequence_worst_first(result):
    head, *body = rows(result)
    assert head == [name for name in COLUMNS if name in head]
    assert {'sequence', 'runs', 'baseline', 'verdict'} <= set(head)
    assert [row[0] for row in body] == ['worse', 'new', 'good']
    cells = dict(zip(head, body[0], strict=True))
    assert cells['runs'] == '3'
    assert cells['ATE [m]'] == '0.21'
    assert cells['baseline'] == '0.11'
    assert cells['change'] == '+90.9 %'
    assert cells['p'] == '0.05'
    assert cells['verdict'] == 'fail'
    assert dict(zip(head, body[2], strict=True))['band'] == 'good'
    text = SUITE_REPORTS['markdown'](result)
    assert '2 of 3 sequences failed' in text.splitlines()[0]
    assert '- **new**: fail' in text
    assert '- new: not in the baseline' in text


def test_markdown_of_hostile_names_is_text(hostile):
    text = SUITE_REPORTS['markdown'](hostile)
    html = MarkdownIt('gfm-like', {'linkify': False}).render(text)
    assert set(re.findall(r'<(\w+)', html)) <= {
        'h3', 'table', 'thead', 'tbody', 'tr', 'th', 'td', 'ul', 'li', 'strong',
    }  # fmt: skip
    assert len(rows(hostile)) == 2
    assert rows(hostile)[1][0].startswith('a<script>alert(1)</script>|`b`*c*&"')


@pytest.mark.slow
def test_the_terminal_has_the_table_and_the_reasons(result, hostile):
    lines = suite_text(result).splitlines()
    assert lines[0].split()[:3] == ['sequence', 'runs', 'ATE']
    assert [line.split()[0] for line in lines[2:5]] == ['worse', 'new', 'good']
    assert lines[-1] == 'fail: 2 of 3 sequences failed'
    assert any(
        'worse: fail ate_trans_rmse_m rose from 0.11 to 0.21 m (p = ' in line for line in lines
    )
    assert 'worse: warn ate_trans_rmse_m is 0.21, the gate is ate_trans_rmse_m<=0.1' in lines
    assert 'note: gone: in the baseline, but not scored' in lines
    for line in suite_text(hostile).splitlines():
        assert line.isprintable()
    # the table, an empty line, three gates, two runs and the verdict
    assert len(suite_text(hostile).splitlines()) == 3 + 1 + 3 + 2 + 1


@pytest.mark.slow
@pytest.mark.parametrize('name', ['text', 'markdown', 'junit', 'html'])
def test_what_runs_warn_of_is_reported_once_with_how_many_do(warned, name):
    text = (SUITE_REPORTS | {'text': suite_text})[name](warned)
    for warning in ('stamps are read as ns, not s, by their size', 'dropped 1 non-finite'):
        (line,) = (line for line in re.sub('</?li>', '\n', text).splitlines() if warning in line
                   and '(2 of 3 runs)' in line.replace('\\', ''))  # fmt: skip
        assert 'a/0.tum' not in line
    run = warned.sequences[0].runs[0].result
    assert f'warning: {run.summary.warnings[0]}' in REPORTS['junit'](run)


def test_not_all_of_many_warnings_are_reported(lab):
    lab.runs('a', *[0.1] * 12)
    for k in range(12):
        rows = (lab.folder / f'a/{k}.tum').read_text().splitlines()
        rows += ['nan 0 0 0 0 0 0 1'] * (k + 1)
        (lab.folder / f'a/{k}.tum').write_text('\n'.join(rows))
    text = suite_text(lab.score('a'))
    assert text.count('warning: ') == 11
    assert 'a: warning: and 2 more warnings; the JSON report has all of them' in text


@pytest.mark.slow
def test_runs_that_are_not_in_a_figure_are_not_counted_beside_it(lab):
    lab.runs('a', 0.1, 0.1)
    (lab.folder / 'a/2.tum').write_text('')
    (lab.folder / 'b').mkdir()
    (lab.folder / 'b/0.tum').write_text('')
    recorded = lab.score('a', 'b, estimate: "a/*"').sequences
    baseline = {one.sequence.name: one.recorded for one in recorded}
    result = compare_suite(lab.score('a', 'b'), Baseline(definition_sha256(), baseline))
    head, *body = rows(result)
    cells = {row[0]: dict(zip(head, row, strict=True)) for row in body}
    assert (cells['a']['runs'], cells['b']['runs']) == ('2 of 3', '0 of 1')
    assert cells['b']['change'] == ''
    assert 'nan' not in suite_text(result)
    assert f'b: fail {ATE} has no value in 1 of 1 runs, was 0.1 m' in suite_text(result)


def test_no_name_is_a_formula_a_link_or_an_argument(lab):
    lab.runs('a', 0.1)
    names = ['=HYPERLINK("http://evil.example","x")', '[1cm] https://evil.example', '+1', '@a',
             '*b', '-c www.evil.example']  # fmt: skip
    result = lab.score(*(f'{json.dumps(name)}' + ', estimate: "a/*"' for name in names if ', '
                         not in name))  # fmt: skip
    table = list(csv.reader(io.StringIO(SUITE_REPORTS['csv'](result))))
    for cells in table:
        assert not cells[0].startswith(('=', '+', '-', '@')), cells
    assert {cells[0] for cells in table[1:]} == {
        name if name[0] in '[*' else f"'{name}" for name in names
    }
    lines = SUITE_REPORTS['latex'](result).splitlines()
    firsts = [line.lstrip() for line in lines[lines.index(r'\midrule') + 1 : -2]]
    assert len(firsts) == len(names)
    assert not [first for first in firsts if first.startswith(('[', '*'))]
    text = SUITE_REPORTS['markdown'](result)
    assert not re.search(r'https?://|www\.', text)
    shown = [row[0] for row in rows(result)[1:]]
    assert sorted(shown) == sorted(names)


def test_a_warning_is_not_reported_where_the_gate_beside_it_failed(lab):
    lab.runs('a', 0.3)
    result = lab.score('a, gates: {ate_trans_rmse_m: {max: 0.2, warn: 0.1}}')
    assert 'warn' not in suite_text(result)


@pytest.mark.slow
def test_csv_has_every_number_of_every_run(result, hostile):
    table = list(csv.DictReader(io.StringIO(SUITE_REPORTS['csv'](result))))
    first = {row['metric']: row['value'] for row in table if row['estimate'] == 'good/0.tum'}
    metrics = result.sequences[0].runs[0].result.summary.metrics
    assert set(first) == set(metrics)
    assert float(first['ate_trans_rmse_m']) == metrics['ate_trans_rmse_m']
    assert first['kitti_trans_percent'] == ''
    errors = [row for row in table if row['metric'] == 'error']
    assert [row['estimate'] for row in errors] == ['new/1.tum']
    table = list(csv.DictReader(io.StringIO(SUITE_REPORTS['csv'](hostile))))
    assert [row['metric'] for row in table] == ['error', 'error']


@pytest.mark.slow
def test_latex_has_a_row_for_each_sequence_and_no_command_from_a_name(result, hostile):
    lines = SUITE_REPORTS['latex'](result).splitlines()
    body = lines[lines.index(r'\midrule') + 1 : lines.index(r'\bottomrule')]
    assert [line.split('&')[0].strip() for line in body] == ['good', 'worse', 'new']
    assert body[0].count('&') == 6
    (row,) = [line for line in SUITE_REPORTS['latex'](hostile).splitlines() if 'script' in line]
    commands = re.findall(r'\\[a-z]+|\\.', row.removesuffix(r'\\'))
    assert set(commands) == {
        r'\textless', r'\textgreater', r'\textbar', r'\textbackslash',
        r'\textasciitilde', r'\textasciicircum',
        r'\&', r'\_', r'\{', r'\}', r'\%', r'\$', r'\#',
    }  # fmt: skip
    assert not re.search(r'(?<!\\)[$%#_^~]', row)
    assert len(re.findall(r'(?<!\\)&', row)) == 6


@pytest.mark.slow
@pytest.mark.parametrize('name', sorted(SUITE_REPORTS.keys() - {'html'}))
def test_reports_of_the_same_input_are_the_same(lab, result, hostile, name):
    report = SUITE_REPORTS[name]
    assert report(result) == report(result)
    again = lab.score('good', 'new')
    assert report(again) == report(lab.score('good', 'new', jobs=1))
    assert report(hostile).encode()
    assert report(result).endswith('\n')


@pytest.mark.slow
def test_columns_without_anything_are_left_out(lab):
    lab.runs('a', 0.1)
    single = lab.score('a')
    for text in (suite_text(single), SUITE_REPORTS['markdown'](single)):
        assert 'ATE [m]' in text
        for name in ('baseline', 'change', 'spread', 'band'):
            assert name not in text
