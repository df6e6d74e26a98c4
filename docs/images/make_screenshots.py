"""
Takes the pictures of pages that the documentation shows: `make screenshots`.

Needs a Chromium, which CHROMIUM names (by default the one on the path).
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import redirect_stdout
import io
import os
from pathlib import Path
import shutil
import tempfile

import numpy as np
from PIL import Image
from playwright.sync_api import Browser, sync_playwright

from vio_eval_ros.__main__ import main as run_verb
from vio_eval_ros.conversion.formats import FORMATS, Names
from vio_eval_ros.core.trajectory import Trajectory
from vio_eval_ros.simulation import Drift, simulate
from vio_eval_ros.simulation.drift import estimate
from vio_eval_ros.simulation.faults import inject

HERE = Path(__file__).parent
DEMO = HERE.parents[1] / 'demo' / 'simulated_flight'
CHROMIUM = os.environ.get('CHROMIUM') or shutil.which('chromium') or 'chromium'
COLOURS = 128
WIDE, PHONE = 1240, 400
#: the random walk of the position of each system [m/√s], and of the heading [rad/√s]
SYSTEMS = {'Alpha': (0.008, 0.003), 'Beta': (0.014, 0.005), 'Gamma': (0.022, 0.009)}
SEQUENCES = {'easy': 40.0, 'medium': 60.0, 'difficult': 80.0}
RUNS = 5
SUITE = """
systems: [Alpha, Beta, Gamma]
estimate: runs/{system}/{sequence}/*.tum
ground_truth: gt/{sequence}.tum
sequences: [{name: easy}, {name: medium}, {name: difficult}]
gates: {ate_trans_rmse_m: {max: 0.3}}
"""
#: the runs of Alpha, of which a later version is like Beta on one sequence
VERSIONS = """
gates: {{ate_trans_rmse_m: {{max: 0.15, warn: 0.1}}}}
sequences:
  - {{name: easy, estimate: runs/Alpha/easy/*.tum, ground_truth: gt/easy.tum}}
  - {{name: medium, estimate: runs/Alpha/medium/*.tum, ground_truth: gt/medium.tum}}
  - {{name: difficult, estimate: runs/{difficult}/difficult/*.tum, ground_truth: gt/difficult.tum}}
"""


def called(verb: str, *arguments: object) -> None:
    """Run a verb; that a gate fails is part of the picture."""
    with redirect_stdout(io.StringIO()):
        status = run_verb([verb, *map(str, arguments)])
    if status not in (0, 1):
        raise SystemExit(f'{verb} {arguments}: exit status {status}')


def written(poses: Trajectory, path: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    FORMATS['tum'].write(poses, path, Names())


def flights(folder: Path) -> None:
    """Write five runs of three systems on three sequences, and the ground truth of each."""
    source = np.random.default_rng(5)
    for sequence, seconds in SEQUENCES.items():
        truth = simulate(seconds).ground_truth
        written(truth, folder / 'gt' / f'{sequence}.tum')
        for system, (position, yaw) in SYSTEMS.items():
            for k in range(RUNS):
                drift = Drift(position_walk=position, yaw_walk=yaw)
                run = estimate(truth[::10], drift, source)
                written(run, folder / 'runs' / system / sequence / f'{k}.tum')
    (folder / 'systems.yaml').write_text(SUITE)


def pages(folder: Path) -> None:
    """Write the pages: of a run, of several systems, of a suite, of a diagnosis."""
    gates = ('--gate', 'ate_trans_rmse_m<=0.1', '--gate', 'tracked_ratio>=0.9')
    called('replay', DEMO, *gates, '--report', folder / 'run.html')
    named = (
        word
        for system in SYSTEMS
        for word in ('--estimate', f'{system}=runs/{system}/medium/0.tum')
    )
    truth = ('--ground-truth', 'gt/medium.tum')
    called('replay', *named, *truth, '--report', folder / 'compare.html')
    called('score', 'systems.yaml', '--report', folder / 'systems.html')
    for version, system in (('old', 'Alpha'), ('suite', 'Gamma')):
        Path(f'{version}.yaml').write_text(VERSIONS.format(difficult=system))
    called('score', 'old.yaml', '--record-baseline', 'baseline.json')
    called('score', 'suite.yaml', '--baseline', 'baseline.json', '--report', folder / 'suite.html')
    flight = simulate(60.0)
    late = inject(flight, 'time_offset', (0.08,), np.random.default_rng(3))
    late = inject(late, 'jump', (0.6,), np.random.default_rng(4))
    written(late.estimate, folder / 'est.tum')
    written(late.ground_truth, folder / 'gt.tum')
    inputs = ('--estimate', 'est.tum', '--ground-truth', 'gt.tum')
    called('diagnose', *inputs, '--report', folder / 'diagnose_page.html')


def shot(browser: Browser, page: Path, width: int, height: int, dark: bool = False) -> Image.Image:
    """Return what a window of that size shows of a page, once its plots are drawn."""
    scheme = 'dark' if dark else 'light'
    window = browser.new_page(viewport={'width': width, 'height': height}, color_scheme=scheme)
    window.goto(page.as_uri())
    window.wait_for_load_state('networkidle')
    window.wait_for_timeout(2500)
    content = window.screenshot()
    window.close()
    return Image.open(io.BytesIO(content)).convert('RGB')


def save(images: Sequence[Image.Image], name: str) -> None:
    """Write images side by side, with a palette: that is a third of the bytes."""
    gap = 20 * (len(images) > 1)
    width = sum(image.width for image in images) + gap * (len(images) - 1)
    whole = Image.new('RGB', (width, max(image.height for image in images)), '#888888')
    left = 0
    for image in images:
        whole.paste(image, (left, 0))
        left += image.width + gap
    whole.quantize(COLOURS, dither=Image.Dither.NONE).save(HERE / f'{name}.png', optimize=True)


def main() -> None:
    """Make the pages and take the pictures."""
    with tempfile.TemporaryDirectory() as name, sync_playwright() as playwright:
        folder = Path(name)
        os.chdir(folder)  # so that pages show names without a path
        flights(folder)
        pages(folder)
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=['--no-sandbox'])
        for page, height in (
            ('run', 1500), ('compare', 1500), ('systems', 1100), ('suite', 1200),
            ('diagnose_page', 1200),
        ):  # fmt: skip
            save([shot(browser, folder / f'{page}.html', WIDE, height)], page)
        phones = [
            shot(browser, folder / f'{page}.html', PHONE, 820, dark)
            for page, dark in (('run', False), ('suite', True))
        ]
        save(phones, 'narrow')
        browser.close()


if __name__ == '__main__':
    main()
