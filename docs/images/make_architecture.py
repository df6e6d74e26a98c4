"""
Draws docs/images/architecture.svg: how data flows through the packages.

Needs matplotlib: ``pip install '.[plot]'``, then ``python docs/images/make_architecture.py``.
"""

from __future__ import annotations

from pathlib import Path

from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.patches import FancyBboxPatch

HERE = Path(__file__).parent
INK, SOFT, PAPER = '#1f242b', '#5d6671', '#f3f5f8'
COLOURS = {'in': '#e8eef7', 'core': '#fff4d6', 'out': '#e5f3ea', 'shell': '#f5e8ee'}
BOX = (1.9, 0.82)
#: name: left, bottom, kind, what it does
PACKAGES = {
    'simulation': (0.0, 3.9, 'in', 'known truth,\nchosen faults'),
    'recordings': (0.0, 2.6, 'in', 'files, bags, arrays\nto columns of poses'),
    'ros, live': (0.0, 0.0, 'in', 'messages to columns,\nat each tick'),
    'inspection, imu': (2.6, 3.9, 'core', 'sensor streams,\nIMU noise'),
    'diagnosis': (2.6, 2.6, 'core', 'why it is bad'),
    'core': (2.6, 1.3, 'core', 'association, alignment,\nmetrics: numpy only'),
    'conversion': (5.2, 3.9, 'out', 'any source to TUM,\nEuRoC, KITTI, bags'),
    'comparison': (5.2, 2.6, 'core', 'many systems; is\nthe difference real?'),
    'evaluation': (5.2, 1.3, 'core', 'two sources in,\none result out'),
    'scoring': (7.8, 2.6, 'out', 'suites, baselines,\nverdicts for CI'),
    'reports, figures': (7.8, 1.3, 'out', 'JSON, LaTeX, HTML,\nPDF, mcap'),
    'diagnostics': (7.8, 0.0, 'out', '/diagnostics, metrics,\npaths in ROS 2'),
}
#: from a side of one box to a side of another
ARROWS = [
    ('simulation', 'S', 'recordings', 'N'), ('recordings', 'E', 'inspection, imu', 'W'),
    ('recordings', 'E', 'core', 'W'), ('ros, live', 'E', 'core', 'W'),
    ('ros, live', 'E', 'diagnostics', 'W'), ('core', 'N', 'diagnosis', 'S'),
    ('core', 'E', 'evaluation', 'W'), ('evaluation', 'N', 'comparison', 'S'),
    ('evaluation', 'E', 'reports, figures', 'W'), ('comparison', 'E', 'scoring', 'W'),
    ('scoring', 'S', 'reports, figures', 'N'),
]  # fmt: skip
SIDES = {'N': (0.5, 1.0), 'S': (0.5, 0.0), 'E': (1.0, 0.5), 'W': (0.0, 0.5)}
SHELLS = 'cli (vio_eval VERB)   ·   api (import vio_eval_ros)   ·   ros (ros2 run, ros2 launch)'


def place(name: str, across: float = 0.5, up: float = 0.5) -> tuple[float, float]:
    """Return a place in a box, by its share of width and height."""
    left, bottom, *_ = PACKAGES[name]
    return left + across * BOX[0], bottom + up * BOX[1]


def main() -> None:
    """Draw it."""
    figure = Figure(figsize=(9.9, 5.9))
    axes = figure.add_axes((0, 0, 1, 1))
    axes.set(xlim=(-0.25, 9.95), ylim=(-0.2, 5.85))
    axes.axis('off')
    line = {'arrowstyle': '-|>', 'color': SOFT, 'shrinkA': 1, 'shrinkB': 1, 'lw': 1.2}
    for begin, leaving, end, entering in ARROWS:
        ends = place(end, *SIDES[entering]), place(begin, *SIDES[leaving])
        axes.annotate('', *ends, arrowprops=line)
    for name, (left, bottom, kind, does) in PACKAGES.items():
        style = {'boxstyle': 'round,pad=0,rounding_size=0.09', 'ec': SOFT, 'lw': 0.8}
        axes.add_patch(FancyBboxPatch((left, bottom), *BOX, fc=COLOURS[kind], **style))
        x, y = place(name)
        axes.text(x, y + 0.23, name, ha='center', va='center', size=10, weight='bold', color=INK)
        axes.text(x, y - 0.13, does, ha='center', va='center', size=7.6, color=INK)
    shells = FancyBboxPatch((0, 5.1), 9.7, 0.5, fc=COLOURS['shell'], **style)
    axes.add_patch(shells)
    axes.text(4.85, 5.35, SHELLS, ha='center', va='center', size=9.5, color=INK)
    FigureCanvasSVG(figure).print_svg(HERE / 'architecture.svg', metadata={'Date': None})


if __name__ == '__main__':
    main()
