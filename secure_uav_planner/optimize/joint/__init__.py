"""The joint method: positions and powers together, by an interior-point method."""

from .method import improve, optimise_powers

__all__ = ['improve', 'optimise_powers']
