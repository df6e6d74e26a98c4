"""
What an estimate and its ground truth settle between them: how each was meant to be read.

A text file does not say the unit of its stamps or positions, nor, often, the order of its
quaternions. Two sides of one run do: only under the right reading do they agree. Where they do not
tell, the rule of the layout holds, or the user is asked; what the user states is never changed.
"""

from __future__ import annotations

from vio_eval_ros.core.config import EvaluationConfig
from vio_eval_ros.recordings.agreement.held import with_held_orientations
from vio_eval_ros.recordings.agreement.lengths import with_units_of_positions
from vio_eval_ros.recordings.agreement.orders import with_orders
from vio_eval_ros.recordings.agreement.origins import with_one_origin
from vio_eval_ros.recordings.agreement.pairs import Sides
from vio_eval_ros.recordings.agreement.stamps import with_units_of_stamps
from vio_eval_ros.recordings.agreement.weights import with_weights
from vio_eval_ros.recordings.publishers import of_one_publisher
from vio_eval_ros.recordings.sources import Source


def settled(estimate: Source, truth: Source, config: EvaluationConfig | None = None) -> Sides:
    """
    Return both sides as they were meant, with a sentence for whatever was taken.

    :param config: its offset is added to the stamps of the estimate.
    :raises ReadError: something is open that the two do not settle; the message says what to
        state.
    :raises ConfigError: weights are asked for where they have no effect.
    """
    config = config or EvaluationConfig()
    sides = with_units_of_stamps((estimate, truth), config)
    sides = with_orders(sides, config)
    sides = with_units_of_positions(sides, config)
    sides = with_one_origin(with_held_orientations(sides, config), config)
    return with_weights(sides, config)


def comparable(estimate: Source, truth: Source, config: EvaluationConfig) -> Sides:
    """
    Return both sides as they are compared: as they were meant, and each of one publisher.

    :raises ReadError: the two do not settle how they are read, or poses of several publishers take
        turns in one of them.
    :raises ConfigError: weights are asked for where they have no effect.
    """
    return of_one_publisher(*settled(estimate, truth, config), config)


def assumed(estimate: Source, truth: Source) -> tuple[str, ...]:
    """Return what was taken for granted when both sides were read, each sentence once."""
    return tuple(dict.fromkeys([*estimate.warnings, *truth.warnings]))
