"""What is written to name a source, and what is added to it in advice."""

from pathlib import Path

from hypothesis import given
from hypothesis import strategies as st
import pytest

from vio_eval_ros.recordings.spec import quoted, Spec, with_statement


@pytest.mark.parametrize(
    ('spec', 'statement', 'expected'),
    [
        ('est.txt', 'quaternion=wxyz', 'est.txt?quaternion=wxyz'),
        ('est.txt?unit=mm', 'stamps=ns', 'est.txt?unit=mm&stamps=ns'),
        ('est.txt?quaternion=wxyz', 'quaternion=xyzw', 'est.txt?quaternion=xyzw'),
        ('run.bag:/odom?invert=pose', 'invert=pose', 'run.bag:/odom'),
        ('est.txt?invert=pose&unit=mm', 'invert=pose', 'est.txt?unit=mm'),
        ('est.txt?invert=pose', 'invert=rotation', 'est.txt?invert=rotation'),
        (
            'est.txt?columns=_,t,x,y,z,qw,qx,qy,qz',
            'quaternion=xyzw',
            'est.txt?columns=_,t,x,y,z,qx,qy,qz,qw',
        ),
        ('est.txt?columns=t,x,y,z', 'columns=t,z,x,y', 'est.txt?columns=t,z,x,y'),
    ],
)
def test_what_is_advised_can_be_written(spec, statement, expected):
    assert with_statement(spec, statement) == expected
    Spec.parse(expected)


@given(st.text('&%+#?=;,: abc26/[]"\'', min_size=1) | st.text(min_size=1))
def test_what_is_advised_states_the_same_body(name):
    stated = f'est.csv?body={quoted(name)}'
    assert Spec.parse(stated).statements == {'body': name}
    for once_more in ('invert=pose', 'unit=mm', 'invert=pose'):
        stated = with_statement(stated, once_more)
    assert Spec.parse(stated) == (Path('est.csv'), None, {'body': name, 'unit': 'mm'})
    assert with_statement('est.csv', f'body={name}') == f'est.csv?body={quoted(name)}'


def test_a_file_may_have_a_question_mark_in_its_name(tmp_path):
    path = tmp_path / 'really?.txt'
    path.touch()
    assert Spec.parse(f'{path}') == (path, None, {})
    assert Spec.parse(with_statement(f'{path}', 'unit=mm')) == (path, None, {'unit': 'mm'})
