"""Tables of a matrix: what is marked, how numbers line up, and names that want to be markup."""

import csv
from html.parser import HTMLParser
import io
import re
import shutil
import subprocess
from types import SimpleNamespace

from markdown_it import MarkdownIt
import pytest

from vio_eval_ros.comparison.latex_tables import latex_tables
from vio_eval_ros.comparison.matrix import Cell, CellRun, Matrix
from vio_eval_ros.comparison.tables import (
    csv_table,
    html_tables,
    label,
    markdown_tables,
    text_tables,
)

ATE, ROTATION = 'ate_trans_rmse_m', 'ate_rot_rmse_deg'
HOSTILE = '=a_b%&#$~^{\\}|<b>*[1]'
LOST = 'tracked_ratio is 0.4, not >= 0.9'


def run(ate: float, failure: str = '') -> CellRun:
    metrics = {ATE: ate, ROTATION: 10 * ate}
    return CellRun('run', SimpleNamespace(summary=SimpleNamespace(metrics=metrics)), failure)


def cell(*values: float, failure: str = '') -> Cell:
    return Cell(tuple(run(value, failure) for value in values))


NONE = Cell((CellRun('run', None, "nothing matches 'x'", missing=True),))
UNREAD = Cell((CellRun('run', None, 'x: the file has no rows of numbers'),))


def matrix(**rows: dict[str, Cell]) -> Matrix:
    cells = {(one, name): of for one, row in rows.items() for name, of in row.items()}
    return Matrix(tuple(rows), tuple(next(iter(rows.values()))), (ATE, ROTATION), cells)


@pytest.fixture
def papers() -> Matrix:
    """Return three sequences with all that can happen to three systems."""
    return matrix(
        V1={'a_1': cell(0.1, 0.16, 0.22), 'b': cell(0.3), HOSTILE: cell(12.5)},
        V2={'a_1': cell(0.11), 'b': cell(0.05, failure=LOST), HOSTILE: NONE},
        V3={'a_1': cell(0.21), 'b': cell(0.31), HOSTILE: UNREAD},
    )


def test_text_lines_up_at_the_point_and_marks_best_and_second(papers):
    lines = text_tables(papers).splitlines()
    assert lines[0] == 'ATE [m]'
    assert lines[1].split() == ['sequence', 'a_1', 'b', HOSTILE]
    rows = lines[3:6]
    assert [row.split()[1:3] for row in rows[:1]] == [['0.16', '*']]
    column = [row.index('.') for row in rows]
    assert column == [column[0]] * 3
    assert [row.split()[3:5] for row in rows[:1]] == [['0.300', '+']]
    assert '0.050' in rows[1]
    assert '†' in rows[1]
    assert 'missing' in rows[1]
    assert 'failed' in rows[2]


def test_a_terminal_shows_the_best_bold_and_the_second_underlined(papers):
    styled, plain = text_tables(papers, styled=True), text_tables(papers)
    assert '\x1b[1m0.16\x1b[0m ' in styled
    assert '\x1b[4m0.300\x1b[0m' in styled
    assert '\x1b[1mbest\x1b[0m, \x1b[4msecond\x1b[0m' in styled
    shown = re.sub(r'\x1b\[\d*m', '', styled)
    assert ' *' not in shown
    assert ' +' not in shown
    numbers = [re.findall(r'\d\.\d+', text.partition('best')[0]) for text in (shown, plain)]
    assert numbers[0] == numbers[1]
    rows = shown.splitlines()[3:6]
    assert [row.index('.') for row in rows] == [rows[0].index('.')] * 3


def test_mean_and_rank_are_below_a_rule_and_say_over_what_they_are(papers):
    text = text_tables(papers)
    lines = text.splitlines()
    mean = next(line for line in lines if line.startswith('mean'))
    assert mean.split()[:4] == ['mean', 'of', '1', '0.160']
    assert lines[lines.index(mean) - 1].startswith('----')
    assert next(line for line in lines if line.startswith('rank')).split()[1] == '1.00'
    assert 'mean of 1 (ATE [m], ATE [deg]): over V1, where all systems succeeded' in text
    assert f'V2, b: {LOST}' in text
    assert f'V3, {HOSTILE}: x: the file has no rows of numbers' in text


def test_a_tiny_value_is_no_zero():
    text = text_tables(matrix(V1={'copy': cell(3e-12), 'real': cell(0.2), 'zero': cell(0.0)}))
    rows = {line.split()[0]: line.split()[1] for line in text.splitlines()[3:6]}
    assert rows == {'copy': '3.0e-12', 'real': '0.200', 'zero': '0.000'}


def test_the_longer_side_goes_down():
    one = {name: cell(0.1 * k) for k, name in enumerate('abc', 1)}
    assert text_tables(matrix(V1=one, V2=one)).splitlines()[1].split()[:3] == [
        'system', 'V1', 'V2',
    ]  # fmt: skip
    title, heads = text_tables(matrix(V1=one)).splitlines()[:2]
    assert title == 'V1'
    assert heads.split() == ['system', 'ATE', '[m]', 'ATE', '[deg]']


def test_markdown_is_a_table_whatever_the_names(papers):
    text = markdown_tables(papers)
    tokens = MarkdownIt('gfm-like', {'linkify': False}).parse(text)
    heads = [t.content for k, t in enumerate(tokens) if tokens[k - 1].type == 'th_open']
    assert len(heads) == 8
    cells = [t for k, t in enumerate(tokens) if tokens[k - 1].type == 'td_open']
    assert len(cells) == 2 * 5 * 4
    assert cells[1].content == '**0.16**'
    assert cells[2].content == '<ins>0.300</ins>'
    assert '<b>' not in text.replace('\\<b', '')


def test_html_is_well_formed_whatever_the_names(papers):
    opened: list[str] = []

    class Checker(HTMLParser):
        def handle_starttag(self, tag, attributes):
            opened.append(tag)

        def handle_endtag(self, tag):
            assert opened.pop() == tag

    Checker().feed(html_tables(papers))
    assert opened == []
    assert '<b>0.16</b>' in html_tables(papers)


def test_csv_has_every_cell_in_full_and_no_formulas(papers):
    rows = list(csv.DictReader(io.StringIO(csv_table(papers))))
    assert len(rows) == 2 * 3 * 3
    first = rows[0]
    assert (first['metric'], first['sequence'], first['system']) == (ATE, 'V1', 'a_1')
    assert (first['value'], first['place'], first['runs'], first['successes']) == (
        '0.16', '1', '3', '3',
    )  # fmt: skip
    assert float(first['standard_error']) == pytest.approx(0.0346, abs=1e-4)
    assert all(not row['system'].startswith('=') for row in rows)
    hole = next(row for row in rows if row['sequence'] == 'V2' and row['system'].endswith('[1]'))
    assert (hole['value'], hole['failure']) == ('', "nothing matches 'x'")


def test_latex_escapes_names_and_lines_up_at_the_point(papers):
    text = latex_tables(papers)
    assert '\\begin{tabular}{lrrr}' in text
    assert 'a\\_1' in text
    assert '=a\\_b\\%\\&\\#\\$\\textasciitilde{}\\textasciicircum{}\\{' in text
    assert '\\textbf{0.16}\\phantom{0} & \\underline{0.300} & 12.500' in text
    assert '0.050\\rlap{$^\\dagger$}' in text
    assert text.count('\\toprule') == text.count('\\bottomrule') == 1


def test_siunitx_has_the_room_of_each_column_and_braces_what_is_no_plain_number(papers):
    text = latex_tables(papers, siunitx=True)
    assert '\\usepackage{siunitx}' in text
    columns = 'lS[table-format=1.3]S[table-format=1.3]S[table-format=3.3]'
    assert f'\\begin{{tabular}}{{{columns}}}' in text
    assert '& \\bfseries 0.16 & {\\underline{\\num{0.300}}} & 12.500 ' in text
    assert '& {\\num{0.050}\\rlap{$^\\dagger$}} & {missing} ' in text
    assert text.count('{failed}') == 2
    assert '{3.0e-12}' in latex_tables(matrix(V1={'copy': cell(3e-12), 'b': cell(0.2)}), True)
    assert 'siunitx' not in latex_tables(papers)


def test_means_over_other_sequences_have_a_head_of_their_own():
    known, without = cell(0.1), CellRun('r', None, LOST)
    both = {name: known for name in 'abc'}
    assert latex_tables(matrix(V1=both, V2=both)).count('system &') == 1
    uneven = Matrix(('V1', 'V2'), ('a', 'b', 'c'), (ATE, 'nees_position_mean'),
                    matrix(V1=both, V2={**both, 'c': Cell((without,))}).cells)  # fmt: skip
    text = latex_tables(uneven)
    assert {line.count('&') for line in text.splitlines() if line.startswith('a &')} == {2, 4}


@pytest.mark.slow
@pytest.mark.parametrize('package', ['booktabs', 'siunitx'])
def test_the_table_compiles(papers, tmp_path, package):
    if shutil.which('pdflatex') is None:
        pytest.skip('there is no pdflatex')
    found = subprocess.run(['kpsewhich', f'{package}.sty'], capture_output=True, check=False)
    if not found.stdout:
        pytest.skip(f'there is no {package}: apt install texlive-science')
    (tmp_path / 'table.tex').write_text(latex_tables(papers, siunitx=package == 'siunitx'))
    (tmp_path / 'paper.tex').write_text(
        f'\\documentclass{{article}}\\usepackage{{booktabs,{package}}}\\begin{{document}}'
        '\\begin{table}\\centering\\input{table.tex}\\end{table}\\end{document}'
    )
    done = subprocess.run(
        ['pdflatex', '-interaction=nonstopmode', '-halt-on-error', 'paper.tex'],
        cwd=tmp_path, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout
    assert 'Overfull' not in done.stdout
    assert 'Warning: Package siunitx' not in done.stdout


@pytest.mark.parametrize(
    ('metric', 'shown'),
    [
        (ATE, 'ATE [m]'),
        ('ate_rot_p95_deg', 'ATE p95 [deg]'),
        ('ate_sim3_trans_rmse_m', 'ATE Sim(3) [m]'),
        ('rpe_1s_trans_rmse_m', 'RPE 1 s [m]'),
        ('rpe_0.5m_disp_mean_m', 'RPE 0.5 m disp mean [m]'),
        ('kitti_rot_deg_per_m', 'KITTI [deg/m]'),
        ('segment_100m_trans_percent', 'segment 100 m [%]'),
        ('coverage_ratio', 'coverage'),
        ('initialisation_s', 'initialisation [s]'),
        ('sim3_scale', 'Sim(3) scale'),
    ],
)
def test_a_metric_has_the_head_that_papers_have(metric, shown):
    assert label(metric) == shown
