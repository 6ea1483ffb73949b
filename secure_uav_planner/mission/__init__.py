"""A mission: its participants, limits and files, and the names of what a user can choose."""

from typing import get_args, Literal, TypeAlias

Objective: TypeAlias = Literal['guaranteed', 'worst_case']
"""What is maximised: 'guaranteed' is the paper's problem (P2), 'worst_case' its (P1)."""

OBJECTIVES: tuple[Objective, ...] = get_args(Objective)

Method: TypeAlias = Literal['joint', 'alternating']
"""A method of solve."""

METHODS: tuple[Method, ...] = get_args(Method)

LocationModel: TypeAlias = Literal['disc', 'normal', 'beyond', 'fixed']
"""The law by which an assessment draws the places of eavesdroppers."""

LOCATION_MODELS: tuple[LocationModel, ...] = get_args(LocationModel)

Power: TypeAlias = Literal['constant', 'optimised']
"""The powers of fly_hover_fly."""

TimeSource: TypeAlias = Literal['plan_time', 'utc', 'takeoff', 'fit']
"""Where the time of a plan in the logs of its flight is taken from."""

TIME_SOURCES: tuple[TimeSource, ...] = get_args(TimeSource)
