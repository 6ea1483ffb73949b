"""
Flights that were flown, compared with their plan.

| step | module |
| --- | --- |
| what a log says of one vehicle, in its own frame and on its own clock | `log.py` |
| a reader for each format | `ulog.py`, `dataflash.py`, `telemetry.py`, `bag.py`, `text.py` |
| the reader of a file, by its ending | `recording.py` |
| the plan in force at each time | `course.py` |
| the time of the plan at a time of the log | `alignment.py` |
| the frame of the log in the frame of the plan | `place.py` |
| the flight of all vehicles in the frame and the time of the plan | `flight.py` |
| errors of each vehicle, and smallest distances | `errors.py`, `closest.py` |
| rates and broken slots; what to type next | `comparison.py`, `advice.py` |
"""

from .comparison import compare, Comparison
from .flight import FlownFlight, read_flight

__all__ = ['Comparison', 'FlownFlight', 'compare', 'read_flight']
