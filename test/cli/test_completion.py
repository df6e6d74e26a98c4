"""What the shell offers when Tab is pressed."""

import os
from pathlib import Path
import subprocess
import sys

import pytest

from vio_eval_ros.__main__ import VERBS

ROOT = Path(__file__).resolve().parents[2]
RUN = 'from vio_eval_ros.__main__ import main; main()'


def completed(line: str, tmp_path: Path, words_before: int = 0) -> list[str]:
    """Return the words that complete a command line, asked for as argcomplete's script does."""
    environment = os.environ | {
        '_ARGCOMPLETE': str(words_before + 1),
        '_ARGCOMPLETE_IFS': '\n',
        '_ARGCOMPLETE_COMP_WORDBREAKS': ' \t\n"\'@><=;|&(:',
        'COMP_LINE': line,
        'COMP_POINT': str(len(line.encode())),
        'COMP_TYPE': '9',
        'PYTHONPATH': str(ROOT),
    }
    answer = tmp_path / 'answer'
    shell = ['bash', '-c', f'exec "$@" 8>{answer}', 'bash']  # file descriptor 8 has the answer
    done = subprocess.run(
        [*shell, sys.executable, '-c', RUN],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
    )
    assert (done.stdout, done.stderr) == ('', '')
    return [word.rstrip() for word in answer.read_text().split('\n') if word]


def test_the_first_word_is_a_verb(tmp_path):
    assert completed('vio_eval ', tmp_path) == list(VERBS)
    assert completed('vio_eval re', tmp_path) == ['replay']


@pytest.mark.slow
def test_the_verb_completes_its_own_options(tmp_path):
    assert completed('vio_eval replay --gate', tmp_path) == ['--gate', '--gates']
    assert '--fault' in completed('vio_eval simulate run.mcap --', tmp_path)
    assert '--loop' in completed('vio_eval play -', tmp_path)
    assert completed('vio_eval nonsense --', tmp_path) == []


def test_words_of_an_interpreter_before_the_command_do_not_count(tmp_path):
    line = 'python3 -m vio_eval_ros '
    assert completed(f'{line}sim', tmp_path, words_before=2) == ['simulate']
    assert completed(f'{line}replay --ser', tmp_path, words_before=2) == ['--series']


@pytest.mark.slow
@pytest.mark.parametrize('before', ['replay ', 'replay --estimate ', 'inspect ', 'score --set a '])
def test_paths_are_completed(tmp_path, before):
    (tmp_path / 'run.mcap').touch()
    (tmp_path / 'rundown').mkdir()
    assert completed(f'vio_eval {before}run', tmp_path) == ['run.mcap', 'rundown/']


@pytest.mark.slow
def test_choices_are_completed(tmp_path):
    assert completed('vio_eval replay --alignment s', tmp_path) == ['scale', 'se3', 'sim3']
    assert completed('vio_eval replay --report j', tmp_path) == ['json:', 'junit:']
    gates = completed('vio_eval replay --gate ate_trans_m', tmp_path)
    assert {r'ate_trans_mean_m\<=', r'ate_trans_max_m\<='} < set(gates)  # quoted for the shell


def test_the_path_of_a_report_is_completed(tmp_path):
    (tmp_path / 'result.json').touch()
    # the shell takes a colon for the end of a word
    assert completed('vio_eval replay --report json:res', tmp_path) == ['result.json']


def test_argcomplete_is_only_loaded_to_complete():
    code = (
        'import atexit, sys; from vio_eval_ros.__main__ import main\n'
        "atexit.register(lambda: print(' '.join(sys.modules))); main(['replay', '--help'])"
    )
    done = subprocess.run(
        [sys.executable, '-c', code],
        cwd=ROOT, capture_output=True, text=True, check=True, timeout=60,
    )  # fmt: skip
    loaded = done.stdout.split()
    assert 'vio_eval_ros.cli.replay' in loaded
    assert 'argcomplete' not in loaded


def test_both_ways_to_switch_it_on_find_their_marker():
    assert 'PYTHON_ARGCOMPLETE_OK' in (ROOT / 'vio_eval_ros/__main__.py').read_text()[:1024]
