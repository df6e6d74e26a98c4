"""Nodes in ROS 2: the only modules that import rclpy."""

import os
import re

from vio_eval_ros.errors import MissingPackage, VioEvalError

#: releases of ROS 2 before Jazzy, whose rclpy lacks what the nodes use
TOO_OLD = ('foxy', 'galactic', 'humble', 'iron')
PACKAGES_OF_ROS = re.compile(r'rclpy|rpyutils|rosidl|\w+_(msgs|srvs|interfaces)\b')


def without_ros(error: ImportError) -> VioEvalError:
    """Return what is wrong with the installation where a node cannot be imported."""
    release = os.environ.get('ROS_DISTRO', '')
    if release in TOO_OLD:
        return VioEvalError(
            f'ROS 2 {release.capitalize()} is too old: evaluator and play need Jazzy or newer; '
            'the other verbs need no ROS'
        )
    if error.name and not PACKAGES_OF_ROS.match(error.name):
        return MissingPackage(error)
    return VioEvalError(
        f'ROS 2 is missing ({error}); source an installation of it, or pip install '
        "'vio_eval_ros[ros]'"
    )
