"""The node's parameters that a calibration gives."""
from collections.abc import Sequence
from dataclasses import astuple

from diffdrive_ros.calibration.end_pose import EndPoseCalibration
from diffdrive_ros.calibration.model import Calibration, GEOMETRY_PARAMETERS
from diffdrive_ros.core.kinematics import DiffDrive
from diffdrive_ros.core.odometry_config import OdometryConfig
import numpy as np

# Standard deviations of the geometry as measured with a ruler [m].
RULER_STD_M = (0.002, 0.0001, 0.0001)


def from_runs(
    calibration: Calibration, before: OdometryConfig, nominal: DiffDrive,
) -> dict[str, float]:
    """
    Return the parameters by a calibration; nominal is the geometry without multipliers.

    What is unobservable keeps its uncertainty of before, or has that of a ruler.
    """
    noise = calibration.noise
    stds = [
        std or old or ruler for std, old, ruler in zip(
            astuple(calibration.uncertainty), astuple(before.geometry_uncertainty), RULER_STD_M,
            strict=True)]
    return _parameters(
        nominal, calibration.drive, stds, left_wheel_travel_variance=noise.left_travel,
        right_wheel_travel_variance=noise.right_travel,
        turn_variance=noise.turn or before.noise.turn)


def from_end_poses(calibration: EndPoseCalibration, nominal: DiffDrive) -> dict[str, float]:
    """Return the parameters by end poses; their uncertainty is at least that of a ruler."""
    stds = np.maximum(np.sqrt(np.diag(calibration.covariance)), RULER_STD_M).tolist()
    return _parameters(nominal, calibration.drive, stds)


def _parameters(
    nominal: DiffDrive, drive: DiffDrive, stds: Sequence[float], **noise: float,
) -> dict[str, float]:
    """Return the multipliers of the nominal geometry, the noise and the deviations, rounded."""
    parameters = {
        **{f'{name}_multiplier': getattr(drive, name) / getattr(nominal, name)
           for name in GEOMETRY_PARAMETERS},
        **noise,
        **{f'{name}_std': std for name, std in zip(GEOMETRY_PARAMETERS, stds, strict=True)}}
    return {name: float(f'{value:.9g}') for name, value in parameters.items()}
