"""Missions as files: YAML and JSON."""

from .files import load, save

__all__ = ['load', 'save']
