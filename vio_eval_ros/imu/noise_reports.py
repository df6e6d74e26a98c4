"""The noise of an IMU as a table, as JSON, as Kalibr's imu.yaml and as a plot."""

from __future__ import annotations

import io
import json
import math
from typing import Any

import numpy as np

from vio_eval_ros.core.statistics import without_nan
from vio_eval_ros.errors import ConfigError
from vio_eval_ros.imu.allan import CONFIDENCE, interval
from vio_eval_ros.imu.analysis import Analysis, Axis
from vio_eval_ros.imu.fit import Fit, NAMES, Parameter
from vio_eval_ros.version import __version__

SCHEMA = 'vio_eval_ros.imu_noise/1'
UNIT = {'gyro': 'rad/s', 'accel': 'm/s2'}
# attribute of a fit: its name, unit of each kind, and the τ [s] at which its line is read
PARAMETERS = {
    'density': (NAMES['density'], {'gyro': 'rad/s/sqrt(Hz)', 'accel': 'm/s2/sqrt(Hz)'}, 1.0),
    'instability': (NAMES['instability'], UNIT, None),
    'walk': (NAMES['walk'], {'gyro': 'rad/s2/sqrt(Hz)', 'accel': 'm/s3/sqrt(Hz)'}, 3.0),
}
KALIBR = {
    'accelerometer_noise_density': ('accel', 'density'),
    'accelerometer_random_walk': ('accel', 'walk'),
    'gyroscope_noise_density': ('gyro', 'density'),
    'gyroscope_random_walk': ('gyro', 'walk'),
}
COLOURS = ('tab:red', 'tab:green', 'tab:blue')


def json_document(analysis: Analysis) -> str:
    """Return all that was found, in schema ``vio_eval_ros.imu_noise/1``."""
    signal = analysis.signal
    document = {
        'schema': SCHEMA,
        'tool': {'name': 'vio_eval_ros', 'version': __version__},
        'input': {
            'source': analysis.source,
            'first_stamp_ns': signal.first_ns,
            'duration_s': signal.duration_s,
            'rate_hz': signal.rate_hz * signal.averaged,
            'averaged': signal.averaged,
            'segments': len(signal.segments),
            'counts': vars(signal.counts),
            'units': {kind: unit._asdict() for kind, unit in analysis.units.items()},
        },
        'confidence': CONFIDENCE,
        'axes': {name: _axis(name, axis) for name, axis in analysis.axes.items()},
        'kalibr': {key: largest(analysis, *what) for key, what in KALIBR.items()},
        'warnings': analysis.warnings,
    }
    return json.dumps(without_nan(document), indent=2, allow_nan=False) + '\n'


def table(analysis: Analysis) -> str:
    """Return what a person reads on a terminal."""
    lines = [f'{analysis.source}: {record_line(analysis)}']
    for kind in UNIT:
        headings = [f'{name.replace("_", " ")}' for name, _, _ in PARAMETERS.values()]
        units = [f'[{unit[kind]}]' for _, unit, _ in PARAMETERS.values()]
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
    """Return why parameters are not known, and of which axes."""
    found: dict[str, list[str]] = {}
    for name, axis in analysis.axes.items():
        for attribute, (label, _, _) in PARAMETERS.items():
            reason = getattr(axis.fit, attribute).reason
            if reason and name.startswith(kind):
                found.setdefault(f'{label.replace("_", " ")}: {reason}', []).append(name)
    return found


def record_line(analysis: Analysis) -> str:
    """Return how long the record is, and at which rate."""
    signal = analysis.signal
    return (
        f'{signal.counts.samples:,} samples, '
        f'{signal.duration_s / 3600:.3g} h at {signal.rate_hz * signal.averaged:.5g} Hz'
        + (f', averaged by {signal.averaged}' if signal.averaged > 1 else '')
    )


def kalibr_document(analysis: Analysis, topic: str) -> str:
    """
    Return Kalibr's ``imu.yaml``, with the largest value of the three axes.

    :param topic: of the IMU, as Kalibr will find it.
    :raises ConfigError: where a value is not known.
    """
    signal = analysis.signal
    lines = [
        f'# Measured by vio_eval_ros on {signal.duration_s / 3600:.3g} h at rest; each is the',
        '# largest of three axes. Motion, temperature and vibration add to it: estimators are',
        '# usually given 5 to 10 times these figures, or more.',
    ]
    for key, what in KALIBR.items():
        value = largest(analysis, *what)
        if value is None:
            reason = next(_parameters(analysis, *what)).reason
            raise ConfigError(f'{key} is not known: {reason}')
        lines.append(f'{key}: {value!r}')
    rate_hz = signal.rate_hz * signal.averaged
    lines += [f'rostopic: {json.dumps(topic)}', f'update_rate: {round(rate_hz, 3)!r}']
    return '\n'.join(lines) + '\n'


def plot(analysis: Analysis) -> bytes:
    """Return a PNG of the Allan deviations and their fits; this needs matplotlib."""
    # imported here, since most runs draw nothing
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12, 5.5), layout='constrained')
    FigureCanvasAgg(figure)
    for kind, panel in zip(UNIT, figure.subplots(1, 2), strict=True):
        axes = [axis for name, axis in analysis.axes.items() if name.startswith(kind)]
        for axis, letter, colour in zip(axes, 'xyz', COLOURS, strict=True):
            fit = axis.fit
            taus_s, (low, high) = axis.curve.taus_s, band(axis)
            # a value that never changes has no place on logarithmic axes
            deviations = np.where(axis.curve.deviations > 0, axis.curve.deviations, np.nan)
            panel.loglog(taus_s, deviations, colour, label=letter)
            panel.fill_between(taus_s, low, high, color=colour, alpha=0.15, linewidth=0)
            if fit.range_s:
                used = (taus_s >= fit.range_s[0]) & (taus_s <= fit.range_s[1])
                panel.loglog(taus_s[used], fit.deviations[used], '--', color=colour, linewidth=1)
        panel.set(
            title=f'{kind}: overlapping Allan deviation, fit dashed',
            xlabel='averaging time τ [s]',
            ylabel=UNIT[kind].replace('s2', 's²'),
        )
        panel.grid(which='both', alpha=0.2)
        panel.legend()
    figure.suptitle(analysis.source)
    png = io.BytesIO()
    figure.savefig(png, format='png', dpi=100)
    return png.getvalue()


def largest(analysis: Analysis, kind: str, attribute: str) -> float | None:
    """Return the largest known value of the three axes, None where none is known."""
    values = [parameter.value for parameter in _parameters(analysis, kind, attribute)]
    known = [value for value in values if not math.isnan(value)]
    return max(known, default=None)


def _parameters(analysis: Analysis, kind: str, attribute: str) -> Any:
    return (
        getattr(axis.fit, attribute)
        for name, axis in analysis.axes.items()
        if name.startswith(kind)
    )


def cell(parameter: Parameter) -> str:
    """Return a value with its interval, or a dash and what is known of it."""
    if math.isnan(parameter.value):
        return '-' if math.isnan(parameter.high) else f'- (at most {parameter.high:.3g})'
    return f'{parameter.value:.4g} ({parameter.low:.4g} to {parameter.high:.4g})'


def fitted_range(fit: Fit) -> str:
    """Return which averaging times were fitted."""
    return f'{fit.range_s[0]:.3g} to {fit.range_s[1]:.4g}' if fit.range_s else '-'


def _axis(name: str, axis: Axis) -> dict[str, Any]:
    kind, curve, fit = name.partition('_')[0], axis.curve, axis.fit
    low, high = band(axis)
    lowest = int(np.argmin(curve.deviations)) if len(curve.deviations) else None
    return {
        'unit': UNIT[kind],
        'mean': axis.mean,
        'parameters': {
            label: {
                **vars(getattr(fit, attribute)),
                'unit': unit[kind],
                'read_at_tau_s': tau_s,
            }
            for attribute, (label, unit, tau_s) in PARAMETERS.items()
        },
        'fit_range_s': fit.range_s,
        'lowest': None
        if lowest is None
        else {
            'deviation': float(curve.deviations[lowest]),
            'tau_s': float(curve.taus_s[lowest]),
        },
        'misfit': fit.misfit and dict(zip(('ratio', 'tau_s'), fit.misfit, strict=True)),
        'ramp': fit.ramp,
        'curve': {
            'tau_s': curve.taus_s.tolist(),
            'deviation': curve.deviations.tolist(),
            'low': low.tolist(),
            'high': high.tolist(),
            'fit': fit.deviations.tolist(),
            'terms': curve.terms.tolist(),
        },
    }


def band(axis: Axis) -> tuple[np.ndarray, np.ndarray]:
    """Return the confidence interval of each deviation."""
    if np.isnan(axis.fit.scatter).any():
        nothing = np.full(len(axis.curve.deviations), np.nan)
        return nothing, nothing
    pairs = [
        interval(deviation, 1 / (2 * scatter**2))
        for deviation, scatter in zip(axis.curve.deviations, axis.fit.scatter, strict=True)
    ]
    low, high = np.array(pairs).T
    return low, high
