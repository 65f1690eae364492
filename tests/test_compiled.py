"""How kernels are compiled."""

import os
import subprocess
import sys
from pathlib import Path

STEPS = """
import sim
scene = sim.load_scene({scene!r})
scene.cloth[0].resolution = (6, 6)
world = sim.Simulation(scene, contact="none", drag=0.5)
for _ in range(30):
    world.step()
print(world.positions.tobytes().hex(), world.velocities.tobytes().hex())
"""


def test_bits_are_those_of_one_operation_at_a_time(tmp_path):
    """What LLVM does to several components at once is what it does to one after the other.

    Without contact, as that takes long to compile: its predicates are compared with exact truth anyway.
    """
    code = STEPS.format(scene=str(Path(__file__).parents[1] / "static_scenes" / "drape.toml"))

    def bits(**environment: str) -> str:
        command = [sys.executable, "-c", code]
        done = subprocess.run(
            command, env=os.environ | environment, capture_output=True, encoding="utf-8", check=False
        )
        assert done.returncode == 0, done.stderr
        return done.stdout

    assert bits() == bits(NUMBA_SLP_VECTORIZE="0", NUMBA_CACHE_DIR=str(tmp_path))
