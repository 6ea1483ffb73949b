"""Missions as files: YAML and JSON."""

from .diagnosis import Schema
from .files import load, located, save

__all__ = ['Schema', 'load', 'located', 'save']
