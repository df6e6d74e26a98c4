"""Exports of motion capture systems are read as the poses that they show."""

from pathlib import Path
from time import process_time

import numpy as np
import pytest

from verbs import complaint, document
from vio_eval_ros.core import rotation
from vio_eval_ros.errors import ConfigError, ReadError
from vio_eval_ros.recordings.sources import read_sources, Source

COUNT, RATE_HZ = 60, 20.0
TIMES = np.arange(COUNT) / RATE_HZ
POSITIONS = np.column_stack([np.cos(TIMES), np.sin(TIMES), 1 + 0.1 * TIMES])
VECTORS = np.column_stack([0.1 * np.sin(TIMES), 0.2 * np.cos(TIMES), 0.3 * TIMES])
ROTATIONS = rotation.from_rotation_vector(VECTORS)
ELSEWHERE = POSITIONS + np.array([3, 4, 0])


def written(path: Path, lines: list[str], separator: str = ',', end: str = '\n') -> Path:
    path.write_bytes((end.join(lines).replace(',', separator) + end).encode())
    return path


def cells(*columns: object) -> list[str]:
    """Return rows of numbers; nothing stands where one is NaN."""
    table = np.column_stack([np.asarray(column, float) for column in columns])
    return [','.join('' if np.isnan(v) else f'{v:.9f}' for v in row) for row in table]


def frames(rows: list[str], first: int = 1) -> list[str]:
    return [f'{k},0,{row}' for k, row in enumerate(rows, first)]


def vicon(
    kind: str = 'Helical', angle: str = 'rad', length: str = 'mm', rate: str = '20'
) -> list[str]:
    per_m = {'mm': 1000, 'm': 1, 'cm': 100}[length]
    turns = np.degrees(VECTORS) if angle == 'deg' else VECTORS
    return [
        'Objects',
        rate,
        f'Global Angle ({kind}),drone',
        'Frame,Sub Frame,RX,RY,RZ,TX,TY,TZ',
        f',,{angle},{angle},{angle},{length},{length},{length}',
        *frames(cells(turns, POSITIONS * per_m)),
    ]


def motive(rotation_type: str = 'Quaternion', units: str = 'Meters') -> list[str]:
    per_m = {'Meters': 1, 'Millimeters': 1000, 'Centimeters': 100}[units]
    body, marker = ['Rigid Body'] * 8, ['Rigid Body Marker'] * 3
    turns = (
        ROTATIONS if rotation_type == 'Quaternion' else np.column_stack([VECTORS, VECTORS[:, 0]])
    )
    return [
        'Format Version,1.23,Take Name,flight 3,Take Notes,,Capture Frame Rate,240.000000,'
        'Export Frame Rate,20.000000,Capture Start Time,2024-03-05 02.11.35.520 PM,Total Frames '
        f'in Take,60,Rotation Type,{rotation_type},Length Units,{units},Coordinate Space,Global',
        '',
        ','.join(['', 'Type', *body, *marker, 'Marker', 'Marker', 'Marker']),
        ','.join(['', 'Name', *['drone'] * 8, *['drone:Marker1'] * 3, *['Unlabeled 3'] * 3]),
        ','.join(['', 'ID', *['"6C6B"'] * 14]),
        ','.join(['', ''] + ['Rotation'] * 4 + ['Position'] * 3 + ['Mean Marker Error'])
        + ',Position' * 6,
        'Frame,Time (Seconds),X,Y,Z,W,X,Y,Z,,X,Y,Z,X,Y,Z',
        *(
            f'{k},{k / RATE_HZ:.6f},{row}'
            for k, row in enumerate(
                cells(turns, POSITIONS * per_m, np.zeros(COUNT), ELSEWHERE, ELSEWHERE * np.nan)
            )
        ),
    ]


def matrices(quaternions: np.ndarray) -> np.ndarray:
    """Return the elements of rotation matrices, one column after the other."""
    return rotation.to_matrix(quaternions).transpose(0, 2, 1).reshape(-1, 9)


def qualisys(bodies: dict[str, np.ndarray], has_columns: bool = True) -> list[str]:
    names = list(bodies)
    quantities = 'X,Y,Z,Roll,Pitch,Yaw,Residual,' + ','.join(f'Rot[{k}]' for k in range(9))
    turns = np.zeros((COUNT, 4))
    columns = [(p * 1000, turns, matrices(ROTATIONS)) for p in bodies.values()]
    return [
        'NO_OF_FRAMES,60',
        'NO_OF_CAMERAS,4',
        f'NO_OF_BODIES,{len(names)}',
        'FREQUENCY,20',
        'DESCRIPTION,--',
        'TIME_STAMP,2020-01-22 17:47:17,22107.99179716',
        'DATA_INCLUDED,6D',
        ','.join(['BODY_NAMES', *names]),
        *(['Frame,Time,' + ','.join(f'{n} {quantities}' for n in names) + ','] * has_columns),
        *(
            f'{k + 1},{k / RATE_HZ:.5f},{row},'
            for k, row in enumerate(cells(*[c for body in columns for c in body]))
        ),
    ]


def read(spec: object) -> Source:
    return read_sources([str(spec)])[0]


def assert_drone(source: Source, atol: float = 1e-8) -> None:
    np.testing.assert_allclose(source.stamps_ns, TIMES * 1e9, atol=1)
    np.testing.assert_allclose(source.positions, POSITIONS, atol=atol)
    assert source.rotations is not None
    angles = rotation.angle_between(rotation.normalize(source.rotations), ROTATIONS)
    np.testing.assert_allclose(angles, 0, atol=1e-7)
    assert source.kind == 'motion capture'


@pytest.mark.parametrize('angle', ['rad', 'deg'])
@pytest.mark.parametrize('length', ['mm', 'm', 'cm'])
@pytest.mark.parametrize('separator', [',', ';', '\t'])
def test_vicon_in_all_units_and_separators(tmp_path, angle, length, separator):
    lines = vicon(angle=angle, length=length)
    source = read(written(tmp_path / 'trial.csv', lines, separator, '\r\n'))
    assert_drone(source)
    assert 'frames at 20 Hz, frame 1 at 0 s' in source.warnings[0]


def test_vicon_with_quaternions(tmp_path):
    lines = vicon()
    lines[2] = ',,drone'
    lines[3] = 'Frame,Sub Frame,RX,RY,RZ,RW,TX,TY,TZ'
    lines[4] = ',,,,,,mm,mm,mm'
    lines[5:] = frames(cells(ROTATIONS, POSITIONS * 1000))
    assert_drone(read(written(tmp_path / 'trial.csv', lines)))


@pytest.mark.parametrize('kind', ['Euler', 'Euler XYZ'])
def test_angles_that_are_not_defined_are_left_out_and_said(tmp_path, kind):
    for lines in (vicon(kind), [*vicon()[:2], ',,drone', *vicon()[3:]]):
        source = read(written(tmp_path / 'trial.csv', lines))
        np.testing.assert_allclose(source.positions, POSITIONS, atol=1e-8)
        assert source.rotations is None
        assert 'only positions are read' in source.warnings[0]


def test_a_body_of_several_is_chosen_by_name(tmp_path):
    lines = vicon()
    lines[2] = ',,lab:drone,,,,,,lab:cart,,,,,'
    lines[3] += ',RX,RY,RZ,TX,TY,TZ'
    lines[4] += ',rad,rad,rad,mm,mm,mm'
    lines[2] = lines[2].replace('lab:drone', 'Global Angle (Helical),lab:drone', 1)
    other = cells(VECTORS, ELSEWHERE * 1000)
    lines[5:] = [f'{a},{b}' for a, b in zip(lines[5:], other, strict=True)]
    path = written(tmp_path / 'trial.csv', lines)
    assert_drone(read(f'{path}?body=lab:drone'))
    np.testing.assert_allclose(read(f'{path}?body=lab:cart').positions, ELSEWHERE, atol=1e-8)
    with pytest.raises(ReadError, match=r'2 bodies \(lab:drone, lab:cart\); append \?body=lab'):
        read(path)
    with pytest.raises(ReadError, match=r"no body 'drone' .*did you mean 'lab:drone'"):
        read(f'{path}?body=drone')


def test_of_vicon_the_section_of_objects_is_read(tmp_path):
    devices = ['Devices', '1000', ',,Force', 'Frame,Sub Frame,Fx', ',,N', '1,0,3.5', '1,1,3.6', '']
    markers = ['', 'Trajectories', '20', ',,a', 'Frame,Sub Frame,X,Y,Z', ',,mm,mm,mm', '1,0,1,2,3']
    assert_drone(read(written(tmp_path / 'a.csv', [*devices, *vicon(), *markers])))
    with pytest.raises(ReadError, match='Vicon export of devices, which have no poses'):
        read(written(tmp_path / 'b.csv', devices))
    with pytest.raises(ReadError, match='without its row of columns'):
        read(written(tmp_path / 'c.csv', vicon()[:3]))


def test_markers_are_positions(tmp_path):
    lines = ['Trajectories', '20', ',,prism,,', 'Frame,Sub Frame,X,Y,Z', ',,mm,mm,mm']
    rows = frames(cells(POSITIONS * 1000))
    source = read(written(tmp_path / 'trial.csv', lines + rows))
    np.testing.assert_allclose(source.positions, POSITIONS, atol=1e-8)
    assert source.rotations is None
    assert not any('only positions' in warning for warning in source.warnings)


@pytest.mark.parametrize('hidden', [np.nan, 0.0])
def test_frames_in_which_a_body_was_not_seen_are_counted(tmp_path, hidden):
    lines = vicon()
    gone = np.zeros(COUNT, bool)
    gone[[0, 7, 8, 59]] = True
    lines[5:] = frames(
        cells(
            np.where(gone[:, None], hidden, VECTORS),
            np.where(gone[:, None], hidden, POSITIONS * 1000),
        )
    )
    source = read(written(tmp_path / 'trial.csv', lines))
    np.testing.assert_array_equal(np.isnan(source.positions[:, 0]), gone)
    assert "'drone' was not seen in 4 of 60 frames" in source.warnings[0]


def test_a_unit_that_is_not_said_is_asked_for(tmp_path):
    lines = vicon()
    lines[4] = ',,rad,rad,rad,,,'
    path = written(tmp_path / 'trial.csv', lines)
    with pytest.raises(ReadError, match=r'unit of its positions is unknown; append \?unit=mm'):
        read(path)
    assert_drone(read(f'{path}?unit=mm'))


@pytest.mark.parametrize('units', ['Meters', 'Millimeters', 'Centimeters'])
def test_motive_reads_the_rigid_body_and_not_its_markers(tmp_path, units):
    source = read(written(tmp_path / 'take.csv', motive(units=units), end='\r\n'))
    assert_drone(source)
    assert '2024-03-05 02.11.35.520 PM by the clock' in source.warnings[0]
    assert 'y points up' in source.warnings[1]


def test_motive_with_a_timecode_and_parents_and_hidden_frames(tmp_path):
    lines = motive()
    lines.insert(5, lines[4].replace('ID', 'Parent'))
    for row in range(2, 7):
        lines[row] = lines[row].replace(',', ',,', 2).replace(',,', ',', 1)
    lines[7] = lines[7].replace('Time (Seconds),', 'Time (Seconds),TimeCode,')
    for row in range(8, len(lines)):
        frame, time, rest = lines[row].split(',', 2)
        lines[row] = f'{frame},{time},15:26:46:12.02,{rest if row != 20 else "," * 13}'
    source = read(written(tmp_path / 'take.csv', lines))
    assert np.isnan(source.positions[12]).all()
    np.testing.assert_allclose(np.delete(source.positions, 12, 0), np.delete(POSITIONS, 12, 0))


def test_motive_with_euler_angles_is_positions_only(tmp_path):
    source = read(written(tmp_path / 'take.csv', motive('XYZ')))
    np.testing.assert_allclose(source.positions, POSITIONS, atol=1e-8)
    assert source.rotations is None
    assert 'export orientations as quaternions' in source.warnings[2]


def test_motive_without_its_header_says_how_to_export(tmp_path):
    with pytest.raises(ReadError, match='without the header of its columns'):
        read(written(tmp_path / 'take.csv', motive()[:1] + motive()[7:]))


@pytest.mark.parametrize('has_columns', [True, False])
def test_qualisys_with_matrices_by_columns(tmp_path, has_columns):
    bodies = {'drone': POSITIONS, 'cart': ELSEWHERE}
    path = written(tmp_path / 'run_6D.tsv', qualisys(bodies, has_columns), '\t')
    assert_drone(read(f'{path}?body=drone'))
    np.testing.assert_allclose(read(f'{path}?body=cart').positions, ELSEWHERE, atol=1e-8)
    one = read(written(tmp_path / 'one_6D.tsv', qualisys({'drone': POSITIONS}, has_columns), '\t'))
    assert_drone(one)
    assert 'from the start of the measurement, 2020-01-22 17:47:17' in one.warnings[0]


def test_the_matrix_of_qualisys_is_that_of_its_angles():
    # a frame that Qualisys Track Manager exported: roll, pitch, yaw [deg], and Rot[0] to Rot[8]
    roll, pitch, yaw = np.radians([-0.78772, 0.05832, 0.12055])
    exported = [1, 0.00209, -0.00105, -0.0021, 0.9999, -0.01375, 0.00102, 0.01375, 0.9999]
    about = [
        rotation.to_matrix(rotation.from_rotation_vector(angle * np.eye(3)[axis]))
        for axis, angle in enumerate((roll, pitch, yaw))
    ]
    expected = about[0] @ about[1] @ about[2]  # as its manual defines them: R = Rx Ry Rz
    np.testing.assert_allclose(np.reshape(exported, (3, 3)).T, expected, atol=2e-5)


def test_qualisys_without_times_counts_by_the_frequency(tmp_path):
    lines = qualisys({'drone': POSITIONS}, has_columns=False)
    lines = [line.split(',', 2)[2] if line[0].isdigit() else line for line in lines]
    source = read(written(tmp_path / 'run_6D.tsv', lines, '\t'))
    assert_drone(source)
    assert 'frames at 20 Hz' in source.warnings[1]


def test_qualisys_with_other_columns_is_refused(tmp_path):
    lines = qualisys({'drone': POSITIONS})
    lines = [line.rsplit(',', 3)[0] if line[0].isdigit() else line for line in lines]
    with pytest.raises(ReadError, match='Qualisys export of 6D with 16 columns'):
        read(written(tmp_path / 'run_6D.tsv', lines, '\t'))
    lines = [line.replace('6D', '2D') for line in qualisys({'drone': POSITIONS})]
    with pytest.raises(ReadError, match='Qualisys export of 2D'):
        read(written(tmp_path / 'run_2D.tsv', lines, '\t'))


def test_matrices_that_are_none_are_refused(tmp_path):
    lines = qualisys({'drone': POSITIONS})
    for row in range(9, len(lines)):
        before, *_ = lines[row].rsplit(',', 4)
        lines[row] = f'{before},0.5,0.5,0.5,'
    with pytest.raises(ReadError, match='not orthonormal'):
        read(written(tmp_path / 'run_6D.tsv', lines, '\t'))


def test_what_an_export_says_is_not_stated_again(tmp_path):
    path = written(tmp_path / 'trial.csv', vicon())
    for statement in ('quaternion=wxyz', 'stamps=ms'):
        with pytest.raises(ConfigError, match='does not apply to an export of Vicon'):
            read(f'{path}?{statement}')
    plain = tmp_path / 'plain.txt'
    plain.write_text('\n'.join(f'{k} {k} 0 0 0 0 0 1' for k in range(9)))
    with pytest.raises(ConfigError, match='body chooses one in an export of motion capture'):
        read(f'{plain}?body=drone')


@pytest.mark.parametrize('cell', ['', 'nan', '1e400', '1e18'])
def test_a_row_without_a_frame_is_an_error(tmp_path, cell):
    lines = vicon()
    lines[20] = cell + lines[20][lines[20].index(',') :]
    with pytest.raises(ReadError, match='no frame or time'):
        read(written(tmp_path / 'trial.csv', lines))


def test_an_export_is_scored_against_an_estimate_from_its_start(tmp_path):
    written(tmp_path / 'trial.csv', vicon())
    estimate = np.column_stack([TIMES, POSITIONS, ROTATIONS])[5:]
    np.savetxt(tmp_path / 'est.txt', estimate, '%.9f')
    result = document(
        *('replay', '--estimate', 'est.txt', '--ground-truth', 'trial.csv'), cwd=tmp_path
    )
    assert result['association']['pairs'] == 55
    assert result['metrics']['ate_trans_rmse_m'] < 1e-6
    assert result['metrics']['ate_rot_rmse_deg'] < 1e-5
    estimate[:, 0] += 1.7e9
    np.savetxt(tmp_path / 'late.txt', estimate, '%.9f')
    said = complaint(
        *('replay', '--estimate', 'late.txt', '--ground-truth', 'trial.csv'), cwd=tmp_path
    )
    assert 'no pairs' in said


@pytest.mark.parametrize('run', ['\n', ' ', '\t', '9'])
def test_long_runs_of_one_character_are_read_in_time(tmp_path, run):
    file = tmp_path / 'long.csv'
    lines = [*vicon(), '', 'Objects' + '\n' * (run == '9') + 20_000 * run + 'x']
    begin_s = process_time()
    assert len(read_sources([str(written(file, lines))])[0]) == COUNT
    assert process_time() - begin_s < 1.0
