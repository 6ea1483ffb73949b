"""What the log of one vehicle says, on the clock and in the frame of the log."""

from collections.abc import Collection, Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from dataclasses import dataclass, field, replace
import os

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...errors import (
    describe_error, LogFileError, MissingPackageError, name_missing_package, PlanningError)
from ...mission.validation import Array, find_runs
from ...plan.tracking import LONGEST_GAP

_BACKWARDS_S = 1.0  # Samples may come in another order within this time.
_JUMP_M = 1.0  # Least jump of a position that is noticed.
_NOISE = 8.0  # A jump is larger than this factor times the median irregularity of a log.
_AGILITY = 20.0  # Largest acceleration in m/s^2 that is no jump.
_SAME_S = 1e-6  # Times that differ by less are equal.
_SHORT_S = 0.2  # A shorter step with a jump is no gap.
_SAME_JUMP_S = 0.5  # A jump that a log tells is noticed in its positions within this time.

Samples = tuple[Array, Array]
"""Times (K,) in s of the log's clock, and values at these times, (K, ...)."""


@dataclass(frozen=True, eq=False)
class VehicleLog:
    """
    Positions of one vehicle, and what else its log says.

    :param times: (K,) in s of the log's clock, increasing.
    :param positions: (K, 3) in m: east, north and up from the origin of the log's frame; up is NaN
        in a log without heights.
    :param velocities: (K, 2) in m/s, NaN where unknown, or None.
    :param utc_offset: UTC in s less the log's clock, or None.
    :param reference: latitude and longitude in degrees of the origin of the log's frame, or None.
    :param jumps: times in s of the last samples before the frame or its estimate changes; jumps
        of the positions are added.
    :param powers: times, and powers really set in W; None if the log has none.
    :param battery: times, and energy in J taken from the battery since the log began, or None.
    :param setpoints: times, and positions (K, 2) in m that the autopilot was asked for, or None.
    :param plan_times: times in s of the log's clock and of the plan from its point 0, (K,) each,
        or None.
    :param notes: what a reader of the comparison should know.
    :raises LogFileError: for fewer than two positions, or times that run back.
    """

    times: Array
    positions: Array
    velocities: Array | None = None
    utc_offset: float | None = None
    reference: tuple[float, float] | None = None
    jumps: tuple[float, ...] = ()
    powers: Samples | None = None
    battery: Samples | None = None
    setpoints: Samples | None = None
    plan_times: Samples | None = None
    notes: tuple[str, ...] = field(default=())

    def __post_init__(self) -> None:
        """Drop samples without a position or not later than all before; find further jumps."""
        times, positions = np.asarray(self.times, float), np.asarray(self.positions, float)
        valid = np.isfinite(times) & np.isfinite(positions[:, :2]).all(axis=1)
        latest = np.maximum.accumulate(times[valid])  # Latest time up to each sample.
        worst = int(np.argmax(latest - times[valid])) if len(latest) else 0
        if len(latest) and latest[worst] - times[valid][worst] > _BACKWARDS_S:
            raise LogFileError(f'its time runs back from {latest[worst]:.1f} s to '
                               f'{times[valid][worst]:.1f} s')
        valid[valid] = np.append(True, np.diff(latest) > 0)[:len(latest)]
        if np.count_nonzero(valid) < 2:
            raise LogFileError(f'it has {np.count_nonzero(valid)} valid positions; it must have 2')
        object.__setattr__(self, 'times', times[valid])
        object.__setattr__(self, 'positions', positions[valid])
        if self.velocities is not None:
            object.__setattr__(self, 'velocities', np.asarray(self.velocities, float)[valid])
        for name in ('powers', 'battery', 'setpoints'):
            object.__setattr__(self, name, _drop_unknown(getattr(self, name)))
        seen = [time for time in _find_jumps(self.times, self.positions)
                if all(abs(time - told) > _SAME_JUMP_S for told in self.jumps)]
        object.__setattr__(self, 'jumps', tuple(sorted({*self.jumps, *seen})))

    def move(self, shift: ArrayLike) -> 'VehicleLog':
        """Return the log with (x, y) [m] added to its positions and setpoints."""
        shift = np.append(np.asarray(shift, float), 0.0)
        setpoints = self.setpoints
        if setpoints is not None:
            setpoints = setpoints[0], setpoints[1] + shift[:2]
        return replace(self, positions=self.positions + shift, setpoints=setpoints)

    def positions_at(self, times: Array) -> Array:
        """Return positions (L, 3) in m at times of the log's clock; NaN in gaps."""
        positions = _interpolate(times, self.times, self.positions)
        positions[~self._covers(times)] = np.nan
        return positions

    def velocities_at(self, times: Array) -> Array:
        """
        Return velocities (L, 2) in m/s at times of the log's clock.

        :param times: increasing, (L,) in s.
        :return: velocities of the log, or differences of positions where it has none; NaN in
            gaps, and for differences at jumps, too.
        """
        positions = self.positions_at(times)[:, :2]
        velocities = np.asarray(np.gradient(positions, times, axis=0))
        for jump in self.jumps:  # A difference takes in both neighbours of a time.
            velocities[np.abs(times - jump) <= 2 * np.diff(times).max()] = np.nan
        if self.velocities is not None:
            told = _interpolate(times, self.times, self.velocities)
            velocities = np.where(np.isnan(told), velocities, told)
            velocities[np.isnan(positions[:, 0])] = np.nan
        return velocities

    def _covers(self, times: Array) -> NDArray[np.bool_]:
        """Return whether times (L,) [s] are at a sample, or between two samples without a gap."""
        steps = np.diff(self.times)
        is_whole = steps <= LONGEST_GAP
        # A step longer than LONGEST_GAP is a gap, and so is one over _SHORT_S with a jump.
        jumps = np.searchsorted(self.times, self.jumps, 'right') - 1
        jumps = jumps[(jumps >= 0) & (jumps < len(steps))]
        is_whole[jumps[steps[jumps] > _SHORT_S]] = False
        index = np.clip(np.searchsorted(self.times, times, 'right') - 1, 0, len(steps) - 1)
        distance = np.abs(times - self.times[[index, index + 1]]).min(axis=0)  # [s]
        is_inside = (times >= self.times[0]) & (times <= self.times[-1]) & is_whole[index]
        return np.asarray(is_inside | (distance < _SAME_S))


def _drop_unknown(samples: Samples | None) -> Samples | None:
    """Return the samples without NaN; None if none is left."""
    if samples is None:
        return None
    times, values = samples
    known = np.isfinite(values) if values.ndim == 1 else np.isfinite(values).all(axis=1)
    return (times[known], values[known]) if known.any() else None


def _interpolate(times: Array, samples: Array, values: Array) -> Array:
    """Return values (K, D) of samples at times (L,), (L, D)."""
    return np.stack([np.interp(times, samples, column) for column in values.T], axis=-1)


def _find_jumps(times: Array, positions: Array) -> list[float]:
    """
    Return the times in s of the samples after which the position jumps.

    The error of a step of s seconds is |move - s * mean velocity of both neighbours|. A step is a
    jump if its error is the largest of three adjacent errors, and is above
    max(_JUMP_M, _NOISE * median error) + _AGILITY * s^2.
    """
    if len(times) < 4:
        return []
    steps = np.diff(times)
    moves = np.diff(positions[:, :2], axis=0)
    velocities = (moves[:-2] + moves[2:]) / (steps[:-2] + steps[2:])[:, None]
    errors = np.linalg.norm(moves[1:-1] - velocities * steps[1:-1, None], axis=1)
    allowed = max(_JUMP_M, _NOISE * float(np.median(errors))) + _AGILITY * steps[1:-1]**2
    # A jump also gives the steps beside it an error, of half of the jump.
    is_largest = errors >= np.maximum(np.append(0.0, errors[:-1]), np.append(errors[1:], 0.0))
    return [float(time) for time in times[1:-2][(errors > allowed) & is_largest]]


def describe_mode(mode: str, times: Array, is_active: NDArray[np.bool_]) -> tuple[str, ...]:
    """Return one note of when a mode was active; is_active[k] holds from times[k] [s] on."""
    spans = [f'{times[first]:.1f} to {times[min(end, len(times) - 1)]:.1f} s'
             for first, end in find_runs(is_active)]
    if not spans:
        return (f'it was never in {mode}',)
    return (f'in {mode} from {" and from ".join(spans)} of the log',)


@contextmanager
def silence() -> Iterator[None]:
    """Discard Python's output, and standard error of compiled libraries, in the with statement."""
    with open(os.devnull, 'w') as nowhere, redirect_stdout(nowhere), redirect_stderr(nowhere):
        errors = os.dup(2)  # Compiled libraries print to file 2 itself.
        os.dup2(nowhere.fileno(), 2)
        try:
            yield
        finally:
            os.dup2(errors, 2)
            os.close(errors)


def check_magic(path: str | os.PathLike[str], offset: int, magics: Collection[bytes]) -> None:
    """
    Refuse a file without one of `magics` at an offset: its library would search it byte by byte.

    :raises LogFileError: for other bytes at the offset; all magics have the same length.
    """
    with open(path, 'rb') as file:
        begin = file.read(offset + max(map(len, magics)))
    if begin[offset:] not in magics:
        raise LogFileError('it is empty' if not begin else 'it does not begin as such a log does')


@contextmanager
def refuse_damage(path: str | os.PathLike[str]) -> Iterator[None]:
    """
    Turn an error inside the with statement into a LogFileError that names the file.

    A MemoryError stays as it is.

    :raises MissingPackageError: when the library is not installed.
    """
    try:
        with name_missing_package():
            yield
    except (MissingPackageError, MemoryError):
        raise
    except OSError as error:
        raise LogFileError(f'{path} cannot be read: {error.strerror or error}') from None
    except PlanningError as error:
        raise LogFileError(f'{path}: {error}') from None
    except Exception as error:  # A library may raise anything for a damaged file.
        raise LogFileError(
            f'{path} cannot be read as a log: {describe_error(error)}') from None
