"""Everything that looks for contacts, asked as one: pairs of cloth, faces and vertices against obstacles.

Each look says who of the scene's effects was looked for, how much was found and what time it took, and leaves
out what cannot move anything.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from time import perf_counter

import numpy as np

from sim.contact.contacts import NO_CONTACTS, Contacts
from sim.contact.detect import deepest, detect
from sim.contact.escape import leave_together
from sim.contact.faces import Faces
from sim.contact.impact import EDGE_EDGE
from sim.contact.last_resort import LastResort
from sim.contact.obstacles import MESH, Obstacles, Shapes
from sim.contact.pairs import Feels, Pairs
from sim.contact.reach import box, within_reach
from sim.contact.way import Way
from sim.effects import COLLISIONS, OBSTACLE
from sim.model import Model
from sim.report import StepReport
from sim.settings import Settings

NOT_ASKED = np.zeros(0, dtype=bool)

NO_JOINS = np.zeros((0, 2), dtype=np.int64)


class Detectors:
    """Look for contacts of a scene's cloth with obstacles and with itself.

    A step begins with `begin`; a part of it with `at_start`, after which `on_the_way` may be asked.

    Attributes:
        pairs: That may touch, where settings and scene ask for them.
    """

    def __init__(self, model: Model, obstacles: Obstacles) -> None:
        self._model, self._obstacles, self._unpinned = model, obstacles, model.free
        first_key = len(model.mesh.vertices) * len(obstacles.parts)
        self._faces = Faces(model.mesh, model.free, obstacles, first_key)
        self._known: Pairs | None = None  # of the last settings that asked for some
        self.pairs: Pairs | None = None
        self._joins, self._resting = [NO_JOINS], []
        self._asked = NOT_ASKED  # which obstacles the last look at them was about

    def forget(self) -> None:
        """Have no list of pairs, so that what comes does not depend on what was."""
        if self._known is not None:
            self._known.forget()

    def begin(self, settings: Settings) -> None:
        """Begin a step."""
        self._joins, self._resting = [NO_JOINS], []
        self.pairs = pairs = self._pairs_for(settings)
        if pairs is not None:
            pairs.lists = pairs.looks = pairs.sweeps = pairs.asked = 0
            pairs.looked[:], pairs.felt[:], pairs.outspread = 0, 0, False

    def tell(self, report: StepReport) -> None:
        """Say what the step looked for."""
        if (pairs := self.pairs) is not None:
            report.lists, report.looks, report.sweeps = pairs.lists, pairs.looks, pairs.sweeps
            report.felt, report.outspread = self._by_effect(pairs.felt), pairs.outspread
            report.looked = self._by_effect(pairs.looked)

    @property
    def many(self) -> bool:
        """Whether the step has asked for so many pairs that it is done in no more parts."""
        return self.pairs is not None and self.pairs.many

    @property
    def joins(self) -> np.ndarray:
        """(k, 2) parts of the cloth that contacts of the step joined, where some of it may sleep."""
        return np.unique(np.concatenate(self._joins), axis=0)

    @property
    def resting(self) -> np.ndarray:
        """Keys of the contacts that moved nothing, as all that they are with sleeps."""
        return np.concatenate(self._resting) if self._resting else np.zeros(0, dtype=np.int64)

    def idle(self, settings: Settings) -> bool:
        """Whether there is nothing that cloth could touch."""
        return self.pairs is None and not self._obstacles.felt(settings).which.any()

    def at_start(self, way: Way) -> Contacts:
        """Pairs, and faces and obstacles, that are nearer than they should be where the way starts."""
        s, report, near = way.settings, way.report, NO_CONTACTS
        if (pairs := self.pairs) is not None:
            begin = perf_counter()
            before, after = (self._obstacles.corners(p, pairs.solid) for p in (way.before, way.after))
            near = pairs.begin(way.x, before, after, s.dt, s.thickness, way.over)
            self._share(report, pairs, 1e3 * (perf_counter() - begin))
        about = way.x, way.before, way.after, s.dt, s.thickness
        if not self._obstacles.felt(s).which.any():
            self._faces.begin(*about, None)
            return self._acting(near, way)
        with self._spent_on_obstacles(report):
            near = near.and_also(self._faces.begin(*about, self._near(way, way.x)))
        return self._acting(near, way)

    def on_the_way(self, way: Way, end: np.ndarray, part: float = 1.0) -> Contacts:
        """Pairs, and faces and obstacles, that meet on the way to `end`, to a `part` of the usual gap."""
        if way.settings.detection == "static":
            return NO_CONTACTS
        report, pairs = way.report, self.pairs
        listed = 0.0 if pairs is None else pairs.listing
        with report.spent("continuous_detection"):
            hits = NO_CONTACTS if pairs is None else pairs.hits(end, part)
            hits = hits.and_also(self._faces.hits(end, self._near(way, end), part))
        if pairs is not None and pairs.listing > listed:  # a list serves static detection just as well
            made = 1e3 * (pairs.listing - listed)
            report.costs["continuous_detection"] -= made
            self._share(report, pairs, made)
        return self._acting(hits, way)

    def of_vertices(self, way: Way, end: np.ndarray) -> Contacts:
        """Contacts of vertices with obstacles but meshes on the way to `end`."""
        s = way.settings
        if way.response is None or not self._obstacles.felt(s).which.any():
            return NO_CONTACTS
        with self._spent_on_obstacles(way.report):
            shapes = self._near(way, end)
            if shapes is None:
                return NO_CONTACTS
            path = way.x, end, self._unpinned, s.dt
            about = shapes, way.before, way.after
            found = detect(*about, *path, s.thickness, s.detection == "continuous")
            if way.response.impulses and (found.start < 0.0).any():
                found = leave_together(found, *about, way.x, self._model.mesh.edges, s.dt)
            return self._acting(found, way)

    def last_resort(self, way: Way) -> LastResort:
        """What holds back vertices that would meet something on that way."""
        masses, hits_to = self._model.inverse_masses, partial(self.on_the_way, way)
        return LastResort(self._faces, self.pairs, self._model.free, masses, hits_to)

    def depths(self, time: float, positions: np.ndarray, settings: Settings | None = None) -> np.ndarray:
        """(n,) how far each vertex is inside an obstacle at `time` [m], zero outside.

        Where there are `settings`, only those obstacles count that are felt with them.
        """
        depths, poses, around = np.zeros(len(positions)), self._obstacles.poses(time), box(positions)
        shapes = self._obstacles.shapes
        near = within_reach(shapes, poses, poses, around, around, 0.0)
        if settings is not None:
            near &= self._obstacles.felt(settings).which
        if near.any():
            deepest(shapes.only(near), poses, positions, depths)
        return depths

    def _pairs_for(self, s: Settings) -> Pairs | None:
        mesh, felt = self._model.mesh, self._obstacles.felt(s)
        there, between = len(mesh.edges) > 0, s.cloth_collision != "off" and mesh.several
        feels = Feels(there and s.self_collision != "off", there and between, s.edge_edge != "off")
        if s.contact == "none" or not (feels.within or feels.between or len(felt.solid.vertices)):
            return None
        pairs = self._known
        if pairs is None or pairs.feels != feels or pairs.solid is not felt.solid:
            about = mesh, self._unpinned, felt.solid, feels, self._faces.last_key
            pairs = self._known = Pairs(*about, self._obstacles.moves[felt.solid.part])
        forced = "on" in (s.self_collision, s.cloth_collision, s.edge_edge, s.obstacles)
        pairs.exhaustive = forced or bool(felt.forced.any())
        return pairs

    def _near(self, way: Way, end: np.ndarray) -> Shapes | None:
        """The obstacles but meshes that may act on the way to `end`, if any; meshes are among the pairs."""
        felt, shapes = self._obstacles.felt(way.settings), self._obstacles.shapes
        self._asked = NOT_ASKED
        if not felt.which.any():
            return None
        about = way.before, way.after, way.start, box(end), way.settings.thickness
        there = felt.which & (shapes.kind != MESH)
        near = there & (felt.forced | within_reach(shapes, *about))
        self._asked = near if near.any() else there
        way.report.near_obstacles.update(self._obstacles.labels[o] for o in np.flatnonzero(near))
        return shapes.only(near) if near.any() else None

    def _acting(self, contacts: Contacts, way: Way) -> Contacts:
        """Those that can move something within the scene's plane; what parts they join is noted.

        What joins sleeping parts, or holds one up, moves nothing, and is what it was.
        """
        contacts = contacts.confined(self._model.axis, way.x)
        if way.settings.sleep == "off" or not len(contacts.key):
            return contacts
        self._joins.append(contacts.joins(self._model.mesh.parts))
        free = self._model.free
        if free is self._unpinned:
            return contacts
        moves = ((contacts.weight != 0.0) & free[contacts.node]).any(axis=1)
        self._resting.append(contacts.key[~moves])
        return contacts.only(moves)

    @contextmanager
    def _spent_on_obstacles(self, report: StepReport) -> Iterator[None]:
        """Book the time of the block for obstacles but meshes, and share it out among them.

        Evenly, as each one is asked about all vertices: among those that `_near` found last, or else among
        all that it was looked for.
        """
        begin = perf_counter()
        yield
        ms, which = 1e3 * (perf_counter() - begin), np.flatnonzero(self._asked)
        names = [OBSTACLE + self._obstacles.labels[o] for o in which]
        for name, part in ("obstacles", ms), *((name, ms / len(names)) for name in names):
            report.costs[name] = report.costs.get(name, 0.0) + part

    def _share(self, report: StepReport, pairs: Pairs, ms: float) -> None:
        """Book the time that was spent on pairs by whom they are with, and by their kind."""
        count = len(COLLISIONS)
        faces, edges = pairs.counts[:, 0], int(pairs.counts[:, EDGE_EDGE].sum())
        if not faces.sum() + edges:  # who is looked for, where nobody is found
            felt = np.isin(np.arange(len(faces) - count), pairs.solid.part)
            faces = np.concatenate([[pairs.feels.within, pairs.feels.between], felt]).astype(int)
            edges = int(pairs.feels.edges)
        whole = int(faces.sum()) + edges
        each = zip(self._names, faces.tolist(), strict=False)
        for name, part in (*each, ("obstacles", int(faces[count:].sum())), ("edge_edge", edges)):
            if part:
                report.costs[name] = report.costs.get(name, 0.0) + ms * part / whole

    def _by_effect(self, pairs: np.ndarray) -> dict[str, int]:
        """Numbers of pairs (parts, 2), as `Pairs` has them, by effect, where there are any."""
        found = dict(zip(self._names, pairs.sum(axis=1).tolist(), strict=False))
        found["edge_edge"] = int(pairs[:, EDGE_EDGE].sum())
        return {name: count for name, count in found.items() if count}

    @property
    def _names(self) -> tuple[str, ...]:
        """Whom pairs are with, in the order in which `Pairs` counts them."""
        return *COLLISIONS, *(OBSTACLE + label for label in self._obstacles.labels)
