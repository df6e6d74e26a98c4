"""The commands of the tutorial, in a folder laid out as it says."""

from pathlib import Path
import re
import shlex

import pytest

from verbs import call, ROOT, transcript
from vio_eval_ros.conversion.formats import FORMATS, Names
from vio_eval_ros.simulation import simulate

TUTORIAL = (ROOT / 'docs' / 'tutorial.md').read_text()
BLOCKS = re.findall(r'```(\w+)\n(.*?)```', TUTORIAL, re.DOTALL)
COMMANDS = [
    shlex.split(block.replace('\\\n', ' '))
    for language, block in BLOCKS
    if language == 'bash' and block.startswith('vio_eval')
]


def written(poses, path: Path, name: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    FORMATS[name].write(poses, path, Names())


@pytest.fixture
def folder(tmp_path):
    """Return a folder with a run on a sequence, and runs of three systems on two others."""
    flight = simulate(duration_s=30.0)
    written(flight.estimate, tmp_path / 'vio.csv', 'euroc')
    truth = tmp_path / 'MH_01_easy/mav0/state_groundtruth_estimate0/data.csv'
    written(flight.ground_truth, truth, 'euroc')
    (suite,) = (block for language, block in BLOCKS if language == 'yaml')
    (tmp_path / 'suite.yaml').write_text(suite)
    systems = re.search(r'systems: \[(.*)\]', suite)[1].split(', ')
    for seed, sequence in enumerate(re.findall(r'{name: (\w+)}', suite)):
        run = simulate(30.0, seed)
        written(run.ground_truth, tmp_path / f'gt/{sequence}.txt', 'tum')
        for system in systems:
            written(run.estimate, tmp_path / f'runs/{system}/{sequence}.csv', 'euroc')
    return tmp_path


@pytest.mark.slow
def test_each_command_does_what_it_says(folder):
    assert [command[1] for command in COMMANDS] == ['info', 'replay', 'diagnose', 'score', 'plot']
    for _, verb, *arguments in COMMANDS:
        done = call(verb, *arguments, cwd=folder)
        assert done.returncode == 0, (verb, transcript(done))
    for name in ('why.html', 'table.tex', 'compare.html'):
        assert (folder / name).stat().st_size > 500
    assert len(list((folder / 'figures').glob('*.pdf'))) == 3
