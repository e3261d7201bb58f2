"""
Calibrate a robot by recorded runs with a reference: its geometry, its noise, and their error bars.

Each run gives poses of a marker on the robot, in a frame and a clock of their own. Gauss and
Newton's steps find the unknowns (residuals.py), with the likeliest noise at each (likelihood.py);
outliers weigh less or are left out (outliers.py).
"""
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
import math

from diffdrive_ros.calibration import initial_guess
from diffdrive_ros.calibration.covariance import START_VARIANCES
from diffdrive_ros.calibration.likelihood import likeliest_variances, Solution, solve
from diffdrive_ros.calibration.model import (
    Calibration,
    check_geometry,
    Run,
    RunReport,
    Terms,
)
from diffdrive_ros.calibration.outliers import MAX_RELATIVE_STD, weigh_poses, worst_outlier
from diffdrive_ros.calibration.residuals import (
    by_logarithms,
    Estimate,
    logarithms,
    report_of,
    Residuals,
    residuals_of,
    RunState,
)
from diffdrive_ros.core import se2
from diffdrive_ros.core.kinematics import DiffDrive
from diffdrive_ros.core.odometry import WheelNoise
from diffdrive_ros.core.validation import Array, UserError
import numpy as np

# A search that moved a logarithm of the geometry further than this has diverged.
MAX_LOG_CHANGE = math.log(4.0)

# A geometry whose last step, relative to itself, is longer than this has not converged.
MAX_LAST_STEP = 0.01

# A larger clock offset is rejected [s].
MAX_CLOCK_OFFSET_S = 0.5
MAX_CLOCK_OFFSET_STEP_S = 0.05

COMMON_CAUSES = (
    'are the sides swapped, is a direction wrong, does a wheel not count, are angles in degrees '
    f'or positions in mm, is the clock offset above {MAX_CLOCK_OFFSET_S:g} s, is the nominal '
    'geometry far off?')


def calibrate(
    runs: Sequence[Run], nominal: DiffDrive, terms: Terms | None = None, *,
    keep_all: bool = False,
) -> Calibration:
    """
    Return the calibration from runs with a reference; outliers are left out unless keep_all.

    nominal is where the search starts, and the value of what is unobservable. Raises UserError if
    the runs determine nothing.
    """
    if not runs:
        raise UserError('no runs to calibrate from')
    terms = terms or Terms()
    outliers: dict[int, str] = {}
    while True:
        indices = [index for index in range(len(runs)) if index not in outliers]
        kept = [runs[index] for index in indices]
        # Of three runs, one does not contradict the others with any certainty.
        may_leave_out = not keep_all and len(kept) > max(3, 2 * len(runs) // 3)
        fit = _Fit(kept, nominal, terms)
        try:
            fit.find()
            if not fit.is_sound and (start := initial_guess.geometry_of(kept)):
                fit = _refitted(start, kept, fit) or fit
            worst = fit.worst_outlier() if may_leave_out else None
            if worst is None:
                fit.check()
                whole = _refitted(fit.estimate.drive, runs, fit) if outliers else None
                if whole and whole.worst_outlier() is None:  # the fit was wrong, not the run
                    return whole.calibration(runs, {})
                return fit.calibration(runs, outliers)
        except UserError as error:
            worst = _failing_run(kept, nominal, terms, str(error)) if may_leave_out else None
            if worst is None:
                raise
        outliers[indices[worst[0]]] = worst[1]


def _refitted(start: DiffDrive, runs: Sequence[Run], before: '_Fit') -> '_Fit | None':
    """Return a fit of runs from another start than before; None unless it gives everything."""
    fit = _Fit(runs, before.nominal, before.estimate.terms, start)
    with suppress(UserError):
        fit.find()
        if fit.is_sound and not fit.unobservable:
            return fit
    return None


def _failing_run(
    runs: Sequence[Run], nominal: DiffDrive, terms: Terms, error: str,
) -> tuple[int, str] | None:
    """Return the index of the only run without which the fit succeeds, and the error with it."""
    found = []
    for index in range(len(runs)):
        fit = _Fit([*runs[:index], *runs[index + 1:]], nominal, terms)
        with suppress(UserError):
            fit.find()
            fit.check()
            found.append(index)
        if len(found) > 1:
            return None
    return (found[0], f'with it, {error.removesuffix(COMMON_CAUSES)}') if found else None


def estimate_clock_offset(run: Run, calibration: Calibration) -> float:
    """
    Return the clock offset of a run [s], as RunReport.clock_offset, by a calibration without it.

    Start and offset are fitted; geometry, marker and noise are those of the calibration. Raises
    UserError if there is no offset within MAX_CLOCK_OFFSET_S.
    """
    fit = _Fit([run], calibration.drive, Terms(marker=False))
    noise = calibration.noise
    fit.estimate = replace(
        fit.estimate, free=(), marker=calibration.marker, has_spread=True, variances=np.array([
            noise.left_travel, noise.turn,
            (calibration.separation_spread / calibration.drive.wheel_separation)**2,
            calibration.position_std**2, calibration.heading_std**2, calibration.time_std**2,
            calibration.slow_position_std**2, calibration.slow_heading_std**2]))
    (state,) = fit.states
    state.start = se2.compose(state.run.reference[0], se2.inverse(calibration.marker))
    with suppress(np.linalg.LinAlgError):
        for _ in range(20):
            solution = fit.solve()
            fit.step(solution)
            if abs(solution.own[0][3]) < 1e-4:
                break
        if abs(state.clock_offset) <= MAX_CLOCK_OFFSET_S:
            return state.clock_offset
    raise UserError(f'{run.name}: does not determine its clock offset')


# Indices of the geometry's logarithms that are estimated, from all to few, and what is not.
_OBSERVABLE: tuple[tuple[tuple[int, ...], tuple[str, ...]], ...] = (
    ((0, 1, 2), ()),
    # Turns alone give the ratio of separation and radii; these are better known by hand.
    ((0, 2), ('the mean of the wheel radii: the runs travel too little',)),
    ((1, 2), (
        'wheel_separation, the noise of turns and the position of the marker: the runs turn too '
        'little',)),
    ((0,), (
        'the wheel radii: the runs turn on the spot, which gives the separation for these radii '
        'only',)),
    ((1,), ('wheel_separation and the ratio of the wheel radii: the runs are too short',)),
)


class _Fit:
    """Gauss and Newton's steps for the unknowns, with the likeliest noise at each."""

    def __init__(
        self, runs: Sequence[Run], nominal: DiffDrive, terms: Terms,
        start: DiffDrive | None = None,
    ) -> None:
        """Begin at start, or at the nominal geometry."""
        self.nominal, start = nominal, start or nominal
        self.start = logarithms(start)
        free, self.unobservable = _OBSERVABLE[0]
        thinned = [run.thinned(initial_guess.POSES) for run in runs]
        marker = np.zeros(3)
        if terms.marker:
            marker[2] = initial_guess.marker_heading(thinned, start)
        self.estimate = Estimate(
            self.start.copy(), marker, START_VARIANCES.copy(), free, terms, turns=True,
            has_spread=len(runs) > 1)
        self.states = [RunState(
            run, se2.compose(run.reference[0], se2.inverse(marker)), 0.0,
            np.ones(len(run.reference)), np.zeros((2, len(run.seconds)))) for run in thinned]

    def find(self) -> None:
        """Find the unknowns; raises UserError."""
        try:
            self._iterate()
        except (np.linalg.LinAlgError, FloatingPointError):
            raise UserError(f'the fit fails on the numbers of the runs: {COMMON_CAUSES}') from None

    def _iterate(self) -> None:
        """Iterate until the geometry converges."""
        estimate = self.estimate
        self._choose_observable()
        for _ in range(20):
            residuals = self._residuals()
            estimate.variances = likeliest_variances(residuals, self.states, estimate)
            self.solution = solve(residuals, self.states, estimate, estimate.variances)
            self.step(self.solution)
            weigh_poses(self.states, self.solution)
            self._smooth(self.solution, residuals)
            small = 0.1 * np.sqrt(np.diag(self.solution.covariance))
            has_diverged = (np.abs(estimate.geometry - self.start) > MAX_LOG_CHANGE).any()
            if (np.abs(self.solution.common) <= small).all() or has_diverged:
                break
        self.residuals = self._residuals()
        self.solution = solve(self.residuals, self.states, estimate, estimate.variances)

    def _residuals(self) -> list[Residuals]:
        return [residuals_of(state, self.estimate) for state in self.states]

    @property
    def is_sound(self) -> bool:
        """Return whether check passes."""
        with suppress(UserError):
            self.check()
            return True
        return False

    def check(self) -> None:
        """Raise UserError if the result cannot be that of the robot in the runs."""
        check_geometry(self.estimate.drive, self.nominal, COMMON_CAUSES)
        for state in self.states:
            if abs(state.clock_offset) > MAX_CLOCK_OFFSET_S:
                raise UserError(
                    f'{state.run.name}: clock_offset = {state.clock_offset:.3f} s: must be '
                    f'within {MAX_CLOCK_OFFSET_S:g} s: {COMMON_CAUSES}')
        worst = float(self.estimate.relative_std(self.solution.covariance).max())
        if worst > MAX_RELATIVE_STD:
            raise UserError(
                f'standard deviation of the geometry = {100.0 * worst:.0f} %: must be at most '
                f'{100.0 * MAX_RELATIVE_STD:.0f} %: {COMMON_CAUSES}')
        # New weights of the poses may move it a little for ever.
        step = float(np.abs(self.solution.common[:len(self.estimate.free)]).max())
        if step > MAX_LAST_STEP:
            raise UserError(
                f'last step of the geometry = {100.0 * step:.2g} %: must be at most '
                f'{100.0 * MAX_LAST_STEP:g} %: {COMMON_CAUSES}')

    def _choose_observable(self) -> None:
        for self.estimate.free, self.unobservable in _OBSERVABLE:
            try:
                solution = self.solve()
            except np.linalg.LinAlgError:
                continue
            # The condition of the information with a diagonal of ones.
            size = np.sqrt(np.maximum(np.diag(solution.information), 1e-300))
            if np.linalg.cond(solution.information / size / size[:, np.newaxis]) > 1e12:
                continue
            if (self.estimate.relative_std(solution.covariance) < MAX_RELATIVE_STD).all():
                self.estimate.turns = 0 in self.estimate.free
                return
        raise UserError(
            'the runs determine neither the wheel separation nor the wheel radii: they are too '
            'short, or the robot stood still')

    def _smooth(self, solution: Solution, residuals: Sequence[Residuals]) -> None:
        """
        Set the likeliest slip of the wheels, given the whole reference.

        Noise bends the path, and a bent path is shorter, which the derivatives at an unbent path
        do not contain. So the next derivatives are taken at the likeliest path.
        """
        travel, turn = self.estimate.variances[:2]
        for state, each, weighted in zip(self.states, residuals, solution.weighted, strict=True):
            pulls = np.einsum('kij,ki->kj', each.from_origin, weighted.reshape(-1, 3))
            later: Array = np.zeros((len(each.seconds), 3))
            np.add.at(later, each.indices, pulls)
            # All later poses contain a step.
            later = np.cumsum(later[::-1], axis=0)[::-1][1:]
            left, right, turned = (
                each.linear.variances * [travel, travel, turn]
                * np.einsum('mij,mi->mj', each.linear.by_steps, later)).T
            half = 0.5 * self.estimate.drive.wheel_separation * turned
            for side, slip in enumerate((left - half, right + half)):
                total = np.concatenate([[0.0], np.cumsum(slip)])
                state.slip[side] = np.interp(state.run.seconds, each.seconds, total)

    def solve(self) -> Solution:
        """Return the solution at the present estimate."""
        return solve(self._residuals(), self.states, self.estimate, self.estimate.variances)

    def step(self, solution: Solution) -> None:
        """Move the unknowns by a solution."""
        estimate = self.estimate
        free = list(estimate.free)
        estimate.geometry[free] += np.clip(solution.common[:len(free)], -0.3, 0.3)
        if estimate.terms.marker:
            estimate.marker = estimate.marker + solution.common[-3:]
        for state, own, covariance in zip(
                self.states, solution.own, solution.own_covariances, strict=True):
            if estimate.terms.clock_offset:
                # An offset is limited in its step, and the start follows it: on a circle one can
                # stand in for the other.
                offset = np.clip(own[3], -MAX_CLOCK_OFFSET_STEP_S, MAX_CLOCK_OFFSET_STEP_S)
                own = own + covariance[3] / covariance[3, 3] * (offset - own[3])
                state.clock_offset += float(offset)
            state.start = state.start + own[:3]

    def worst_outlier(self) -> tuple[int, str] | None:
        """Return the index of the run that contradicts the others the most, and how; or None."""
        return worst_outlier(self.residuals, self.states, self.estimate)

    def calibration(self, runs: Sequence[Run], outliers: dict[int, str]) -> Calibration:
        """Return the result; runs are all of them, with the outliers by index."""
        estimate, solution = self.estimate, self.solution
        free, drive = list(estimate.free), estimate.drive
        derivatives = by_logarithms(drive)[:, free]
        travel, turn, *squares = estimate.variances.tolist()
        separation, position, heading, time, slow_position, slow_heading = map(math.sqrt, squares)
        states = iter(self.states)
        return Calibration(
            drive=drive,
            covariance=derivatives @ solution.covariance[:len(free), :len(free)] @ derivatives.T,
            noise=WheelNoise(travel, travel, turn if estimate.turns else 0.0),
            separation_spread=(
                separation * drive.wheel_separation if estimate.has_spread and 0 in free else 0.0),
            position_std=position, heading_std=heading, time_std=time,
            slow_position_std=slow_position, slow_heading_std=slow_heading,
            marker=estimate.marker, marker_std=(
                np.sqrt(np.diag(solution.covariance)[-3:])
                * [estimate.turns, estimate.turns, True]
                if estimate.terms.marker else np.zeros(3)),
            unobservable=self.unobservable,
            runs=tuple(
                RunReport(run.name, 0.0, outliers[index], np.zeros(0), np.zeros((0, 3)))
                if index in outliers else report_of(next(states), estimate)
                for index, run in enumerate(runs)))
