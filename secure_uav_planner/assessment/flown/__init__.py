"""
Flights that were flown, compared with their plan.

| step | module |
| --- | --- |
| what a log says of one vehicle, in its own frame and on its own clock | `log.py` |
| a reader for each format | `ulog.py`, `dataflash.py`, `telemetry.py`, `bag.py`, `text.py` |
| the time of the plan at a time of the log | `alignment.py` |
| the flight of all vehicles in the frame and the time of the plan | `flight.py` |
| smallest distances | `closest.py` |
| errors, rates and broken slots | `comparison.py` |
"""

from .comparison import compare, Comparison
from .flight import FlownFlight, read_flight

__all__ = ['Comparison', 'FlownFlight', 'compare', 'read_flight']
