"""The noise of an IMU as a table, as JSON, as Kalibr's imu.yaml and as a plot."""

from __future__ import annotations

import io
import json
import math

import numpy as np

from vio_eval_ros.errors import ConfigError
from vio_eval_ros.imu.allan import CONFIDENCE
from vio_eval_ros.imu.analysis import Analysis, KALIBR
from vio_eval_ros.imu.fit import CONSTANT, Fit, Parameter, PARAMETERS, SI

COLOURS = ('tab:red', 'tab:green', 'tab:blue')
DEFAULT_TOPIC = '/imu0'


def json_document(analysis: Analysis) -> str:
    """Return all that was found, in schema ``vio_eval_ros.imu_noise/1``."""
    return json.dumps(analysis.to_dict(), indent=2, allow_nan=False) + '\n'


def table(analysis: Analysis) -> str:
    """Return the table printed on a terminal."""
    lines = [f'{analysis.source}: {record_line(analysis)}']
    for kind in SI:
        headings = [quantity.label for quantity in PARAMETERS.values()]
        units = [f'[{quantity.units[kind]}]' for quantity in PARAMETERS.values()]
        lines += [
            '',
            f'{kind:<9}' + ''.join(f'{heading:<35}' for heading in headings) + 'fitted τ [s]',
            ' ' * 9 + ''.join(f'{unit:<35}' for unit in units),
        ]
        for name, axis in analysis.axes.items():
            if not name.startswith(kind):
                continue
            cells = ''
            for attribute in PARAMETERS:
                cells += f'{cell(getattr(axis.fit, attribute)):<35}'
            lines.append(f'{name[-1]:<9}{cells}{fitted_range(axis.fit)}')
    lines += ['', f'in brackets: {100 * CONFIDENCE:.0f} % confidence interval']
    lines += [f'null: {", ".join(names)}: {reason}' for reason, names in reasons(analysis).items()]
    lines += [f'warning: {warning}' for warning in analysis.warnings]
    return '\n'.join(lines) + '\n'


def reasons(analysis: Analysis, kind: str = '') -> dict[str, list[str]]:
    """Return why parameters are not known, and the axes for which they are not."""
    found: dict[str, list[str]] = {}
    for name, axis in analysis.axes.items():
        for attribute, quantity in PARAMETERS.items():
            reason = getattr(axis.fit, attribute).reason
            if reason and name.startswith(kind):
                found.setdefault(f'{quantity.label}: {reason}', []).append(name)
    return found


def record_line(analysis: Analysis) -> str:
    """Return number, duration and rate of the samples."""
    signal = analysis.signal
    return (
        f'{signal.counts.samples:,} samples, '
        f'{signal.duration_s / 3600:.3g} h at {signal.rate_hz * signal.averaged:.5g} Hz'
        + (f', averaged by {signal.averaged}' if signal.averaged > 1 else '')
    )


def kalibr_document(analysis: Analysis) -> str:
    """
    Return Kalibr's ``imu.yaml``, with the largest value of the three axes.

    :raises ConfigError: where a value is not known.
    """
    signal = analysis.signal
    lines = [
        f'# Measured by vio_eval_ros on {signal.duration_s / 3600:.3g} h at rest; each value is',
        '# the largest of three axes. Motion, temperature and vibration add to it: estimators',
        '# are usually given 5 to 10 times these figures, or more.',
    ]
    for key, what in KALIBR.items():
        value = analysis.largest(*what)
        if value is None:
            reason = next(analysis.parameters(*what)).reason
            if reason == CONSTANT:
                reason += (
                    f' on {analysis.topic or analysis.source}; where each sensor has a topic of '
                    'its own, measure both with --topic and put the four values into one file'
                )
            raise ConfigError(f'{key} is not known: {reason}')
        lines.append(f'{key}: {value!r}')
    rate_hz = signal.rate_hz * signal.averaged
    topic = json.dumps(analysis.topic or DEFAULT_TOPIC)
    lines += [f'rostopic: {topic}', f'update_rate: {round(rate_hz, 3)!r}']
    return '\n'.join(lines) + '\n'


def plot(analysis: Analysis) -> bytes:
    """Return a PNG of the Allan deviations and their fits; this needs matplotlib."""
    # most runs draw nothing
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12, 5.5), layout='constrained')
    FigureCanvasAgg(figure)
    for kind, panel in zip(SI, figure.subplots(1, 2), strict=True):
        axes = [axis for name, axis in analysis.axes.items() if name.startswith(kind)]
        for axis, letter, colour in zip(axes, 'xyz', COLOURS, strict=True):
            fit = axis.fit
            taus_s, (low, high) = axis.curve.taus_s, axis.band
            # logarithmic axes have no place for the zeros of a constant value
            deviations = np.where(axis.curve.deviations > 0, axis.curve.deviations, np.nan)
            panel.loglog(taus_s, deviations, colour, label=letter)
            panel.fill_between(taus_s, low, high, color=colour, alpha=0.15, linewidth=0)
            if fit.range_s:
                used = (taus_s >= fit.range_s[0]) & (taus_s <= fit.range_s[1])
                panel.loglog(taus_s[used], fit.deviations[used], '--', color=colour, linewidth=1)
        panel.set(
            title=f'{kind}: overlapping Allan deviation, fit dashed',
            xlabel='averaging time τ [s]',
            ylabel=SI[kind].replace('s2', 's²'),
        )
        panel.grid(which='both', alpha=0.2)
        panel.legend()
    figure.suptitle(analysis.source)
    png = io.BytesIO()
    figure.savefig(png, format='png', dpi=100)
    return png.getvalue()


def cell(parameter: Parameter) -> str:
    """Return a value with its interval, or a dash and its upper limit."""
    if math.isnan(parameter.value):
        return '-' if math.isnan(parameter.high) else f'- (at most {parameter.high:.3g})'
    return f'{parameter.value:.4g} ({parameter.low:.4g} to {parameter.high:.4g})'


def fitted_range(fit: Fit) -> str:
    """Return the first and last averaging time fitted."""
    return f'{fit.range_s[0]:.3g} to {fit.range_s[1]:.4g}' if fit.range_s else '-'
