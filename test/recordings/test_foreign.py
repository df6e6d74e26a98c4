"""What is no trajectory is called by its name, with what to do."""

from pathlib import Path

import pytest

from verbs import complaint
from vio_eval_ros.recordings.foreign import refuse_foreign

TRUTH = '\n'.join(f'{k}.0 {k / 9:.3f} 0 0 0 0 0 1' for k in range(30))


@pytest.mark.parametrize(
    ('content', 'expected'),
    [
        (b'VERTEX_SE3:QUAT 0 1 2 3 0 0 0 1\nEDGE_SE3:QUAT 0 1 1 0 0 0 0 0 1\n', 'pose graph'),
        (b'# made by a tool\n\nVERTEX_SE2 0 1 2 3\n', 'pose graph'),
        (b'VERTEX3 0 1 2 3 0 0 0\n', 'pose graph'),
        (b'FIX 0\nVERTEX_SE3:QUAT 0 1 2 3 0 0 0 1\n', 'no stamps'),
        (b'# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\n', 'point cloud'),
        (b'VERSION 0.7\nFIELDS x y z\n', 'point cloud'),
        (b'ply\nformat ascii 1.0\n', 'point cloud'),
        (b'%YAML:1.0\n---\nCamera.fx: 458.6\n', 'YAML'),
        (b'cam0:\n  T_cam_imu:\n  - [1.0, 0, 0, 0]\n', 'YAML'),
        (b'P0: 7.188560000000e+02 0.0 6.07e+02\n', 'YAML'),
        (b'---\nheader:\n  seq: 1\n', 'YAML'),
        (b'header:\n  stamp:\n    sec: 17\n', 'ros2 topic echo'),
        (b'{"poses": [1, 2]}', 'JSON'),
        (b'[\n  {"stamp": 1}]', 'JSON'),
        (b'[[1.0, 0, 0], [0, 1, 0]]', 'JSON'),
        (b'$GPGGA,123519,4807.038,N,01131.000,E,1,08,0.9,545.4,M,46.9,M,,*47\n', 'NMEA'),
        (b'$GNRMC,123519,A,4807.038,N,01131.000,E,,,,,\n', 'latitude longitude'),
        (b'<?xml version="1.0"?>\n<kml>', 'KML'),
        (b'<gpx version="1.1">', 'GPX'),
        (b'\n<!DOCTYPE html>\n<html lang="en">', 'web page'),
        (b'\xef\xbb\xbf<HTML><body>404', 'download the file again'),
        (b'version https://git-lfs.github.com/spec/v1\noid sha256:0\n', '`git lfs pull`'),
        (b'#ROSBAG V2.0\n\x45\0\0\0', 'end in .bag'),
        (b'\x89MCAP0\r\n\0\0', 'end in .mcap'),
        (b'SQLite format 3\0\0\0', '.db3'),
        (b'\x89PNG\r\n\x1a\n\0\0', 'an image'),
        (b'\xff\xd8\xff\xe0\0\0', 'an image'),
        (b'PK\x03\x04\0\0', 'unpack it'),
        (b'\x1f\x8b\x08\0', 'unpack it'),
        (b'\x93NUMPY\x01\0', 'binary file of arrays'),
        (b'\x89HDF\r\n\0', 'binary file of arrays'),
        (b'\x80\x04\x95\0\0', 'binary file of arrays'),
        (b'# Image list with two lines of data per image:\n', 'COLMAP'),
        (b'     3.03           OBSERVATION DATA    M: Mixed            RINEX VERSION', 'RINEX'),
        (b'PathFileType\t4\t(X/Y/Z)\ttrial.trc\n', 'TRC'),
        (b'HIERARCHY\nROOT Hips\n', 'BVH'),
        (b'\x02\x50\x01\0', 'C3D'),
        (b'Time Latitude\n(sec) (+/-D M S)\n1.0 22 18 4.33\n', 'decimal degrees'),
    ],
)
def test_what_is_no_trajectory_is_called_by_its_name(tmp_path, content, expected):
    (tmp_path / 'est.txt').write_bytes(content)
    (tmp_path / 'gt.txt').write_text(TRUTH)
    said = complaint('replay', '--estimate', 'est.txt', '--ground-truth', 'gt.txt', cwd=tmp_path)
    assert said.startswith('replay: est.txt: this is ')
    assert expected in said


@pytest.mark.parametrize(
    'content',
    [
        TRUTH,
        '# a comment: with a colon\n' + TRUTH,
        '\nPos_x Pos_y Pos_z\n1 2 3\n',
        'time: x y z qx qy qz qw\n' + TRUTH,
        '%time,field.header.seq\n1,2',
        '#timestamp [ns],p_RS_R_x [m]\n',
        '"t","x","y"\n"1","2","3"',
        'Objects\n100\nGlobal Angle (Helical),drone\n',
        'Format Version,1.23,Take Name,a\n',
        'NO_OF_FRAMES\t100\n',
        '[1.0 2.0 3.0]\n',
        'FIXED,timestamp\n',
        '-1.5,2\n',
    ],
)
def test_tables_are_not_taken_for_anything_else(content):
    refuse_foreign(Path('any.txt'), content.encode())
