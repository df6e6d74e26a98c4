"""
Puts published trajectories of EuRoC where ``systems.yaml`` has them, for tables and figures.

``python benchmarks/systems.py FOLDER``, then ``score FOLDER/systems.yaml --report table.tex``. The
trajectories are read from the folder that VIO_EVAL_ROS_DATA names.
"""

from __future__ import annotations

import os
from pathlib import Path
import shutil
import sys

PROJECT = Path(__file__).resolve().parents[1]
DATA = Path(os.environ.get('VIO_EVAL_ROS_DATA', PROJECT.parent / 'shared' / 'data'))
SUITE = PROJECT / 'benchmarks' / 'systems.yaml'
RPG = 'est_rpg_trajectory_evaluation'
MONO_STEREO, VISLAM = f'{RPG}/euroc_mono_stereo', f'{RPG}/euroc_vislam_mono'
#: what a suite of one's own has in its folders, and where it comes from
FILES = {
    'truth/V1_02.txt': 'gt_euroc/open_vins_tum/V1_02_medium.txt',
    'truth/MH_05.txt': 'gt_euroc/open_vins_tum/MH_05_difficult.txt',
    'truth/MH_01.txt': 'gt_euroc/open_vins_tum/MH_01_easy.txt',
    'runs/VINS-Mono/V1_02.csv': 'est_plsl_slam/euroc/V1-02/vins-mono.csv',
    'runs/VINS-Mono/MH_05.csv': 'est_plsl_slam/euroc/MH-05/vins-mono.csv',
    'runs/VINS-Mono/MH_01.csv': 'est_vins_kavehsgh/vins_result_no_loop.csv',
    'runs/VINS-Mono loop/MH_01.csv': 'est_vins_kavehsgh/vins_result_loop.csv',
    'runs/VINS-Fusion/V1_02.csv': 'est_plsl_slam/euroc/V1-02/vins-fusion.csv',
    'runs/VINS-Fusion/MH_05.csv': 'est_plsl_slam/euroc/MH-05/vins-fusion.csv',
    'runs/PL-VIO/MH_05.txt': 'est_plsl_slam/euroc/MH-05/pl-vio.txt',
    'runs/PLS-VIO/V1_02.csv': 'est_plsl_slam/euroc/V1-02/pls-vio.csv',
    'runs/PLS-VIO/MH_05.csv': 'est_plsl_slam/euroc/MH-05/pls-vio.csv',
    'runs/vio_mono/MH_05.txt': f'{MONO_STEREO}/vio_mono/MH_05/stamped_traj_estimate.txt',
    'runs/vio_stereo/MH_05.txt': (f'{MONO_STEREO}/vio_stereo/MH_05/stamped_traj_estimate.txt'),
    'runs/vislam_rp/V1_02.txt': (f'{VISLAM}/vislam_rp/V1_02/stamped_traj_estimate0.txt'),
    'runs/vislam_ba/V1_02.txt': f'{VISLAM}/vislam_ba/V1_02/stamped_ba_estimate0.txt',
    'runs/ORB-SLAM3 mono/MH_01.txt': 'est_orbslam3/spsingh37/f_dataset-MH01_mono.txt',
}


def put_into(folder: Path, data: Path = DATA) -> Path:
    """Return the suite, in a folder with links to the trajectories."""
    for name, source in FILES.items():
        link = folder / name
        link.parent.mkdir(parents=True, exist_ok=True)
        link.unlink(missing_ok=True)
        link.symlink_to((data / source).resolve(strict=True))
    return Path(shutil.copy(SUITE, folder))


if __name__ == '__main__':
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    print(put_into(Path(sys.argv[1])))
