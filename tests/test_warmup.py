"""What is compiled before the first step: all that it needs, and nothing that only others need."""

import json
import subprocess
import sys

ASKS = """
import json, sys
import msgspec
import sim, sim.warmup
from sim.compiled import KERNELS
from sim.settings import change

def ready():
    return {f"{k.py_func.__module__}.{k.py_func.__name__}" for k in KERNELS if k.overloads}

scene = sim.load_scene(sys.argv[1])
scene = msgspec.structs.replace(scene, settings=change(scene.settings, **json.loads(sys.argv[2])))
sim.warmup.warm_up(scene)
first = ready()
world = sim.Simulation(scene)
for _ in range(12):
    world.step()
print(json.dumps([sorted(first), sorted(ready() - first)]))
"""


def compiled(scene: str, **settings) -> tuple[set[str], set[str]]:
    """Kernels that warming up compiles, or loads, and those that some steps add, in a fresh process."""
    about = scene, json.dumps(settings)
    found = subprocess.run([sys.executable, "-c", ASKS, *about], capture_output=True, text=True, check=True)
    first, more = map(set, json.loads(found.stdout))
    return first, more


def counts(kernels: set[str]) -> bool:
    return any("sim.contact.intersections." in name for name in kernels)


def test_what_counts_crossings_is_compiled_only_where_a_start_is_looked_at():
    for settings in {"contact": "penalty"}, {"tangled": "keep"}:
        first, more = compiled("drape", **settings)
        assert not counts(first | more)
    assert counts(compiled("drape")[0])


def test_what_keeps_books_is_compiled_unless_the_ledger_is_off():
    def keeps(kernels):
        return any(name.startswith("sim.ledger.") for name in kernels)

    assert keeps(compiled("cantilever", ledger="auto")[0])
    first, more = compiled("cantilever", ledger="off")
    assert not keeps(first | more)
    assert not more


def test_warming_up_leaves_nothing_to_compile_for_the_first_steps():
    for name in "drape", "flag":
        first, more = compiled(name)
        assert len(first) > 20
        assert not more
