"""Whatever a verb could not do is one line on stderr and status 2, in a process of its own too."""

import argparse
import resource
import sys

import pytest

from verbs import complaint, ROOT, run, shell, transcript
from vio_eval_ros.cli.shell import Parser
from vio_eval_ros.cli.shell import run as run_verb
from vio_eval_ros.errors import ConfigError, UNABLE

DEMO = str(ROOT / 'demo' / 'simulated_flight')
PROGRAM = 'import sys; from vio_eval_ros.cli.shell import run; sys.exit(run("score", {}))'
FAILING = PROGRAM.format('lambda: 1 / 0')
GREEDY = PROGRAM.format('lambda: len(bytearray(1 << 40))')


@pytest.mark.parametrize(
    ('error', 'message'),
    [
        (ConfigError('no such\noption'), 'score: no such option\n'),
        (OSError('disk full'), 'score: disk full\n'),
        (KeyboardInterrupt(), 'score: interrupted\n'),
        (MemoryError(), 'score: there is not enough memory\n'),
        (BrokenPipeError(), ''),
    ],
)
def test_every_error_is_at_most_one_line(error, message, capsys, monkeypatch):
    def fail() -> int:
        raise error

    monkeypatch.setattr(sys, 'stdout', sys.stdout)  # a broken pipe takes it away
    assert run_verb('score', fail) == UNABLE
    assert capsys.readouterr().err == message


def test_a_bug_is_one_line_and_in_development_mode_a_traceback():
    done = run([sys.executable, '-c', FAILING])
    assert done.returncode == UNABLE, transcript(done)
    assert done.stderr.startswith('score: this is a bug, please report it: ZeroDivisionError')
    assert done.stderr.count('\n') == 1
    done = run([sys.executable, '-X', 'dev', '-c', FAILING])
    assert done.returncode == 1, transcript(done)
    assert 'Traceback' in done.stderr


def test_a_process_that_runs_out_of_memory_says_so():
    def limit() -> None:
        resource.setrlimit(resource.RLIMIT_AS, (1 << 32, 1 << 32))

    done = run([sys.executable, '-c', GREEDY], preexec_fn=limit)
    assert (done.returncode, done.stderr) == (UNABLE, 'score: there is not enough memory\n')


def test_help_imports_no_numpy_before_a_verb_is_named():
    done = shell(f'{sys.executable} -X importtime -m vio_eval_ros --help 2>&1 | grep -c numpy')
    assert done.stdout.strip() == '0', transcript(done)


@pytest.mark.parametrize('text', ['-1', '-.5', '-1e-5', '-inf'])
def test_a_negative_number_in_any_form_is_a_value(text):
    parser = Parser('verb', 'what it does', 'examples')
    parser.add_argument('--offset', type=float)
    assert parser.parse_args(['--offset', text]).offset == float(text)


def test_argparse_still_has_the_private_attribute_that_distinguishes_numbers_from_flags():
    assert argparse.ArgumentParser()._negative_number_matcher.match('-1')


@pytest.mark.parametrize(
    ('words', 'told'),
    [
        (['replay', DEMO, '--aligment', 'sim3'], "'--aligment'; did you mean '--alignment'?"),
        (['replay', '--aligment=sim3', DEMO], "'--aligment'; did you mean '--alignment'?"),
        (['diagnose', '--groundtruth', 'x', DEMO], "did you mean '--ground-truth'?"),
        (['inspect', DEMO, '--reprot', 'x'], "did you mean '--report'?"),
        (['score', '--bseline', 'x'], "did you mean '--baseline'?"),
        (['diagnose', DEMO, '--profile', 'dron'], "did you mean 'drone'?"),
        (['inspect', DEMO, 'b.bag'], "'b.bag' is one argument too many"),
        (['replay', DEMO, '--estimate', '/vio/odometri'], "did you mean '/vio/odometry'?"),
        (['replay', DEMO, '--rpe-deltas', '1sec'], "did you mean '1s'?"),
        (['replay', DEMO, '--rpe-deltas', '10 meters'], "did you mean '10m'?"),
        (['replay', DEMO, '--rpe-deltas', '100ms'], 'such as 1f, 0.5s or 10m\n'),
        (['replay', DEMO, '--gate', 'ate_trans_rms_m<=1'], "did you mean 'ate_trans_rmse_m'?"),
        (['diagnose', '--estimate', 'a', '--estimate', 'b'], '--estimate is given twice'),
        (['diagnose', '--ground-truth', 'a', '--ground-truth', 'b'], 'is given twice'),
    ],
)
def test_what_is_mistyped_gets_the_nearest_right_one(words, told):
    assert told in complaint(*words)


@pytest.mark.parametrize('verb', ['replay', 'diagnose'])
def test_two_files_alone_get_the_command_that_compares_them(verb):
    said = complaint(verb, 'my est.txt', 'gt.txt')
    assert f"{verb} --estimate 'my est.txt' --ground-truth gt.txt" in said
    assert 'one argument too many;' in complaint(verb, 'a', 'b', '--estimate', 'c')
