"""
Where UAVs may fly.

`obstacles.py` has the obstacles of each UAV, `routes.py` the shortest ways around them, and
`clearance.py` the distances that flown curves keep from zones, from the fence and from each other.
"""

from .clearance import Clearance
from .obstacles import Airspace, GEOFENCE, Obstacle
from .routes import VisibilityGraph

__all__ = ['Airspace', 'Clearance', 'GEOFENCE', 'Obstacle', 'VisibilityGraph']
