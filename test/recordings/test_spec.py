"""What is written to name a source, and what is added to it in advice."""

import pytest

from vio_eval_ros.recordings.spec import Spec, with_statement


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
