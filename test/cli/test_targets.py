"""Where reports go: the format is named, or told by the suffix; a dash is stdout."""

import json
from pathlib import Path

import pytest

import verbs
from verbs import call, complaint
from vio_eval_ros.cli.imu_noise import REPORTS as NOISE_REPORTS
from vio_eval_ros.cli.inspect import REPORTS as INSPECTION_REPORTS
from vio_eval_ros.cli.targets import SUFFIXES, Target
from vio_eval_ros.errors import ConfigError
from vio_eval_ros.reports import REPORTS
from vio_eval_ros.scoring.documents import SUITE_REPORTS

DEMO = verbs.ROOT / 'demo' / 'simulated_flight'
VERBS = {
    'replay': REPORTS,
    'score': SUITE_REPORTS,
    'inspect': INSPECTION_REPORTS,
    'imu_noise': NOISE_REPORTS,
}


@pytest.mark.parametrize('verb', VERBS)
def test_every_format_of_every_verb_is_told_by_a_suffix(verb):
    # .tex is the table that needs nothing but booktabs
    assert set(VERBS[verb]) - {'siunitx'} <= set(SUFFIXES.values())


@pytest.mark.parametrize(
    ('text', 'format', 'path'),
    [
        ('html:a', 'html', 'a'),
        ('json:a.html', 'json', 'a.html'),  # what is named counts
        ('out.html', 'html', 'out.html'),
        ('OUT.HTM', 'html', 'OUT.HTM'),
        ('junit.xml', 'junit', 'junit.xml'),
        ('/tmp/a.md', 'markdown', '/tmp/a.md'),
        ('take:3.tex', 'latex', 'take:3.tex'),
        ('csv:-', 'csv', '-'),
        ('run.rrd', 'rerun', 'run.rrd'),
    ],
)
def test_the_format_is_named_or_told(text, format, path):
    target = Target.parse(text, REPORTS)
    assert target == Target(format, Path(path))
    assert target.is_printed == (path == '-')


@pytest.mark.parametrize(
    ('text', 'problem'),
    [
        ('out.txt', 'a path with a suffix that tells the format, such as report.json'),
        ('out', 'write FORMAT:PATH'),
        ('-', 'write FORMAT:PATH'),
        ('html:', 'write FORMAT:PATH'),
        ('out.png', 'write FORMAT:PATH'),  # not of this verb
        ('htm:a', "did you mean 'html'?"),
        ('htm:a.html', "did you mean 'html'?"),
        ('jsn', "did you mean 'json'?"),
    ],
)
def test_what_tells_no_format_is_refused_with_what_does(text, problem):
    with pytest.raises(ConfigError) as refused:
        Target.parse(text, REPORTS)
    assert problem in str(refused.value)


def test_a_report_is_printed_in_place_of_the_summary(tmp_path):
    printed = call('replay', DEMO, '--report', 'markdown:-', '--report', tmp_path / 'out.json')
    assert printed.returncode == 0, printed.stderr
    assert printed.stdout.startswith('### ')
    assert 'ATE [m] by alignment' not in printed.stdout
    again = call('replay', DEMO, '--report', 'json:-', '--report', f'csv:{tmp_path}/errors')
    assert json.loads(again.stdout) == json.loads((tmp_path / 'out.json').read_text())


def test_only_one_report_is_printed():
    assert 'only one of --json, html:- can be printed' in complaint(
        'inspect', DEMO, '--json', '--report', 'html:-'
    )
    assert 'only one of csv:-, json:- can be printed' in complaint(
        'replay', DEMO, '--report', 'csv:-', '--report', 'json:-'
    )


def test_an_inspection_is_printed_too():
    assert json.loads(call('inspect', DEMO, '--report', 'json:-').stdout)['findings'] == []
