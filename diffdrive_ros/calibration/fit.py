"""
From drives with a reference to the geometry of the robot, the noise of its wheels, and error bars.

Each drive gives poses of a marker on the robot, in a frame and a clock of their own. What odometry
would have said of them is linear, to first order, in what is unknown: the geometry, common to all
drives, as the marker's place on the robot is; the start pose and the offset of the clocks, of each
drive. The errors are not independent: the wheels' noise adds up along the drive. So the residuals
of a whole drive are weighed by their full covariance,

    C = travel C_travel + turn C_turn + separation^2 C_separation
        + position^2 C_position + heading^2 C_heading + time^2 C_time
        + slow_position^2 C_slow_position + slow_heading^2 C_slow_heading ,

the first two as Odometry propagates them; then, as one error a drive, by how much its separation
differs from that of all: tyres roll round a bend otherwise than they turn on the spot; then the
capture's own noise, the jitter of its stamps, and what it is off by for seconds. The sizes are
those that make the data the likeliest, the degrees of freedom that the fit takes away being
accounted for (restricted maximum likelihood: Patterson and Thompson, Biometrika 58, 1971). Poses
that the others contradict count less, by Huber's rule.
"""
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
import math

from diffdrive_ros.calibration.linearization import Linearization, linearize
from diffdrive_ros.core import se2
from diffdrive_ros.core.kinematics import DiffDrive
from diffdrive_ros.core.odometry import GeometryUncertainty, integrate, ORIGIN, WheelNoise
from diffdrive_ros.core.validation import Array, plausible
import numpy as np
from scipy import linalg, optimize
from scipy.stats import chi2

# Poses of the reference that are used of each drive, at equal distances along it. Neighbours of a
# dense reference share errors which no white noise describes; more of them would only feign.
POSES = 50

# A pose whose normalised squared deviation from what the others say is above this counts less.
HUBER = float(chi2.ppf(0.999, 3))

# A drive less likely than this, given the others, is left out.
OUTLIER = 1e-6
ROUGHER = 4.0  # or whose own noise is this many times that of the others, in variance
# A drive is judged in the directions in which it tells something, by information relative to that
# of the others. In the rest it says what the errors of the first order say.
TELLING = 0.01

# What cannot be known this well, relative to itself, is taken for not observed.
OBSERVED = 0.1

# How much the separation differs, relative to itself, between kinds of motion, if the drives show
# no more: those of one kind cannot. Borenstein and Feng (1996) speak of up to a hundredth.
KINDS = 0.003

# For how long the capture is off by about the same [s].
SLOWLY = 2.0

MEASURES = ('wheel_separation', 'left_wheel_radius', 'right_wheel_radius')

# A search that went further than this, in logarithms, is given up.
LOST = math.log(4.0)

# A geometry whose last step, relative to itself, is longer has not been found.
RESTLESS = 0.01

# Clocks that are further apart than this are not found: the offset has to be known beforehand [s].
CLOCKS = 0.5

USUAL = (': are the sides swapped, is a direction wrong, does a wheel not count, are angles in '
         'degrees or positions in mm, are the clocks more than '
         f'{CLOCKS:g} s apart, is the nominal geometry far off?')


class CalibrationError(ValueError):
    """The drives do not tell what is asked; the message says why."""


@dataclass(frozen=True)
class Drive:
    """
    A log: wheel angles [rad] and poses of a reference, both with stamps [s] of one clock.

    seconds, left, right: (N,), seconds growing. reference_seconds: (M,), growing; reference:
    (M, 3), the marker's poses in any frame, headings continuous or not. Raises CalibrationError.
    """

    name: str
    seconds: Array
    left: Array
    right: Array
    reference_seconds: Array
    reference: Array

    def __post_init__(self) -> None:
        for what, stamps in (('wheels', self.seconds), ('reference', self.reference_seconds)):
            if stamps.size < 2:
                raise CalibrationError(
                    f'{self.name}: the {what} have {stamps.size} samples: must be 2 or more')
            if not (np.diff(stamps) > 0.0).all():
                raise CalibrationError(f'{self.name}: stamps of the {what} must grow')
        inside = self.inside()
        if np.count_nonzero(inside) < 3:
            raise CalibrationError(
                f'{self.name}: the reference, from {self.reference_seconds[0]:.3f} to '
                f'{self.reference_seconds[-1]:.3f} s, does not overlap the wheels, from '
                f'{self.seconds[0]:.3f} to {self.seconds[-1]:.3f} s')
        if not self.travel()[-1] > 0.0:
            raise CalibrationError(f'{self.name}: the wheels do not turn')

    def inside(self) -> Array:
        """Return which poses of the reference are while the wheels are known, (M,) of bool."""
        stamps = self.reference_seconds
        inside: Array = (stamps >= self.seconds[0]) & (stamps <= self.seconds[-1])
        return inside

    def travel(self) -> Array:
        """Return how far both wheels together have turned until each sample [rad], (N,)."""
        steps = np.abs(np.diff(self.left)) + np.abs(np.diff(self.right))
        return np.concatenate([[0.0], np.cumsum(steps)])

    def thinned(self, count: int) -> 'Drive':
        """Return the drive with at most so many poses of its reference, evenly along the way."""
        inside = np.flatnonzero(self.inside())
        way = np.interp(self.reference_seconds[inside], self.seconds, self.travel())
        wanted = np.linspace(way[0], way[-1], count)
        chosen = inside[np.unique(np.minimum(np.searchsorted(way, wanted), len(inside) - 1))]
        chosen[-1] = inside[-1]
        return replace(
            self, reference_seconds=self.reference_seconds[chosen],
            reference=self.reference[chosen])


@dataclass(frozen=True)
class Terms:
    """What is estimated besides geometry and noise: offsets of clocks, the marker's place."""

    time_offset: bool = True
    marker: bool = True


@dataclass(frozen=True)
class DriveReport:
    """What the calibration says of one drive; residuals are (K, 3), at distances (K,) [m]."""

    name: str
    start: Array
    time_offset: float
    """How much later the wheels' clock is than the reference's [s]."""
    outlier: str
    """Why the drive was left out; '' if it was not."""
    metres: Array = field(repr=False)
    residuals: Array = field(repr=False)
    weights: Array = field(repr=False)


@dataclass(frozen=True)
class Calibration:
    """
    The geometry with its covariance, (3, 3), in the order of MEASURES, and the noise.

    separation_spread [m] is by how much the separation differs from drive to drive, 0 where they
    cannot tell. The capture's noise is of each pose, slow_ of what it is off by for seconds.
    not_observed says in words what the drives could not tell; it keeps its nominal value, and the
    noise of turns is 0 where nothing turns. marker is the pose of the marker in the body frame,
    and marker_std its deviations, (3,), 0 where it was not looked for.
    """

    drive: DiffDrive
    covariance: Array
    noise: WheelNoise
    separation_spread: float
    position_std: float
    heading_std: float
    time_std: float
    slow_position_std: float
    slow_heading_std: float
    marker: Array
    marker_std: Array
    not_observed: tuple[str, ...]
    drives: tuple[DriveReport, ...]

    @property
    def deviations(self) -> Array:
        """Return the deviations of the geometry [m], (3,); 0 for what was not observed."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def predictive_covariance(self) -> Array:
        """Return the covariance of the geometry of a drive to come, maybe of another kind."""
        covariance = self.covariance.copy()
        if covariance[0, 0]:
            covariance[0, 0] += max(self.separation_spread, KINDS * self.drive.wheel_separation)**2
        return covariance

    @property
    def uncertainty(self) -> GeometryUncertainty:
        """Return how well the geometry of a drive to come is known, for Odometry."""
        return GeometryUncertainty(*np.sqrt(np.diag(self.predictive_covariance)).tolist())

    @property
    def reference_std(self) -> tuple[float, float]:
        """Return the deviations of a pose of the reference, in position [m] and heading [rad]."""
        return (math.hypot(self.position_std, self.slow_position_std),
                math.hypot(self.heading_std, self.slow_heading_std))


def calibrate(
    drives: Sequence[Drive], nominal: DiffDrive, terms: Terms | None = None, *,
    keep_all: bool = False,
) -> Calibration:
    """
    Return the calibration by drives with a reference; outliers are left out unless keep_all.

    nominal is where the search starts, and what stays of what is not observed. Raises
    CalibrationError if there is nothing that the drives can tell.
    """
    if not drives:
        raise CalibrationError('no drives to calibrate by')
    terms = terms or Terms()
    outliers: dict[int, str] = {}
    while True:
        indices = [index for index in range(len(drives)) if index not in outliers]
        kept = [drives[index] for index in indices]
        # Of three, one does not contradict the others with any certainty.
        may_leave_out = not keep_all and len(kept) > max(3, 2 * len(drives) // 3)
        fit = _Fit(kept, nominal, terms)
        try:
            fit.find()
            if not fit.is_sound and (start := _rough(kept)):
                fit = _begun_at(start, kept, fit) or fit
            worst = fit.worst_drive() if may_leave_out else None
            if worst is None:
                fit.check()
                whole = _begun_at(fit.drive, drives, fit) if outliers else None
                if whole and whole.worst_drive() is None:  # it was the fit, not the drive
                    return whole.calibration(drives, {})
                return fit.calibration(drives, outliers)
        except CalibrationError as error:
            worst = _spoiler(kept, nominal, terms, str(error)) if may_leave_out else None
            if worst is None:
                raise
        outliers[indices[worst[0]]] = worst[1]


def _begun_at(start: DiffDrive, drives: Sequence[Drive], before: '_Fit') -> '_Fit | None':
    """Return a fit of drives from another start than before, if it gives all that is asked."""
    fit = _Fit(drives, before.nominal, before.terms, start)
    with suppress(CalibrationError):
        fit.find()
        if fit.is_sound and not fit.not_observed:
            return fit
    return None


def _spoiler(
    drives: Sequence[Drive], nominal: DiffDrive, terms: Terms, error: str,
) -> tuple[int, str] | None:
    """Return which drive alone keeps the others from a calibration, and why it is left out."""
    found = []
    for index in range(len(drives)):
        fit = _Fit([*drives[:index], *drives[index + 1:]], nominal, terms)
        with suppress(CalibrationError):
            fit.find()
            fit.check()
            found.append(index)
        if len(found) > 1:
            return None
    return (found[0], f'with it, {error.removesuffix(USUAL)}') if found else None


def clock_offset(drive: Drive, found: Calibration) -> float:
    """
    Return how much later the wheels' clock of a drive is, by a calibration that has not seen it.

    Start and offset [s] are fitted; geometry, marker and noise are those of the calibration.
    Raises CalibrationError if that finds no offset within CLOCKS.
    """
    fit = _Fit([drive], found.drive, Terms(marker=False))
    fit.free, fit.marker, fit.may_differ = (), found.marker, True
    fit.variances = np.array([
        found.noise.left_travel, found.noise.turn,
        (found.separation_spread / found.drive.wheel_separation)**2, found.position_std**2,
        found.heading_std**2, found.time_std**2, found.slow_position_std**2,
        found.slow_heading_std**2])
    (state,) = fit.states
    state.start = se2.compose(state.drive.reference[0], se2.inverse(found.marker))
    with suppress(np.linalg.LinAlgError):
        for _ in range(20):
            solution = fit.solve()
            fit.step(solution)
            if abs(solution.locals_[0][3]) < 1e-4:
                break
        if abs(state.time_offset) <= CLOCKS:
            return state.time_offset
    raise CalibrationError(f'{drive.name}: does not tell the offset of its clock')


# Logarithms of the separation, the mean radius and the ratio of the radii, which are estimated.
_CHOICES: tuple[tuple[tuple[int, ...], tuple[str, ...]], ...] = (
    ((0, 1, 2), ()),
    # Turns alone give the ratio of separation and radii; these are better known by hand.
    ((0, 2), ('the mean of the wheel radii: the drives go too little way to tell it',)),
    ((1, 2), ('wheel_separation, the noise of turns and the place of the marker: the drives turn '
              'too little to tell them',)),
    ((0,), ('the wheel radii: the drives turn on the spot, which tells the separation for these '
            'radii only',)),
    ((1,), ('wheel_separation and the ratio of the wheel radii: the drives are too short',)),
)

# Deviations of what is barely known beforehand; they keep the fit determinate where, as on a
# straight line, nothing tells an offset of the marker from another start.
_MARKER_PRIOR = (0.3, 0.3, 3.0)  # [m, m, rad]
_WITHOUT_TURNS = (1e-6, 1e-6, 3.0)  # its place is taken for that of the robot
_OFFSET_PRIOR = 0.2  # [s]

# Variances: where the search starts, and how far it goes at a time, in their logarithms.
_STARTS = np.array([5e-6, 5e-5, 1e-6, 1e-6, 1e-5, 1e-5, 1e-6, 1e-5])
_LEAP = math.log(4.0)
_LEAST = 0.02 * _STARTS

# What is found is not less: travel [m^2/m], turn [rad^2/rad], separation, position [m^2], heading
# [rad^2], time [s^2], slow position, slow heading.
FLOORS: tuple[float, ...] = tuple((_LEAST * math.exp(-_LEAP)).tolist())

_RATE = 0.02  # [s], over which the rate of the poses is taken

_STRIDE = 0.05  # [s], that the offset of a clock changes by at most in a step


@dataclass
class _State:
    """One drive within the fit."""

    drive: Drive
    start: Array
    time_offset: float
    weights: Array
    slips: Array
    """How much further than they turned the wheels seem to have travelled, (2, N) [m]."""


@dataclass(frozen=True)
class _Linear:
    """One drive's residuals, (n,), their derivatives, (n, locals + common), and components."""

    seconds: Array
    asked: list[int]
    linear: Linearization
    from_origin: Array
    residuals: Array
    local: Array
    common: Array
    components: Array  # (8, n, n)


@dataclass
class _Solution:
    """What the normal equations of all drives give."""

    common: Array  # the step
    information: Array
    covariance: Array
    locals_: list[Array]
    own_covariances: list[Array]  # of these, the common ones known
    normals: list[tuple[Array, Array]]  # of each drive, its own unknowns eliminated
    objective: float
    gradient: Array
    smooth: list[Array]  # C^-1 (e - J x) of each drive
    inverses: list[Array]  # C^-1 of each drive


class _Fit:
    """Gauss and Newton's steps for what is unknown, with the likeliest noise at each."""

    def __init__(
        self, drives: Sequence[Drive], nominal: DiffDrive, terms: Terms,
        start: DiffDrive | None = None,
    ) -> None:
        """Begin at start, or at the nominal geometry."""
        self.nominal, self.terms = nominal, terms
        start = start or nominal
        self.start = np.log([
            start.wheel_separation,
            math.sqrt(start.left_wheel_radius * start.right_wheel_radius),
            start.right_wheel_radius / start.left_wheel_radius])
        self.geometry = self.start.copy()
        self.marker: Array = np.zeros(3)
        self.variances = _STARTS.copy()
        self.free, self.not_observed = _CHOICES[0]
        self.may_differ = len(drives) > 1
        """Whether the separation may differ by drive: that of one alone is the common one."""
        self.turns = True
        """Whether the robot turns; without, nothing tells what its turns do."""
        thinned = [drive.thinned(POSES) for drive in drives]
        if terms.marker:
            self.marker[2] = _marker_heading(thinned, start)
        self.states = [_State(
            drive, se2.compose(drive.reference[0], se2.inverse(self.marker)), 0.0,
            np.ones(len(drive.reference)), np.zeros((2, len(drive.seconds)))) for drive in thinned]

    @property
    def drive(self) -> DiffDrive:
        """Return the geometry."""
        separation, radius, ratio = np.exp(self.geometry).tolist()
        return DiffDrive(separation, radius / math.sqrt(ratio), radius * math.sqrt(ratio))

    def find(self) -> None:
        """Find what is unknown; raises CalibrationError."""
        try:
            self._iterate()
        except (np.linalg.LinAlgError, FloatingPointError):
            raise CalibrationError(f'the fit fails on the numbers of the drives{USUAL}') from None

    def _iterate(self) -> None:
        """Iterate until the geometry stands still."""
        self._choose_what_is_observed()
        for _ in range(20):
            linears = [self._linear(state) for state in self.states]
            self.variances = self._likeliest(linears, self.states, _LEAP)
            self.solution = self._solve(linears, self.states, self.variances)
            self.step(self.solution)
            self._weigh(self.solution)
            self._smooth(self.solution, linears)
            small = 0.1 * np.sqrt(np.diag(self.solution.covariance))
            if (np.abs(self.solution.common) <= small).all() or self._is_lost():
                break
        self.linears = [self._linear(state) for state in self.states]
        self.solution = self._solve(self.linears, self.states, self.variances)

    def _is_lost(self) -> bool:
        """Return whether the geometry is far beyond what can be, from where none comes back."""
        return bool((np.abs(self.geometry - self.start) > LOST).any())

    @property
    def is_sound(self) -> bool:
        """Return whether what was found can be the robot that was driven."""
        with suppress(CalibrationError):
            self.check()
            return True
        return False

    def check(self) -> None:
        """Raise CalibrationError if what was found cannot be the robot that was driven."""
        for name in MEASURES:
            try:
                plausible(name, getattr(self.drive, name), getattr(self.nominal, name))
            except ValueError as error:
                raise CalibrationError(f'{error}{USUAL}') from None
        for state in self.states:
            if abs(state.time_offset) > CLOCKS:
                raise CalibrationError(
                    f'{state.drive.name}: time_offset = {state.time_offset:.3f} s: must be '
                    f'within {CLOCKS:g} s{USUAL}')
        worst = float(np.sqrt(np.diag(self.solution.covariance))[:len(self.free)].max())
        if worst > OBSERVED:
            raise CalibrationError(
                f'deviation of the geometry = {100.0 * worst:.0f} %: must be at most '
                f'{100.0 * OBSERVED:.0f} %{USUAL}')
        # Poses that are weighed anew may move it a little for ever.
        step = float(np.abs(self.solution.common[:len(self.free)]).max())
        if step > RESTLESS:
            raise CalibrationError(
                f'last step of the geometry = {100.0 * step:.2g} %: must be at most '
                f'{100.0 * RESTLESS:g} %{USUAL}')

    def _choose_what_is_observed(self) -> None:
        for self.free, self.not_observed in _CHOICES:
            try:
                solution = self.solve()
            except np.linalg.LinAlgError:
                continue
            if np.linalg.cond(_scaled(solution.information)) > 1e12:
                continue
            deviations = np.sqrt(np.diag(solution.covariance))[:len(self.free)]
            if (deviations < OBSERVED).all():
                self.turns = 0 in self.free
                return
        raise CalibrationError(
            'the drives tell neither the separation nor the radii of the wheels: they are too '
            'short, or the robot stood')

    def _linear(self, state: _State) -> _Linear:
        drive = state.drive
        seconds, left, right, asked = self._angles(state, state.time_offset)
        linear = linearize(self.drive, left, right, state.start, asked)
        poses, seen = linear.poses, se2.compose(linear.poses, self.marker)
        later, earlier = (
            self._seen(state, state.time_offset + 0.5 * lasts) for lasts in (_RATE, -_RATE))
        rate = (later - earlier) / _RATE
        # How an error of the body's pose, and of the marker on it, moves the marker.
        count = len(poses)
        moves = np.tile(np.eye(3), (count, 1, 1))
        moves[:, 0, 2], moves[:, 1, 2] = -(seen - poses)[:, 1], (seen - poses)[:, 0]
        geometry = moves @ linear.by_geometry @ _by_logarithms(self.drive)
        by_separation = geometry[:, :, 0].ravel()
        common, local = [geometry[:, :, self.free]], [moves @ linear.by_start]
        if self.terms.marker:
            turned = np.tile(np.eye(3), (count, 1, 1))
            cos, sin = np.cos(poses[:, 2]), np.sin(poses[:, 2])
            turned[:, 0, 0], turned[:, 0, 1] = cos, -sin
            turned[:, 1, 0], turned[:, 1, 1] = sin, cos
            common.append(turned)
        if self.terms.time_offset:
            local.append(rate[:, :, np.newaxis])
        residuals = drive.reference - seen
        residuals[:, 2] = se2.wrap_angle(residuals[:, 2])
        from_origin = moves @ linear.seen_from
        # The poses are those of wheels that slipped; the residuals are of wheels that did not.
        slips = np.diff([np.interp(seconds, drive.seconds, slip) for slip in state.slips]).T
        steps = np.einsum('mij,mj->mi', linear.by_steps[:, :, :2], slips)
        seen_slips = np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])[asked]
        residuals += np.einsum('kij,kj->ki', from_origin, seen_slips)
        position, heading = np.diag([1.0, 1.0, 0.0]), np.diag([0.0, 0.0, 1.0])
        apart = np.abs(np.subtract.outer(drive.reference_seconds, drive.reference_seconds))
        alike = np.exp(-apart / SLOWLY)
        components = np.stack([
            _walk(from_origin, linear.left_noise + linear.right_noise),
            _walk(from_origin, linear.turn_noise) * self.turns,
            np.outer(by_separation, by_separation) * self.may_differ,
            _blocks(np.tile(position, (count, 1, 1)), state.weights),
            _blocks(np.tile(heading, (count, 1, 1)), state.weights),
            _blocks(rate[:, :, np.newaxis] * rate[:, np.newaxis, :], state.weights),
            np.kron(alike, position),
            np.kron(alike, heading),
        ])
        rows = residuals.size
        return _Linear(
            seconds, asked, linear, from_origin, residuals.ravel(),
            np.concatenate(local, axis=-1).reshape(rows, -1),
            np.concatenate(common, axis=-1).reshape(rows, -1), components)

    def _seen(self, state: _State, offset: float) -> Array:
        """Return the poses of the marker at the stamps of the reference, (K, 3)."""
        _, left, right, asked = self._angles(state, offset)
        poses = integrate(self.drive, left, right, state.start)[asked]
        return se2.compose(poses, self.marker)

    def _angles(self, state: _State, offset: float) -> tuple[Array, Array, Array, list[int]]:
        """Return stamps and wheel angles with the slips, as _resampled."""
        drive, (left_slip, right_slip) = state.drive, state.slips
        return _resampled(replace(
            drive, left=drive.left + left_slip / self.drive.left_wheel_radius,
            right=drive.right + right_slip / self.drive.right_wheel_radius), offset)

    def _smooth(self, solution: _Solution, linears: list[_Linear]) -> None:
        """
        Set how the wheels seem to have slipped, given all that the reference says.

        Noise bends the way, and a bent way is shorter, which no derivative at the way that is not
        bent can tell. So the next derivatives are taken at the likeliest way.
        """
        travel, turn = self.variances[:2]
        for state, linear, smooth in zip(self.states, linears, solution.smooth, strict=True):
            pulls = np.einsum('kij,ki->kj', linear.from_origin, smooth.reshape(-1, 3))
            later: Array = np.zeros((len(linear.seconds), 3))
            np.add.at(later, linear.asked, pulls)
            # What a step does is seen by all poses after it.
            later = np.cumsum(later[::-1], axis=0)[::-1][1:]
            left, right, turned = (
                linear.linear.variances * [travel, travel, turn]
                * np.einsum('mij,mi->mj', linear.linear.by_steps, later)).T
            half = 0.5 * self.drive.wheel_separation * turned
            for side, slip in enumerate((left - half, right + half)):
                total = np.concatenate([[0.0], np.cumsum(slip)])
                state.slips[side] = np.interp(state.drive.seconds, linear.seconds, total)

    def _likeliest(self, linears: list[_Linear], states: list[_State], leap: float) -> Array:
        """
        Return the variances that are the likeliest, by some or all of the drives.

        Their logarithms go from where they are by no more than leap.
        """
        def objective(logarithms: Array) -> tuple[float, Array]:
            variances = np.exp(logarithms)
            solution = self._solve(linears, states, variances)
            return solution.objective, solution.gradient * variances

        # One that was tiny while the geometry was still wrong could not leave there by itself.
        tried = np.log(np.maximum(self.variances, _LEAST))
        found = optimize.minimize(
            objective, tried, jac=True, method='L-BFGS-B',
            bounds=[(max(each - leap, math.log(floor)), each + leap)
                    for each, floor in zip(tried.tolist(), FLOORS, strict=True)],
            options={'maxiter': 40, 'ftol': 1e-7})
        return np.exp(found.x)

    def _solve(
        self, linears: list[_Linear], states: list[_State], variances: Array,
    ) -> _Solution:
        """Return the generalised least squares for given variances, and how likely they are."""
        size = linears[0].common.shape[1]
        information, right_side = np.zeros((size, size)), np.zeros(size)
        if self.terms.marker:
            prior = 1.0 / np.square(_MARKER_PRIOR if self.turns else _WITHOUT_TURNS)
            information[-3:, -3:] += np.diag(prior)
            right_side[-3:-1] -= prior[:2] * self.marker[:2]
        objective, parts, normals = 0.0, [], []
        for linear, state in zip(linears, states, strict=True):
            inverse, determinant = _inverse(np.tensordot(variances, linear.components, 1))
            derivatives = np.concatenate([linear.local, linear.common], axis=1)
            weighed = inverse @ derivatives
            own = linear.local.shape[1]
            normal, side = derivatives.T @ weighed, weighed.T @ linear.residuals
            if self.terms.time_offset:
                normal[own - 1, own - 1] += 1.0 / _OFFSET_PRIOR**2
                side[own - 1] -= state.time_offset / _OFFSET_PRIOR**2
            own_inverse = np.linalg.inv(normal[:own, :own])
            eliminated = own_inverse @ np.column_stack([side[:own], normal[:own, own:]])
            normals.append((
                normal[own:, own:] - normal[own:, :own] @ eliminated[:, 1:],
                side[own:] - normal[own:, :own] @ eliminated[:, 0]))
            information += normals[-1][0]
            right_side += normals[-1][1]
            objective += (
                determinant - np.linalg.slogdet(own_inverse)[1]
                + linear.residuals @ inverse @ linear.residuals - side[:own] @ eliminated[:, 0])
            parts.append((inverse, derivatives, weighed, own_inverse, eliminated))
        covariance = np.asarray(np.linalg.inv(information), dtype=np.float64)
        common = covariance @ right_side
        objective += np.linalg.slogdet(information)[1] - right_side @ common
        gradient = np.zeros(len(variances))
        locals_, smooth = [], []
        for linear, (inverse, derivatives, weighed, own_inverse, eliminated) in zip(
                linears, parts, strict=True):
            local = eliminated[:, 0] - eliminated[:, 1:] @ common
            locals_.append(local)
            unknown = np.concatenate([local, common])
            smooth.append(inverse @ (linear.residuals - derivatives @ unknown))
            across = -eliminated[:, 1:] @ covariance
            joint = np.block([
                [own_inverse - across @ eliminated[:, 1:].T, across], [across.T, covariance]])
            moved = linear.components @ weighed
            gradient += (
                np.tensordot(linear.components, inverse, 2)
                - np.tensordot(moved, weighed @ joint, 2)
                - (linear.components @ smooth[-1]) @ smooth[-1])
        return _Solution(
            common, information, covariance, locals_, [part[3] for part in parts], normals,
            float(objective), gradient, smooth, [part[0] for part in parts])

    def solve(self) -> _Solution:
        """Return what the drives say where the search is now."""
        return self._solve(
            [self._linear(state) for state in self.states], self.states, self.variances)

    def step(self, solution: _Solution) -> None:
        """Go where a solution says that all is."""
        free = list(self.free)
        self.geometry[free] += np.clip(solution.common[:len(free)], -0.3, 0.3)
        if self.terms.marker:
            self.marker = self.marker + solution.common[-3:]
        for state, local, covariance in zip(
                self.states, solution.locals_, solution.own_covariances, strict=True):
            if self.terms.time_offset:
                # An offset goes not all the way at once, and the start goes with it: on a circle
                # one can stand in for the other.
                offset = np.clip(local[3], -_STRIDE, _STRIDE)
                local = local + covariance[3] / covariance[3, 3] * (offset - local[3])
                state.time_offset += float(offset)
            state.start = state.start + local[:3]

    def _weigh(self, solution: _Solution) -> None:
        """Let poses count less that contradict what all the others say of them."""
        for state, inverse, smooth in zip(
                self.states, solution.inverses, solution.smooth, strict=True):
            count = len(state.weights)
            blocks = inverse.reshape(count, 3, count, 3)[np.arange(count), :, np.arange(count)]
            alone = smooth.reshape(count, 3)
            # Deviation from the others' prediction, blocks^-1 smooth, by its covariance blocks^-1.
            squares = np.einsum(
                'ki,ki->k', alone, np.linalg.solve(blocks, alone[:, :, np.newaxis])[:, :, 0])
            state.weights = np.minimum(1.0, HUBER / np.maximum(squares, 1e-9))

    def worst_drive(self) -> tuple[int, str] | None:
        """
        Return which drive fits the others the least, and why it is an outlier, if it is.

        Each is judged by the geometry and the noise of the others, which it has no part in.
        """
        found: list[tuple[float, int, str]] = []
        for index in range(len(self.states)):
            with suppress(np.linalg.LinAlgError):
                found += self._contradictions(index)
        return max(found)[1:] if found else None

    def _contradictions(self, index: int) -> list[tuple[float, int, str]]:
        """Return how badly the drive with this index fits the others, the index and why; or []."""
        linear, state = self.linears[index], self.states[index]
        linears, states = (
            [*each[:index], *each[index + 1:]] for each in (self.linears, self.states))
        # Far from those of all, which this drive may have spoilt.
        variances = self._likeliest(linears, states, 8.0 * _LEAP)
        # Others of one kind of motion cannot tell how far another kind may differ.
        variances[2] = max(variances[2], KINDS**2)
        others = self._solve(linears, states, variances)
        if (np.sqrt(np.diag(others.covariance))[:len(self.free)] > OBSERVED).any():
            return []  # it is the only one that tells a measure
        alone = self._solve([linear], [state], variances)
        own, side = alone.normals[0]
        root = np.linalg.cholesky(others.covariance)
        told, directions = np.linalg.eigh(root.T @ own @ root)
        without = directions.T @ root.T @ (side - own @ others.common)
        tells = told > TELLING
        surprise = float((without**2 / (told + told**2))[tells].sum())
        odds = float(chi2.sf(surprise, np.count_nonzero(tells))) * len(self.linears)
        unexplained = linear.residuals - linear.common @ others.common
        inverse = alone.inverses[0]
        weighed = inverse @ linear.local
        explained = weighed.T @ unexplained
        ratio = float(
            unexplained @ inverse @ unexplained
            - explained @ np.linalg.solve(linear.local.T @ weighed, explained)
            # What the others do not know of the geometry is no noise of this drive.
            - (without**2 / (1.0 + told)).sum())
        ratio /= len(unexplained)
        if ratio > ROUGHER:
            return [(100.0 * ratio, index,
                     f'its residuals have {ratio:.0f} times the variance of the others')]
        if odds < OUTLIER:
            return [(surprise, index, 'it contradicts the others on the geometry')]
        return []

    def calibration(self, drives: Sequence[Drive], outliers: dict[int, str]) -> Calibration:
        """Return what was found; drives are all of them, with the outliers by index."""
        free, solution, drive = list(self.free), self.solution, self.drive
        by_logarithms = _by_logarithms(drive)[:, free]
        covariance = by_logarithms @ solution.covariance[:len(free), :len(free)] @ by_logarithms.T
        travel, turn, *squares = self.variances.tolist()
        separation, position, heading, time, slow_position, slow_heading = map(math.sqrt, squares)
        states = iter(self.states)
        has_marker = self.terms.marker
        return Calibration(
            drive=drive, covariance=covariance,
            noise=WheelNoise(travel, travel, turn if self.turns else 0.0),
            separation_spread=(
                separation * drive.wheel_separation if self.may_differ and 0 in free else 0.0),
            position_std=position,
            heading_std=heading, time_std=time, slow_position_std=slow_position,
            slow_heading_std=slow_heading, marker=self.marker,
            marker_std=(
                np.sqrt(np.diag(solution.covariance)[-3:])
                * [self.turns, self.turns, True] if has_marker else np.zeros(3)),
            not_observed=self.not_observed,
            drives=tuple(
                _left_out(whole, outliers[index]) if index in outliers
                else self._report(next(states)) for index, whole in enumerate(drives)))

    def _report(self, state: _State) -> DriveReport:
        state = replace(state, slips=np.zeros_like(state.slips))
        residuals = state.drive.reference - self._seen(state, state.time_offset)
        residuals[:, 2] = se2.wrap_angle(residuals[:, 2])
        radius = 0.25 * (self.drive.left_wheel_radius + self.drive.right_wheel_radius)
        metres = radius * np.interp(
            state.drive.reference_seconds, state.drive.seconds, state.drive.travel())
        return DriveReport(
            state.drive.name, state.start, state.time_offset, '', metres, residuals,
            state.weights)


def _left_out(drive: Drive, why: str) -> DriveReport:
    return DriveReport(
        drive.name, np.array(ORIGIN), 0.0, why, np.zeros(0), np.zeros((0, 3)), np.zeros(0))


def _by_logarithms(drive: DiffDrive) -> Array:
    """Return the derivatives of MEASURES by the logarithms that are estimated, (3, 3)."""
    left, right = drive.left_wheel_radius, drive.right_wheel_radius
    return np.array([
        [drive.wheel_separation, 0.0, 0.0], [0.0, left, -0.5 * left], [0.0, right, 0.5 * right]])


def _resampled(drive: Drive, offset: float) -> tuple[Array, Array, Array, list[int]]:
    """Return stamps and wheel angles, also at the reference's stamps, and which these are."""
    asked = np.clip(drive.reference_seconds + offset, drive.seconds[0], drive.seconds[-1])
    seconds = np.union1d(drive.seconds, asked)
    return (
        seconds, np.interp(seconds, drive.seconds, drive.left),
        np.interp(seconds, drive.seconds, drive.right), np.searchsorted(seconds, asked).tolist())


def _rough(drives: Sequence[Drive]) -> DiffDrive | None:
    """
    Return about the geometry of drives that turn and go, whatever is believed of it; or None.

    Headings are linear in the angles of the wheels, by radii over separation; how far the robot
    goes then gives the separation. Marker, clocks and noise are passed over.
    """
    angles, headings, goes = [], [], []
    for index, drive in enumerate(drives):
        inside = drive.inside()
        drive = replace(
            drive, reference=drive.reference[inside],
            reference_seconds=drive.reference_seconds[inside])
        _, left, right, asked = _resampled(drive, 0.0)
        own = np.zeros((len(asked), len(drives)))
        own[:, index] = 1.0
        # Not thinned before, or headings would turn too far between two to be unwrapped.
        few = np.linspace(0, len(asked) - 1, min(len(asked), POSES)).astype(int)
        angles.append(np.column_stack([-left[asked], right[asked], own])[few])
        headings.append(np.unwrap(drive.reference[:, 2])[few])
        goes.append(np.hypot(*np.diff(drive.reference[few, :2], axis=0).T))
    matrix, turned = np.concatenate(angles), np.concatenate(headings)
    # As the sum of errors, and not of their squares, would have it: one drive may be wrong.
    ratios = optimize.least_squares(
        lambda unknown: matrix @ unknown - turned, np.zeros(matrix.shape[1]),
        lambda unknown: matrix, loss='soft_l1', f_scale=0.1).x[:2]
    if not (ratios > 0.0).all():
        return None
    arcs = np.concatenate([
        0.5 * np.diff(each[:, :2], axis=0) @ [-ratios[0], ratios[1]] for each in angles])
    turns = np.concatenate([np.diff(each) for each in headings])
    chords = np.abs(arcs * np.sinc(0.5 * turns / math.pi))
    far = (chords >= np.median(chords)) & (chords > 0.0)
    separation = float(np.median(np.concatenate(goes)[far] / chords[far])) if far.any() else 0.0
    if not separation > 0.0:
        return None
    left_radius, right_radius = (ratios * separation).tolist()
    return DiffDrive(separation, left_radius, right_radius)


def _marker_heading(drives: Sequence[Drive], nominal: DiffDrive) -> float:
    """Return about how far the marker is turned against the robot, from where both go."""
    product = 0.0 + 0.0j
    for drive in drives:
        _, left, right, asked = _resampled(drive, 0.0)
        moves = []
        for poses in (integrate(nominal, left, right)[asked], drive.reference):
            x, y, _ = se2.between(poses[:-1], poses[1:]).T
            moves.append(x + 1j * y)
        product += np.vdot(moves[1], moves[0])
    return float(np.angle(product))


def _walk(from_origin: Array, noise: Array) -> Array:
    """Return the covariance of all poses, (3 K, 3 K), of errors that add up, (K, 3, 3)."""
    count = len(noise)
    common = noise[np.minimum.outer(np.arange(count), np.arange(count))]
    blocks = from_origin[:, np.newaxis] @ common @ from_origin.transpose(0, 2, 1)[np.newaxis]
    matrix: Array = blocks.transpose(0, 2, 1, 3).reshape(3 * count, 3 * count)
    return matrix


def _blocks(blocks: Array, weights: Array) -> Array:
    """Return a covariance, (3 K, 3 K), of errors that are each pose's own, (K, 3, 3)."""
    count = len(blocks)
    matrix = np.zeros((count, 3, count, 3))
    each = np.arange(count)
    matrix[each, :, each, :] = blocks / weights[:, np.newaxis, np.newaxis]
    return matrix.reshape(3 * count, 3 * count)


def _inverse(covariance: Array) -> tuple[Array, float]:
    """Return the inverse of a covariance and the logarithm of its determinant; or LinAlgError."""
    factor, info = linalg.lapack.dpotrf(covariance, lower=1)
    if info != 0:
        raise np.linalg.LinAlgError('the residuals have no valid covariance')
    inverse, _ = linalg.lapack.dpotri(factor, lower=1)
    inverse = inverse + np.tril(inverse, -1).T  # it has but its lower triangle
    return inverse, 2.0 * float(np.log(np.diag(factor)).sum())


def _scaled(matrix: Array) -> Array:
    """Return a matrix with a diagonal of ones."""
    size = np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    scaled: Array = matrix / size / size[:, np.newaxis]
    return scaled
