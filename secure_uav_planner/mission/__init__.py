"""What is asked: the mission, its participants, limits and files, and what can be chosen."""

from typing import get_args, Literal, TypeAlias

Objective: TypeAlias = Literal['guaranteed', 'worst_case']
"""What is maximised: 'guaranteed' is the paper's problem (P2), 'worst_case' its (P1)."""

OBJECTIVES: tuple[Objective, ...] = get_args(Objective)

Method: TypeAlias = Literal['joint', 'alternating']
"""A method of solve."""

METHODS: tuple[Method, ...] = get_args(Method)

Place: TypeAlias = Literal['disc', 'normal', 'beyond', 'fixed']
"""Where an eavesdropper is in an assessment: a law of its place."""

PLACES: tuple[Place, ...] = get_args(Place)

Power: TypeAlias = Literal['constant', 'optimised']
"""The powers of fly_hover_fly."""
