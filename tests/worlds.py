"""Small scenes that tests share; those of the battery."""

from sim.stress.worlds import ball, chain, grid, irregular, scene

__all__ = ["ball", "chain", "grid", "irregular", "scene"]
