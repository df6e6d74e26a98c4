"""
Known truth: a simulated flight, what a visual-inertial odometry makes of it, and its IMU.

The demo, the tests and anyone who wants to try a gate know exactly how wrong the estimate is,
because it was made wrong here.
"""

from vio_eval_ros.simulation.drift import Drift
from vio_eval_ros.simulation.faults import FAULTS
from vio_eval_ros.simulation.formats import write_recording
from vio_eval_ros.simulation.simulated_run import at_rest, simulate, SimulatedRun

__all__ = ['FAULTS', 'Drift', 'SimulatedRun', 'at_rest', 'simulate', 'write_recording']
