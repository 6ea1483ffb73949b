"""Missions as files: YAML, JSON, and parameter files of the planner node."""

from .files import load, save

__all__ = ['load', 'save']
