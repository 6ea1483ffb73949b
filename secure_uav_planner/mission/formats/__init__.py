"""Missions as files: YAML and JSON."""

from .diagnosis import Schema
from .files import load, save

__all__ = ['Schema', 'load', 'save']
