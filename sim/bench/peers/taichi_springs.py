"""A mass-spring sheet in Taichi: linearised backward Euler (Baraff and Witkin 1998), sparse direct solver.

Each step solves (M + h D + h² K) Δv = h (f − h K v). K drops the part of a compressed spring that is not
positive (Choi and Ko 2002), and D damps along the springs with Muslin's default ratio.

Taichi reads the annotations of kernels, so they are not put off here.
"""

# pyright: reportInvalidTypeForm=false

from importlib import import_module
from typing import Any

import numpy as np

from sim.bench.peers import Knobs
from sim.bench.sheet import DENSITY, FRAME, GRAVITY, RADIUS, SPRING, THICKNESS, WIDTH, Sheet
from sim.mesh import vertex_masses

ti: Any = import_module("taichi")

OWN: Knobs = {"substeps": 1}
FRAMES: tuple[Knobs, ...] = (OWN,)
LADDER: tuple[Knobs, ...] = tuple({"substeps": 2**k} for k in range(9))
OTHERS: tuple[Knobs, ...] = ()

GAMMA = 0.2
"""Damping ratio of each spring."""

ENTRIES = 36
"""Matrix entries that an edge adds to: four blocks of 3 × 3."""


class SpringRun:
    """A sheet of springs in Taichi."""

    def __init__(self, sheet: Sheet, knobs: Knobs, threads: int) -> None:
        ti.init(arch=ti.cpu, default_fp=ti.f64, cpu_max_num_threads=threads, log_level=ti.WARN)
        self.substeps = int(knobs["substeps"])
        self.h = FRAME / self.substeps
        mesh, n = sheet.mesh, sheet.count
        rest = np.linalg.norm(np.subtract(*mesh.vertices[mesh.edges.T]), axis=1)
        fixed = np.zeros(n, dtype=np.int32)
        fixed[mesh.pinned] = 1
        masses = vertex_masses(mesh, "area", DENSITY)
        constants = SPRING * sheet.spacing / rest
        damping = GAMMA * 2.0 * np.sqrt(constants * DENSITY * WIDTH**2 / n / 2.0)
        self.x, self.v = _vectors(mesh.vertices), _vectors(np.zeros_like(mesh.vertices))
        self.fixed, self.masses = _scalars(fixed, ti.i32), _scalars(masses)
        self.edges = _vectors(mesh.edges, ti.i32)
        self.rest, self.constants, self.damping = map(_scalars, (rest, constants, damping))
        self.right = ti.ndarray(ti.f64, 3 * n)
        most = ENTRIES * len(mesh.edges) + 3 * n
        self.builder = ti.linalg.SparseMatrixBuilder(3 * n, 3 * n, max_num_triplets=most, dtype=ti.f64)
        self.solver = ti.linalg.SparseSolver(dtype=ti.f64, solver_type="LLT")
        self.analysed = False
        self.ball = 0 if sheet.hangs else 1
        self.center = ti.Vector(sheet.center)

    def frame(self) -> None:
        """Go on by one frame."""
        for _ in range(self.substeps):
            self._step()

    def positions(self) -> np.ndarray:
        """(n, 3) [m]."""
        return self.x.to_numpy()

    def _step(self) -> None:
        model = self.x, self.v, self.masses, self.fixed
        springs = self.edges, self.rest, self.constants, self.damping
        _gather_masses(*model, self.builder, self.right, self.h)
        _gather_springs(*model, *springs, self.builder, self.right, self.h)
        matrix = self.builder.build(dtype=ti.f64)
        if not self.analysed:
            self.solver.analyze_pattern(matrix)
            self.analysed = True
        self.solver.factorize(matrix)
        _move(*model, self.solver.solve(self.right), self.h, self.center, self.ball)


start = SpringRun


def _vectors(values: np.ndarray, kind: Any = ti.f64) -> Any:
    field = ti.Vector.field(values.shape[1], kind, len(values))
    field.from_numpy(np.ascontiguousarray(values))
    return field


def _scalars(values: np.ndarray, kind: Any = ti.f64) -> Any:
    field = ti.field(kind, len(values))
    field.from_numpy(values)
    return field


@ti.kernel
def _gather_masses(
    x: ti.template(),
    v: ti.template(),
    masses: ti.template(),
    fixed: ti.template(),
    matrix: ti.types.sparse_matrix_builder(),
    right: ti.types.ndarray(),
    h: ti.f64,
):
    for i in x:
        for c in range(3):
            matrix[3 * i + c, 3 * i + c] += masses[i]
            right[3 * i + c] = 0.0
        if fixed[i] == 0:
            right[3 * i + 2] = -h * masses[i] * GRAVITY


@ti.kernel
def _gather_springs(
    x: ti.template(),
    v: ti.template(),
    masses: ti.template(),
    fixed: ti.template(),
    edges: ti.template(),
    rest: ti.template(),
    constants: ti.template(),
    damping: ti.template(),
    matrix: ti.types.sparse_matrix_builder(),
    right: ti.types.ndarray(),
    h: ti.f64,
):
    for e in edges:
        i, j = edges[e][0], edges[e][1]
        way, speed = x[j] - x[i], v[j] - v[i]
        length = way.norm()
        d = way / length
        along = d.outer_product(d)
        across = ti.max(0.0, 1.0 - rest[e] / length) * (ti.Matrix.identity(ti.f64, 3) - along)
        stiffness = constants[e] * (along + across)
        pull = (constants[e] * (length - rest[e]) + damping[e] * d.dot(speed)) * d + h * stiffness @ speed
        block = h * damping[e] * along + h * h * stiffness
        for a, b in ti.static(ti.ndrange(3, 3)):
            if fixed[i] == 0:
                matrix[3 * i + a, 3 * i + b] += block[a, b]
            if fixed[j] == 0:
                matrix[3 * j + a, 3 * j + b] += block[a, b]
            if fixed[i] + fixed[j] == 0:
                matrix[3 * i + a, 3 * j + b] += -block[a, b]
                matrix[3 * j + a, 3 * i + b] += -block[a, b]
        for a in ti.static(range(3)):
            if fixed[i] == 0:
                ti.atomic_add(right[3 * i + a], h * pull[a])
            if fixed[j] == 0:
                ti.atomic_add(right[3 * j + a], -h * pull[a])


@ti.kernel
def _move(
    x: ti.template(),
    v: ti.template(),
    masses: ti.template(),
    fixed: ti.template(),
    change: ti.types.ndarray(),
    h: ti.f64,
    center: ti.math.vec3,
    ball: ti.i32,
):
    for i in x:
        if fixed[i] == 0:
            v[i] += ti.Vector([change[3 * i], change[3 * i + 1], change[3 * i + 2]])
            x[i] += h * v[i]
            away = x[i] - center
            if ball == 1 and away.norm() < RADIUS + THICKNESS:
                normal = away.normalized()
                x[i] = center + (RADIUS + THICKNESS) * normal
                v[i] -= ti.min(0.0, v[i].dot(normal)) * normal
