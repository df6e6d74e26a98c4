"""Files that are named as a trajectory and are something else: what they are, what to do."""

from __future__ import annotations

from pathlib import Path
import re
from typing import NamedTuple

from vio_eval_ros.errors import ReadError

HEAD_BYTES = 1 << 12
TUM_ROWS = 'rows of stamp x y z qx qy qz qw'


class Foreign(NamedTuple):
    """
    A kind of file that holds no rows of poses.

    :param beginning: of such a file, a regular expression.
    :param what: it is and what to do, behind its name and a colon.
    """

    beginning: bytes
    what: str


# spaces, comments and byte order marks in front of text
_TEXT = rb'(?:\xef\xbb\xbf)?(?:\s|[#%][^\n]*\n)*'

#: the first that fits is what a file is
FOREIGN = (
    Foreign(
        rb'version https://git-lfs\.github\.com/',
        'a pointer of Git LFS instead of the file; fetch the file with `git lfs pull`',
    ),
    Foreign(rb'#ROSBAG V', 'a ROS 1 bag; rename it to end in .bag'),
    Foreign(rb'\x89MCAP0', 'an mcap recording; rename it to end in .mcap'),
    Foreign(rb'SQLite format 3\0', 'an SQLite database; if it is of rosbag2, name it .db3'),
    Foreign(rb'\x89PNG|\xff\xd8\xff|GIF8|BM.{4}\0\0\0\0', 'an image; name a file of poses'),
    Foreign(
        rb'PK\x03\x04|\x1f\x8b|BZh|\x28\xb5\x2f\xfd|\xfd7zXZ|7z\xbc\xaf',
        'compressed (zip, xlsx, npz, gzip, bzip2, zstd or xz); unpack it, or export a csv',
    ),
    Foreign(
        rb'\x93NUMPY|\x89HDF|MATLAB 5|PAR1|\x80[\x02-\x05]',
        f'a binary file of arrays (npy, HDF5, mat, parquet or pickle); write {TUM_ROWS}',
    ),
    Foreign(
        rb'#[^\n]*\.PCD|VERSION [\d.]+\s*\nFIELDS |ply\r?\n',
        f'a point cloud (PCD or PLY), which has no stamps; export the trajectory as {TUM_ROWS}',
    ),
    Foreign(
        _TEXT + rb'(?:VERTEX|EDGE|PARAMS|FIX)[_\d ]',
        'a pose graph (g2o), whose vertices have ids and no stamps; export the trajectory from '
        f'the tool that made the graph as {TUM_ROWS}',
    ),
    Foreign(
        rb'# (?:Image|Camera|3D point) list with ',
        'a model of COLMAP, which has names of images and no stamps; write the stamp of each '
        f'image with its pose as {TUM_ROWS}, and state ?invert=pose, since COLMAP writes the '
        'world in the camera',
    ),
    Foreign(
        _TEXT + rb'(?i:<!doctype html|<html|<head|<body)',
        'a web page, such as a failed download leaves; download the file again',
    ),
    Foreign(
        _TEXT + rb'<(?:\?xml|kml|gpx|\w)',
        f'XML (KML, GPX or the like); convert it to {TUM_ROWS}, or to columns that a header '
        'names: stamp latitude longitude altitude',
    ),
    Foreign(
        _TEXT + rb'(?:\{\s*["\}]|\[\s*[\{\["])',
        f'JSON; convert it to {TUM_ROWS}',
    ),
    Foreign(
        rb'\s*[$!](?:G[A-Z]|B[DN]|P[A-Z]{3})[A-Z]{2,3},',
        'sentences of a GNSS receiver (NMEA); convert them to columns that a header names: '
        'stamp latitude longitude altitude',
    ),
    Foreign(
        rb'[^\n]*RINEX|#[cd]P\d{4} ',
        'observations or orbits of GNSS (RINEX, SP3), not positions; process them first',
    ),
    Foreign(
        _TEXT + rb'header:\s*\n\s+(?:seq|stamp):',
        'messages as `ros2 topic echo` prints them; echo them with --csv, or record a bag',
    ),
    Foreign(
        # pandas calls a column without a name "Unnamed: 0"
        _TEXT + rb'(?!Unnamed: )(?:%YAML|---\s*\n|[A-Za-z_]\w*:\s*(?:\n\s*[-\w]|[-\d"\'\[{!&]))',
        f'YAML, such as a calibration; a trajectory has {TUM_ROWS}',
    ),
    Foreign(
        rb'(?:[^\n]*\n)?[^\n]*\bD M S\b',
        'a table of latitude and longitude in degrees, minutes and seconds, which take three '
        'columns each; convert them to decimal degrees in columns that a header names: stamp '
        'latitude longitude altitude',
    ),
    Foreign(
        rb'PathFileType',
        'a TRC file of markers of motion capture, which have no orientations; export the rigid '
        'body as csv',
    ),
    Foreign(rb'HIERARCHY', 'a BVH file of a skeleton; export the rigid body as csv'),
    Foreign(rb'[\x01-\x08]\x50', 'C3D; export the rigid body as csv'),
)


def refuse_foreign(path: Path, data: bytes) -> None:
    """Raise ``ReadError`` where a file is known to be something else than rows of poses."""
    head = data[:HEAD_BYTES]
    for kind in FOREIGN:
        if re.match(kind.beginning, head, re.DOTALL):
            raise ReadError(path, f'this is {kind.what}')
