"""Published trajectories of ten systems: every number of the table is that of the pair alone."""

import importlib.util
import json
from pathlib import Path
import re
from types import ModuleType

import pytest
import yaml

from verbs import call, document, shell

ROOT = Path(__file__).resolve().parents[2]
METRICS = ('ate_trans_rmse_m', 'rpe_1s_rot_rmse_deg', 'ate_rot_rmse_deg', 'coverage_ratio')


def benchmark() -> ModuleType:
    """Return the module that lays the trajectories out as a suite of one's own has them."""
    spec = importlib.util.spec_from_file_location('systems', ROOT / 'benchmarks/systems.py')
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope='module')
def suite(shared_data, tmp_path_factory) -> Path:
    return benchmark().put_into(tmp_path_factory.mktemp('systems'), shared_data)


@pytest.fixture(scope='module')
def found(suite) -> dict:
    """Return the result of the suite as JSON; there are holes, so that it does not pass."""
    return document('score', suite, '--jobs', 2, '--metric', *METRICS, status=1)


def arguments(suite: Path, sequence: str, system: str) -> list[str]:
    """Return what `replay` is called with for a cell."""
    content = yaml.safe_load(suite.read_text())
    (own,) = (one for one in content['systems'] if one['name'] == system)
    words = ['--estimate', f'{suite.parent}/{own["estimate"].format(sequence=sequence)}']
    words += ['--ground-truth', f'{suite.parent}/truth/{sequence}.txt']
    for name, value in {**content['options'], **own.get('options', {})}.items():
        values = value if isinstance(value, list) else [value]
        words += [f'--{name.replace("_", "-")}', *map(str, values)]
    return words


@pytest.mark.slow
def test_every_number_of_the_table_is_that_of_replay(suite, found):
    compared, metrics = 0, found['matrix']['metrics']
    for sequence in found['matrix']['sequences']:
        for system in found['matrix']['systems']:
            cells = {
                name: metrics[name]['sequences'][sequence]['systems'][system] for name in METRICS
            }
            if not list((suite.parent / 'runs' / system).glob(f'{sequence}.*')):
                assert all(cell['value'] is None for cell in cells.values())
                continue
            alone = document('replay', *arguments(suite, sequence, system))
            for name, cell in cells.items():
                assert cell['value'] == alone['metrics'][name]
                assert cell['failed'] != alone['success']
            compared += 1
    assert compared == len(benchmark().FILES) - 3


@pytest.mark.slow
def test_the_table_of_a_paper_shows_the_same_numbers(suite, found, tmp_path):
    call('score', suite, '--jobs', 2, '--metric', *METRICS, '--report', f'{tmp_path}/table.tex')
    text = (tmp_path / 'table.tex').read_text()
    ate = found['matrix']['metrics']['ate_trans_rmse_m']['sequences']
    assert f'\\textbf{{{ate["V1_02"]["systems"]["vislam_rp"]["value"]:.4f}}}' in text
    assert f'\\underline{{{ate["V1_02"]["systems"]["PLS-VIO"]["value"]:.4f}}}' in text
    # globally optimised keyframes that cover too little are shown and marked, not best
    lost = ate['V1_02']['systems']['vislam_ba']['value']
    assert f'{lost:.4f}\\rlap{{$^\\dagger$}}' in text
    assert json.dumps(ate['V1_02']['best']) == '["vislam_rp"]'


@pytest.mark.slow
def test_the_commands_of_the_documentation_print_what_is_shown(suite):
    text = (ROOT / 'docs/compare.md').read_text()
    (yaml_of_user,) = re.findall(r'```yaml\n(.*?)```', text, re.DOTALL)
    (suite.parent / 'suite.yaml').write_text(yaml_of_user)
    blocks = re.findall(r'```sh\n(.*?)```\n\n```\n(.*?)```', text, re.DOTALL)
    assert len(blocks) == 3
    for commands, shown in blocks:
        done = shell(commands, cwd=suite.parent)
        assert done.stdout == shown
        assert done.stderr == ''
