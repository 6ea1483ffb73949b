"""What the log of one vehicle says, on the clock and in the frame of the log."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
import os

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...errors import describe_error, LogFileError, name_missing_package, PlanningError
from ...mission.scenario import Array

LONGEST_GAP_S = 1.0
"""Time without a position beyond which a log does not cover the flight."""

Samples = tuple[Array, Array]
"""Times (K,) in s of the log's clock, and values at these times, (K, ...)."""


@dataclass(frozen=True, eq=False)
class VehicleLog:
    """
    Positions of one vehicle, and what else its log says.

    :param times: (K,) in s of the log's clock, increasing.
    :param positions: (K, 3) in m: east, north and up from the origin of the log's frame.
    :param velocities: (K, 3) in m/s, or None.
    :param utc_offset: UTC in s less the log's clock, or None.
    :param reference: latitude and longitude in degrees of the origin of the log's frame, or None.
    :param jumps: times in s after which positions jump, as the frame or its estimate changed.
    :param powers: times, and powers really set in W; None if the log has none.
    :param battery: times, and energy in J taken from the battery since the log began, or None.
    :param setpoints: times, and positions (K, 2) in m that the autopilot was asked for, or None.
    :param plan_times: times in s of the log's clock and of the plan from its point 0, (K,) each,
        or None.
    :param notes: what a reader of the comparison should know.
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
        times, positions = np.asarray(self.times, float), np.asarray(self.positions, float)
        kept = np.isfinite(times) & np.isfinite(positions).all(axis=1)
        kept[kept] = np.append(True, np.diff(np.maximum.accumulate(times[kept])) > 0)[:kept.sum()]
        if np.count_nonzero(kept) < 2:
            raise LogFileError('it has fewer than two positions')
        object.__setattr__(self, 'times', times[kept])
        object.__setattr__(self, 'positions', positions[kept])
        if self.velocities is not None:
            object.__setattr__(self, 'velocities', np.asarray(self.velocities, float)[kept])

    def move(self, shift: ArrayLike) -> 'VehicleLog':
        """Return the log with its frame moved by (x, y) in m."""
        shift = np.append(np.asarray(shift, float), 0.0)
        setpoints = self.setpoints
        if setpoints is not None:
            setpoints = setpoints[0], setpoints[1] + shift[:2]
        return replace(self, positions=self.positions + shift, setpoints=setpoints)

    @property
    def is_covered(self) -> NDArray[np.bool_]:
        """Tell which intervals between samples have no gap and no jump, (K - 1,)."""
        covered: NDArray[np.bool_] = np.diff(self.times) <= LONGEST_GAP_S
        covered[np.searchsorted(self.times, self.jumps, 'right')[
            np.isin(self.jumps, self.times[:-1])] - 1] = False
        return covered


@contextmanager
def refuse_damage(path: str | os.PathLike[str]) -> Iterator[None]:
    """
    Raise whatever a library raises while it reads a log as a LogFileError that names the file.

    :raises MissingPackageError: when the library is not installed.
    """
    try:
        with name_missing_package():
            yield
    except LogFileError as error:
        raise LogFileError(f'{path}: {error}') from None
    except (PlanningError, OSError, MemoryError):
        raise
    except Exception as error:  # A library may raise anything for a damaged file.
        raise LogFileError(
            f'{path} cannot be read as a log: {describe_error(error)}') from None
