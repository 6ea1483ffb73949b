"""The numbers that the alternating method was tuned with."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Schedule:
    """How far and in what order the alternating method goes."""

    tolerance: float = 1e-5
    """A round of all steps that gains less than this, in bit/s/Hz, is the last."""

    powers_tolerance: float = 1e-7
    """The same for steps of powers alone."""

    max_rounds: int = 100
    """The most rounds."""

    power_steps: int = 3
    """Steps of Section III-A before each step of Section III-B."""

    stretch: float = 2.0
    """The factor by which a step is made longer while the true rate rises."""
