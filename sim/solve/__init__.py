"""The implicit step: the linear system, its solver, and the backward-Euler kernel that integrators call."""
