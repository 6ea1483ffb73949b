"""The joint method: positions and powers together, by an interior-point method."""

from .method import improve

__all__ = ['improve']
