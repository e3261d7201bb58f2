"""The text of the equations has the numbers of the core."""
import re

from diffdrive_ros.core.kinematics import DiffDrive
from diffdrive_ros.core.se2 import transform
from diffdrive_ros.dashboard.equations import equations, homogeneous
import numpy as np
import pytest

DRIVE = DiffDrive(0.317, 0.0471, 0.0533)


def numbers(text, name, rows):
    """Return the matrix of a name in the text."""
    lines = text.splitlines()
    first = next(i for i, line in enumerate(lines) if re.match(rf'{re.escape(name)} =$', line))
    return [[float(each) for each in re.findall(r'-?\d+\.\d+', line)]
            for line in lines[first + 1:first + 1 + rows]]


def test_equations_have_the_jacobians():
    text = equations(DRIVE, (0.4, -0.3, 0.7), (2.0, 5.0))
    assert np.allclose(numbers(text, 'H', 2), DRIVE.wheel_jacobian, atol=1e-4)
    assert np.allclose(numbers(text, 'H⁺', 3), DRIVE.body_jacobian, atol=1e-4)


def test_homogeneous_matrix_transforms_as_the_pose():
    pose, point = (0.4, -0.3, 0.7), (1.1, 0.2)
    assert (homogeneous(pose) @ [*point, 1.0])[:2] == pytest.approx(transform(pose, point))


def test_equations_have_the_twist_of_the_wheels():
    linear, angular = DRIVE.body_twist(2.0, 5.0)
    assert f"V_b = H⁺ φ' = ({linear:.3f}, 0, {angular:.3f}) m/s, rad/s" in equations(
        DRIVE, (0.0, 0.0, 0.0), (2.0, 5.0))


def test_equations_have_no_minus_zero():
    text = equations(DRIVE, (-1e-5, -1e-5, -1e-5), (-1e-4, -1e-4))
    assert not re.search(r'-0\.0+\b', text)
