"""A task of a campaign: one mission, how it is planned, and the key of its row."""

from collections.abc import Mapping
import hashlib
import json
from pathlib import Path
from typing import Any, TypeAlias

Task: TypeAlias = dict[str, Any]
"""A mission and how it is planned, as plain values, with 'key', 'sample' and 'fields'."""


def task_of(mission: Mapping[str, Any], method: str, objective: str, settings: Mapping[str, Any],
            fields: Mapping[str, Any], sample: int = 0) -> Task:
    """
    Return a task; its key is the same for the same mission, planned in the same way.

    :param mission: what Scenario.to_dict returns.
    :param method: one of METHODS or BASELINES.
    :param settings: 'time_limit' and 'bound_time_limit' in s, None for no limit and for no bound;
        'plans' if the plan is to be kept; 'assess' if it is to be assessed, and how; and whatever
        else makes the result another one.
    :param fields: what tells this mission from the others, for its row.
    """
    task = {'mission': mission, 'method': method, 'objective': objective, **settings}
    digest = hashlib.sha256(json.dumps(task, sort_keys=True).encode())
    return {**task, 'key': digest.hexdigest()[:24], 'sample': sample, 'fields': fields}


def plan_file(folder: Path, key: str) -> Path:
    """Return where the plan of a row is kept, in the folder of the results."""
    return folder / 'plans' / f'{key}.json'
