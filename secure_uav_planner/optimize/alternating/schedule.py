"""
The numbers that the alternating method was tuned with.

What is said of them was measured on six missions: the paper's with T = 102 s and 102 slots, 200 s
and 100, 120 s and 60 with an error radius of 30 m, and three of bench.missions with 60 slots, all
from fly-hover-fly. Rates are means over the missions, in bit/s/Hz, and times those of the CPU.
"""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Schedule:
    """How far and in what order the alternating method goes."""

    tolerance: float = 1e-5
    """
    A round of all steps that gains less than this, in bit/s/Hz, is the last.

    1e-4 takes 17% less time and loses 1e-4, at most 4e-4 in a mission; 1e-6 takes 25% more and
    gains 2e-5.
    """

    powers_tolerance: float = 1e-7
    """
    The same for steps of powers alone.

    They are a baseline of their own, so they go as far as they can. As the start of the whole
    method alone, 1e-5 would take 21% less time and gain 1e-3, nearly all of it in one mission.
    """

    max_rounds: int = 100
    """The most rounds; none of the missions ended at this limit."""

    power_steps: int = 3
    """
    Steps of Section III-A before each step of Section III-B.

    They cost a fifth of the latter. From the same start, one, two and five of them end with
    2.8600, 2.8576 and 2.8569 where three end with 2.8574, and take 4 to 9% more time.
    """

    stretch: float = 2.0
    """
    The factor by which a step is made longer while the true rate rises.

    1.5 loses 2e-3 and takes 10% less time. Steps that are not made longer, as in the paper, lose
    2e-2 and take 3.6 times as long.
    """

    compile_ratio: float = 12.0
    """
    How much longer CVXPY takes to compile the trajectory problem than the power problem.

    6 to 17 times in six missions of 2 to 32 UAVs, 1 to 32 eavesdroppers and 100 to 20,000 slots.
    It only decides whether a first trajectory step is begun before a deadline.
    """
