"""
Known truth: a simulated flight, the estimate of a visual-inertial odometry, and its IMU.

The errors of the estimate are known exactly, because they are put in here: for the demo, the
tests and anyone who wants to try a gate.
"""

from vio_eval_ros.simulation.drift import Drift
from vio_eval_ros.simulation.faults import FAULTS
from vio_eval_ros.simulation.formats import write_recording
from vio_eval_ros.simulation.simulated_run import at_rest, simulate, SimulatedRun

__all__ = ['FAULTS', 'Drift', 'SimulatedRun', 'at_rest', 'simulate', 'write_recording']
