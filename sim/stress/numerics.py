"""Hard cases of springs, integrators and solvers."""
