"""The way of a step through contact: detect, feel contacts in the solve, detect again, respond.

With impulses and continuous detection the step ends as it began, free of intersections. That rests on four
things: detection misses nothing, on a list of pairs that holds for every place a vertex has been at; pairs
that start nearer than the usual gap have a smaller one of their own; after every change of positions pairs
are detected anew; and where impulses do not find a way, the step is done in halves, and at last vertices go
no farther than they can without meeting anything.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from time import perf_counter

import numpy as np
from msgspec.structs import replace as replaced

from sim.contact.contacts import NO_CONTACTS, NOT_OVER, UNTOUCHED, UNWATCHED, Contacts, Touch, touch
from sim.contact.detect import deepest, detect
from sim.contact.eruption import erupts
from sim.contact.escape import leave_together
from sim.contact.faces import Faces
from sim.contact.friction import SLOW
from sim.contact.gap import NO_GAP_SPRINGS, GapSprings, gap_springs
from sim.contact.impact import EDGE_EDGE
from sim.contact.last_resort import LastResort
from sim.contact.obstacles import MESH, Obstacles, Poses, Shapes
from sim.contact.overrun import found_over, joined, still_over
from sim.contact.pairs import Feels, Pairs
from sim.contact.pinch import fit
from sim.contact.reach import box, within_reach
from sim.contact.response import RESPONSES, Response, lacks, targets
from sim.effects import COLLISIONS, OBSTACLE
from sim.integrators import INTEGRATORS
from sim.ledger import UNBOOKED, Part, Unbooked
from sim.model import Model
from sim.report import StepReport
from sim.scene import Scene
from sim.settings import Settings
from sim.solve.implicit import Solution

MOST_SOLVES = 3
"""Solves of one step at most: one more where a solve led vertices into contacts that it did not feel."""

MOST_ROUNDS = 8
"""Rounds of impulses and continuous detection before a step is done in halves."""

MOST_HALVINGS = 5
"""Times that a step is halved before vertices are held back."""

NEWTON, STIFFER = 2, 10.0
"""Newton iterations of a step that put in energy with fewer, as their line search asks the springs; and how
much stiffer its gap springs are where it was impulses, which do not ask: so they have less to do."""

MOST_FAILSAFES = 4
"""Parts of a step whose vertices were held back, after which no other part is halved: it is of no use."""

MOST_DEEPER = 7
"""Times that a step is halved beyond that where an obstacle would run over what is held back."""

MOST_OVERRUNS = 4
"""Parts of a step in which one did after all: it is a pinch, and no other part is halved so often for it."""

NOT_ASKED = np.zeros(0, dtype=bool)

NO_JOINS = np.zeros((0, 2), dtype=np.int64)

Solve = Callable[[GapSprings, Settings, np.ndarray, np.ndarray, np.ndarray | None], Solution]
"""solve(springs, settings, x, v, guess): `guess` is velocities near those at its end, where there are any."""


@dataclass
class _Way:
    """What one step, or one part of it, has to go on."""

    settings: Settings
    before: Poses
    after: Poses
    x: np.ndarray
    v: np.ndarray
    solve: Solve
    report: StepReport
    part: Part | Unbooked
    deepest: bool = False
    erupted: str = ""
    springs: GapSprings = NO_GAP_SPRINGS  # that the last solve of it felt
    guess: np.ndarray | None = None  # and the velocities that it ended with
    over: np.ndarray = field(default_factory=lambda: NOT_OVER)

    @cached_property
    def start(self) -> np.ndarray:
        """(8, 3) corners of the box around `x` [m]."""
        return box(self.x)


class Pipeline:
    """Contact of a scene's cloth with obstacles and with itself.

    Attributes:
        obstacles: Of the scene.
        touched: What the contacts of the last step remember.
        joins: (k, 2) parts of the cloth that contacts joined in the last step, where some of it may sleep.
        booked: Whether a ledger is kept; then `parts` has the books of each part of the last step.
    """

    def __init__(self, scene: Scene, model: Model) -> None:
        self.obstacles = Obstacles(scene, model.mesh.shells)
        self._model, self._unpinned = model, model.free
        first_key = len(model.mesh.vertices) * len(self.obstacles.parts)
        self._faces = Faces(model.mesh, model.free, self.obstacles, first_key)
        self._pairs: Pairs | None = None
        self.booked, self.parts = False, []
        self.joins, self._joins, self._resting = NO_JOINS, [NO_JOINS], []
        self._asked = NOT_ASKED  # which obstacles the last look at them was about
        self.forget()

    def forget(self) -> None:
        """Start with nothing touched."""
        self.touched = UNTOUCHED
        if self._pairs is not None:
            self._pairs.forget()

    def through(
        self,
        settings: Settings,
        time: float,
        x: np.ndarray,
        v: np.ndarray,
        solve: Solve,
        report: StepReport,
    ) -> tuple[Solution, Touch]:
        """Take one step from (`x`, `v`) at `time` with `solve`, which feels the contacts that it is given.

        Returns:
            The end of the step, and what its contacts remember.
        """
        response = self._response(settings)
        pairs = self._pairs_for(settings)
        self.parts, self._joins, self._resting = [], [NO_JOINS], []
        if pairs is not None:
            pairs.lists = pairs.looks = pairs.sweeps = pairs.asked = 0
            pairs.reached[:], pairs.felt[:], pairs.outspread = False, 0, False
        touched = self._not_apart(settings, response, time, x)
        end = self._part(settings, response, pairs, time, x, v, touched, solve, report, MOST_HALVINGS)
        if pairs is not None:
            report.lists, report.looks, report.sweeps = pairs.lists, pairs.looks, pairs.sweeps
            report.felt, report.outspread = self._by_effect(pairs.felt), pairs.outspread
            report.looked = self._by_effect(np.where(pairs.reached, pairs.counts, 0))
        self.joins, (solution, after) = np.unique(np.concatenate(self._joins), axis=0), end
        if self._resting:
            resting = self.touched.only(np.isin(self.touched.key, np.concatenate(self._resting)))
            after = after.and_also(resting.still())
        after = after._replace(
            over=self._with_what_follows(after.over, time + settings.dt, solution.positions)
        )
        report.overrun = len(np.unique(after.over[:, 0]))
        report.overrun_by = [OBSTACLE + self.obstacles.labels[o] for o in np.unique(after.over[:, 1])]
        return solution, after._replace(watched=touched.watched)

    def _not_apart(self, settings: Settings, response: Response | None, time: float, x: np.ndarray) -> Touch:
        """What the last step left to remember, with what of the cloth obstacles are over now."""
        over, watched = self.touched.over, UNWATCHED
        if response is not None and response.impulses and settings.detection != "static":
            watched = np.flatnonzero(self.obstacles.felt(settings).which)
        new = watched[~np.isin(watched, self.touched.watched)]
        if len(over) or len(new):
            poses, around = self.obstacles.poses(time), box(x)
            shapes, about = self.obstacles.shapes, (self._model.mesh, self.obstacles, poses, x)
            near = within_reach(shapes, poses, poses, around, around, 0.0) | (shapes.kind == MESH)
            new = new[near[new]]
            over = still_over(over, *about) if len(over) else over
            for o in new.tolist():
                over = joined(over, found_over(o, *about))
        return self.touched._replace(over=over, watched=watched)

    def _with_what_follows(self, over: np.ndarray, time: float, x: np.ndarray) -> np.ndarray:
        """What is run `over` (k, 2), and what that drags into obstacles but meshes, at `x` (n, 3) [m]."""
        if not len(over):
            return over
        about = self._model.mesh, self.obstacles, self.obstacles.poses(time), x
        for o in np.unique(over[:, 1]).tolist():
            if self.obstacles.shapes.kind[o] != MESH:
                over = joined(over, found_over(o, *about))
        return over

    def _acting(self, contacts: Contacts, way: _Way) -> Contacts:
        """Those that can move something within the scene's plane; what parts they join is noted.

        What joins sleeping parts, or holds one up, moves nothing, and is what it was.
        """
        contacts = contacts.confined(self._model.axis, way.x)
        if way.settings.sleep == "off" or not len(contacts.key):
            return contacts
        parts = self._model.mesh.parts
        if parts.any():
            self._joins.append(contacts.joins(parts))
        free = self._model.free
        if free is self._unpinned:
            return contacts
        moves = ((contacts.weight != 0.0) & free[contacts.node]).any(axis=1)
        self._resting.append(contacts.key[~moves])
        return contacts.only(moves)

    def _by_effect(self, pairs: np.ndarray) -> dict[str, int]:
        """Numbers of pairs (parts, 2), as `Pairs` has them, by effect, where there are any."""
        names = *COLLISIONS, *(OBSTACLE + label for label in self.obstacles.labels)
        found = dict(zip(names, pairs.sum(axis=1).tolist(), strict=False))
        found["edge_edge"] = int(pairs[:, EDGE_EDGE].sum())
        return {name: count for name, count in found.items() if count}

    def depths(self, time: float, positions: np.ndarray, settings: Settings | None = None) -> np.ndarray:
        """(n,) how far each vertex is inside an obstacle at `time` [m], zero outside.

        Where there are `settings`, only those obstacles count that are felt with them.
        """
        depths, poses, around = np.zeros(len(positions)), self.obstacles.poses(time), box(positions)
        shapes = self.obstacles.shapes
        near = within_reach(shapes, poses, poses, around, around, 0.0)
        if settings is not None:
            near &= self.obstacles.felt(settings).which
        if near.any():
            deepest(shapes.only(near), poses, positions, depths)
        return depths

    def _near(self, way: _Way, end: np.ndarray) -> Shapes | None:
        """The obstacles but meshes that may act on the way to `end`, if any; meshes are among the pairs."""
        felt, shapes = self.obstacles.felt(way.settings), self.obstacles.shapes
        self._asked = NOT_ASKED
        if not felt.which.any():
            return None
        about = way.before, way.after, way.start, box(end), way.settings.thickness
        there = felt.which & (shapes.kind != MESH)
        near = there & (felt.forced | within_reach(shapes, *about))
        self._asked = near if near.any() else there
        way.report.near_obstacles.update(self.obstacles.labels[o] for o in np.flatnonzero(near))
        return shapes.only(near) if near.any() else None

    def _part(
        self, settings, response, pairs, time, x, v, touched, solve, report, halvings
    ) -> tuple[Solution, Touch]:
        """Take a step, or where that leads to a tangle its two halves one after the other.

        One that puts in energy is first repeated, from where it led, with more Newton iterations: cloth
        that is stopped within an edge's length stretches in a way that no linear model tells.
        """
        h = settings.dt
        poses = self.obstacles.poses(time), self.obstacles.poses(time + h)
        part = Part(self._model, x, v) if self.booked else UNBOOKED
        many = pairs is not None and pairs.many
        last = many or halvings <= 0 or report.failsafes >= MOST_FAILSAFES
        deepest = many or halvings == -MOST_DEEPER or (halvings <= 0 and report.overruns >= MOST_OVERRUNS)
        way = _Way(settings, *poses, x, v, solve, report, part, deepest)
        found = self._attempt(way, response, pairs, touched, last)
        if way.erupted and response is not None and settings.newton < NEWTON:
            settings = replaced(settings, newton=NEWTON)
            if way.erupted == "impulses":
                response = replace(response, stiffness=STIFFER * response.stiffness)
            way = replace(way, settings=settings, erupted="")
            found = self._attempt(way, response, pairs, touched, last)
        if way.erupted and last:
            found = self._unfelt(way, pairs)
        if found is not None:
            if isinstance(part, Part):
                part.close(found[0])
                self.parts.append(part)
            return found
        report.substeps += 1
        half = replaced(settings, dt=0.5 * h)
        rest = solve, report, halvings - 1
        first, touched = self._part(half, response, pairs, time, x, v, touched, *rest)
        second, touched = self._part(
            half, response, pairs, time + 0.5 * h, first.positions, first.velocities, touched, *rest
        )
        return second, touched

    def _attempt(
        self, way: _Way, response: Response | None, pairs: Pairs | None, touched: Touch, last: bool
    ) -> tuple[Solution, Touch] | None:
        """Take a step in one go; None where it would end in a tangle and is not the `last` try.

        Contacts are looked for where vertices are and on the way that they would take by themselves; then on
        the way that they took, and the step solved again where that led into some.
        """
        s, report, h = way.settings, way.report, way.settings.dt
        way.over = touched.over
        if response is not None and response.projects:
            return self._projected(way, pairs)
        fall = self._model.confined(np.broadcast_to(h * np.asarray(s.gravity), way.x.shape))
        end = way.x + h * (way.v + fall)
        with report.phase("detect"):
            near = self._begin(way, pairs)
        if pairs is not None:
            report.near, report.candidates = len(near.key), pairs.listed
            report.thickness = pairs.thickness
        solves = 0
        while True:
            with report.phase("detect"):
                found = self._fitted(near, self._detect(response, way, end), end, report)
                springs = self._gap_springs(response, way, len(near.key), found, end, touched)
            with report.phase("solve"):
                solution = way.solve(springs, s, way.x, way.v, way.guess)
            way.springs, way.guess = springs, solution.velocities
            with report.phase("detect"):
                x = solution.positions
                contacts = self._fitted(near, self._detect(response, way, x), x, report)
                if response is not None:
                    lack = (lacks(response, c, x, h) for c in (contacts, springs.contacts))
                    contacts = contacts.or_else(springs.contacts, *lack)
                late = self._late(response, way, contacts.only(slice(len(near.key), None)), springs, x)
                hits = NO_CONTACTS
                if response is not None and not response.impulses:
                    hits = self._hits(way, pairs, x)
                    hits = hits.only(~np.isin(hits.key, near.key))
            solves, report.iterations = solves + 1, report.iterations + solution.iterations
            if not (len(late) or len(hits.key)) or solves == MOST_SOLVES:
                break
            end[late] = x[late]
            node = hits.node[hits.weight != 0.0]
            end[node] = x[node]
            near = near.and_also(hits)
        with report.phase("respond"):
            return self._respond(response, pairs, way, springs, contacts, solution, last)

    def _unfelt(self, way: _Way, pairs: Pairs | None) -> tuple[Solution, Touch] | None:
        """Take a step that feels no contact and hold back what meets; None where halves might do better.

        For where contacts ask for what only a throw could do, however short the step.
        """
        report = way.report
        with report.phase("solve"):
            solution = way.solve(NO_GAP_SPRINGS, way.settings, way.x, way.v, None)
        report.iterations += solution.iterations
        way.part.respond_anew()
        if not self._held_back(self._resort(pairs, way), way, solution.positions, solution.velocities):
            return None
        return solution, UNTOUCHED._replace(over=way.over)

    def _projected(self, way: _Way, pairs: Pairs | None) -> tuple[Solution, Touch]:
        """Take a step that feels nothing, then put right what it led into."""
        s, report = way.settings, way.report
        with report.phase("solve"):
            solution = way.solve(NO_GAP_SPRINGS, s, way.x, way.v, None)
        report.iterations += solution.iterations
        x, v = solution.positions, solution.velocities
        if not np.isfinite(x).all():
            return solution, UNTOUCHED
        with report.phase("detect"):
            static = replace(way, before=way.after, x=x)
            hits = NO_CONTACTS
            if s.detection == "continuous":
                self._begin(way, pairs)
                hits = self._hits(way, pairs, x)
            near = self._begin(static, pairs)
            touching = self._detect(RESPONSES[s.contact], way if s.detection == "continuous" else static, x)
            contacts = hits.and_also(near).and_also(touching)
        report.contacts = len(contacts.key)
        with report.phase("respond"):
            inverse_masses = self._model.inverse_masses
            way.part.project(contacts, s.friction, contacts.masses(inverse_masses), inverse_masses, x, v)
        return solution, UNTOUCHED

    def _pairs_for(self, s: Settings) -> Pairs | None:
        """The pairs that may touch, where settings and scene ask for them."""
        mesh, felt = self._model.mesh, self.obstacles.felt(s)
        there, between = len(mesh.edges) > 0, s.cloth_collision != "off" and mesh.several
        feels = Feels(there and s.self_collision != "off", there and between, s.edge_edge != "off")
        if s.contact == "none" or not (feels.within or feels.between or len(felt.solid.vertices)):
            return None
        pairs = self._pairs
        if pairs is None or pairs.feels != feels or pairs.solid is not felt.solid:
            about = mesh, self._unpinned, felt.solid, feels, self._faces.last_key
            pairs = self._pairs = Pairs(*about, self.obstacles.moves[felt.solid.part])
        forced = "on" in (s.self_collision, s.cloth_collision, s.edge_edge, s.obstacles)
        pairs.exhaustive = forced or bool(felt.forced.any())
        return pairs

    def _response(self, settings: Settings) -> Response | None:
        """How cloth answers; forces that are not solved for must be soft enough for an explicit step."""
        response = RESPONSES.get(settings.contact)
        if response is None or INTEGRATORS[settings.integrator].implicit or not response.solved:
            return response
        return replace(
            response, stiffness=1.0, damping=min(response.damping, 0.5), carries=False, solved=False
        )

    def _begin(self, way: _Way, pairs: Pairs | None) -> Contacts:
        """Pairs, and faces and obstacles, that are nearer than they should be at the start."""
        s, report, near = way.settings, way.report, NO_CONTACTS
        if s.contact == "none":
            return near
        if pairs is not None:
            begin = perf_counter()
            before, after = (self.obstacles.corners(p, pairs.solid) for p in (way.before, way.after))
            near = pairs.begin(way.x, before, after, s.dt, s.thickness, way.over)
            self._share(report, pairs, 1e3 * (perf_counter() - begin))
        about = way.x, way.before, way.after, s.dt, s.thickness
        if not self.obstacles.felt(s).which.any():
            self._faces.begin(*about, None)
            return self._acting(near, way)
        with self._spent_on_obstacles(report):
            near = near.and_also(self._faces.begin(*about, self._near(way, way.x)))
        return self._acting(near, way)

    @contextmanager
    def _spent_on_obstacles(self, report: StepReport) -> Iterator[None]:
        """Book the time of the block for obstacles but meshes, and share it out among them.

        Evenly, as each one is asked about all vertices: among those that `_near` found last, or else among
        all that it was looked for.
        """
        begin = perf_counter()
        yield
        ms, which = 1e3 * (perf_counter() - begin), np.flatnonzero(self._asked)
        names = [OBSTACLE + self.obstacles.labels[o] for o in which]
        for name, part in ("obstacles", ms), *((name, ms / len(names)) for name in names):
            report.costs[name] = report.costs.get(name, 0.0) + part

    def _share(self, report: StepReport, pairs: Pairs, ms: float) -> None:
        """Book the time that was spent on pairs by whom they are with, and by their kind."""
        count, labels = len(COLLISIONS), self.obstacles.labels
        faces, edges = pairs.counts[:, 0], int(pairs.counts[:, EDGE_EDGE].sum())
        if not faces.sum() + edges:  # who is looked for, where nobody is found
            felt = np.isin(np.arange(len(faces) - count), pairs.solid.part)
            faces = np.concatenate([[pairs.feels.within, pairs.feels.between], felt]).astype(int)
            edges = int(pairs.feels.edges)
        whole = int(faces.sum()) + edges
        each = zip((*COLLISIONS, *(OBSTACLE + label for label in labels)), faces.tolist(), strict=False)
        for name, part in (*each, ("obstacles", int(faces[count:].sum())), ("edge_edge", edges)):
            if part:
                report.costs[name] = report.costs.get(name, 0.0) + ms * part / whole

    def _hits(self, way: _Way, pairs: Pairs | None, end: np.ndarray, part: float = 1.0) -> Contacts:
        """Pairs, and faces and obstacles, that meet on the way to `end`, to a `part` of the usual gap."""
        if way.settings.contact == "none" or way.settings.detection == "static":
            return NO_CONTACTS
        report, listed = way.report, 0.0 if pairs is None else pairs.listing
        with report.spent("continuous_detection"):
            hits = NO_CONTACTS if pairs is None else pairs.hits(end, part)
            hits = hits.and_also(self._faces.hits(end, self._near(way, end), part))
        if pairs is not None and pairs.listing > listed:  # a list serves static detection just as well
            made = 1e3 * (pairs.listing - listed)
            report.costs["continuous_detection"] -= made
            self._share(report, pairs, made)
        return self._acting(hits, way)

    def _detect(self, response: Response | None, way: _Way, end: np.ndarray) -> Contacts:
        """Contacts with obstacles on the way to `end`."""
        s = way.settings
        if response is None or not self.obstacles.felt(s).which.any():
            return NO_CONTACTS
        with self._spent_on_obstacles(way.report):
            shapes = self._near(way, end)
            if shapes is None:
                return NO_CONTACTS
            path = way.x, end, self._unpinned, s.dt
            about = shapes, way.before, way.after
            found = detect(*about, *path, s.thickness, s.detection == "continuous")
            if response.impulses and (found.start < 0.0).any():
                found = leave_together(found, *about, way.x, self._model.mesh.edges, s.dt)
            return self._acting(found, way)

    @staticmethod
    def _fitted(known: Contacts, more: Contacts, end: np.ndarray, report: StepReport) -> Contacts:
        """Both, with no more thickness than obstacles leave room for."""
        contacts, pinched = fit(known.and_also(more), end)
        report.pinched = max(report.pinched, pinched)
        return contacts

    def _gap_springs(
        self,
        response: Response | None,
        way: _Way,
        near: int,
        contacts: Contacts,
        end: np.ndarray,
        touched: Touch,
    ) -> GapSprings:
        if response is not None and way.report.pinched:  # there, forces grow from step to step without end
            response = replace(response, carries=False)
        state = self._model.inverse_masses, end, way.v, *touched.ahead(contacts.key, way.settings.dt)
        springs = gap_springs(response, contacts, near, *state, way.settings)
        springs.rub_like(way.springs)
        if response is not None and not response.solved:
            springs.drag[:] = 0.0  # only a solve can feel drag; all friction is given after the step
        return springs

    def _late(
        self,
        response: Response | None,
        way: _Way,
        contacts: Contacts,
        springs: GapSprings,
        end: np.ndarray,
    ) -> np.ndarray:
        """Vertices that an impulse would have to push, as the solve did not feel a contact that it led to."""
        if response is None or not (response.impulses and response.solved):
            return np.zeros(0, dtype=np.int64)
        felt = np.isin(contacts.key, springs.contacts.key)
        near = lacks(response, contacts, end, way.settings.dt) > way.settings.tolerance
        return contacts.node[near & ~felt, 0]

    def _respond(
        self,
        response: Response | None,
        pairs: Pairs | None,
        way: _Way,
        springs: GapSprings,
        contacts: Contacts,
        solution: Solution,
        last: bool,
    ) -> tuple[Solution, Touch] | None:
        """Impulses and friction after the solve."""
        s, h, report = way.settings, way.settings.dt, way.report
        report.contacts = max(len(contacts.key), len(springs.contacts.key))
        if response is None:
            return solution, UNTOUCHED
        if response.solved:
            pressed = springs.pushes(solution.positions, solution.velocities, h)
        else:  # it pushed as it did at the start
            pressed = h * np.maximum(-springs.elements.tension, 0.0)
        # One that presses and ends a hair beyond its thickness is found nowhere, but to forget it would let
        # its vertex sink in at the next step, as one that lands does, and be thrown back by an impulse.
        unseen = (pressed > 0.0) & ~np.isin(springs.contacts.key, contacts.key)
        contacts = contacts.and_also(springs.contacts.only(unseen))
        slip = springs.slip(solution.velocities)
        felt = touch(springs.contacts.key, pressed, slip, h)
        left = np.where(slip <= SLOW, s.friction * pressed - h * springs.drag * slip, 0.0)
        crept = touch(springs.contacts.key, np.maximum(left, 0.0), slip, h)
        known = felt, crept.of(contacts.key)[0]
        found = self._push(response, pairs, way, contacts, *known, solution, last)
        if found is None:
            return None
        end, met, pressed = found
        if response.impulses and response.solved:
            way.erupted = erupts(self._model, s, met, pressed, way.x, way.v, solution, end)
        pressing = touch(met.key, pressed, felt.of(met.key)[1], h)
        return None if way.erupted else (end, pressing._replace(over=way.over))

    def _push(
        self,
        response: Response,
        pairs: Pairs | None,
        way: _Way,
        contacts: Contacts,
        felt: Touch,
        crept: np.ndarray,
        solution: Solution,
        last: bool,
    ) -> tuple[Solution, Contacts, np.ndarray] | None:
        """Impulses and friction of contacts; the solve `felt` some, and left `crept` (c,) [N s] to rub.

        Returns:
            The end of the step, all contacts, and what each of them pressed with [N s]; None for a tangle.
        """
        s, h, report, inverse_masses = way.settings, way.settings.dt, way.report, self._model.inverse_masses
        solution = replace(
            solution, positions=solution.positions.copy(), velocities=solution.velocities.copy()
        )
        x, v = solution.positions, solution.velocities
        impulses = felt.of(contacts.key)[0]
        masses, given = contacts.masses(inverse_masses), np.zeros(len(impulses))
        wanted = targets(response, contacts, h)
        push = masses, inverse_masses, h, x, v
        way.part.respond_anew()
        if response.impulses:
            way.part.keep_apart(contacts, wanted, *push, given, report)
        if s.friction > 0.0:
            with report.spent("friction"):
                allowed = s.friction * (given if response.solved else impulses + given) + crept
                way.part.rub(contacts, *push, allowed)
        if response.impulses:
            way.part.keep_apart(contacts, wanted, *push, given, report)
        if not (response.impulses and s.detection == "continuous" and np.isfinite(x).all()):
            pressed = impulses + given
        elif (found := self._untangle(response, pairs, way, contacts, given, x, v, last)) is None:
            return None
        else:
            contacts, pressed = found
            pressed[: len(impulses)] += impulses
        return solution, contacts, pressed

    def _untangle(
        self,
        response: Response,
        pairs: Pairs | None,
        way: _Way,
        contacts: Contacts,
        given: np.ndarray,
        x: np.ndarray,
        v: np.ndarray,
        last: bool,
    ) -> tuple[Contacts, np.ndarray] | None:
        """Give pairs that would meet impulses until none does; None where that fails and another try is left.

        Contacts that came before keep their say, as do the impulses that they were `given`.

        Returns:
            All contacts, and the impulses [N s] that they were given after the solve.
        """
        s, h, report, inverse_masses = way.settings, way.settings.dt, way.report, self._model.inverse_masses
        resort = self._resort(pairs, way)
        for _ in range(MOST_ROUNDS):
            with report.phase("detect"):
                hits, lost = resort.met(x)
                beyond = self._detect(response, way, x)
                beyond = beyond.only(
                    ~np.isin(beyond.key, contacts.key) & (lacks(response, beyond, x, h) > s.tolerance)
                )
            if not len(hits.key) and not len(beyond.key):
                way.over = joined(way.over, resort.run_over(lost))
                return contacts, given
            report.hits += len(hits.key)
            known = len(contacts.key)
            contacts = self._fitted(contacts, hits.and_also(beyond), x, report)
            given = np.append(given, np.zeros(len(contacts.key) - known))
            before = given.copy()
            masses = contacts.masses(inverse_masses)
            push = masses, inverse_masses, h, x, v
            way.part.keep_apart(contacts, targets(response, contacts, h), *push, given, report)
            if s.friction > 0.0:
                way.part.rub(contacts, *push, s.friction * np.maximum(given - before, 0.0))
        return (contacts, given) if last and self._held_back(resort, way, x, v) else None

    def _resort(self, pairs: Pairs | None, way: _Way) -> LastResort:
        masses, hits_to = self._model.inverse_masses, partial(self._hits, way, pairs)
        return LastResort(self._faces, pairs, self._model.free, masses, hits_to)

    @staticmethod
    def _held_back(resort: LastResort, way: _Way, x: np.ndarray, v: np.ndarray) -> bool:
        """Let vertices go to `x` as far as nothing is met; False where halves might yet do better.

        What is held back gains no speed by it: forces that act on what does not give way do no work.
        """
        report = way.report
        with report.phase("detect"):
            held, over, lost = resort.hold_back(way.x, x)
        if len(over.key) and not way.deepest:
            return False
        which = np.flatnonzero(held)
        went = (x[which] - way.x[which]) / way.settings.dt
        way.part.slow(v, which, np.linalg.norm([went, way.v[which]], axis=2).max(axis=0))
        way.over = joined(way.over, resort.run_over(over.and_also(lost)))
        report.overruns += bool(len(over.key))
        report.held_back += len(which)
        report.failsafes += bool(len(which))
        return True
