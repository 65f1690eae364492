"""The way of a step through contact: detect, feel contacts in the solve, detect again, respond.

With impulses and continuous detection the step ends as it began, free of intersections. That rests on four
things: detection misses nothing, on a list of pairs that holds for every place a vertex has been at; pairs
that start nearer than the usual gap have a smaller one of their own; after every change of positions pairs
are detected anew; and where impulses do not find a way, the step is done in halves, and at last vertices go
no farther than they can without meeting anything.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from msgspec.structs import replace as replaced

from sim.contact.contacts import NO_CONTACTS, UNTOUCHED, UNWATCHED, Contacts, Touch, touch
from sim.contact.detectors import Detectors
from sim.contact.eruption import erupts
from sim.contact.friction import SLOW
from sim.contact.gap import NO_GAP_SPRINGS, GapSprings, gap_springs
from sim.contact.last_resort import LastResort
from sim.contact.obstacles import MESH, Obstacles
from sim.contact.overrun import found_over, joined, still_over
from sim.contact.pinch import fit
from sim.contact.reach import box, within_reach
from sim.contact.response import RESPONSES, Response, lacks, targets
from sim.contact.way import Solve, Way
from sim.effects import OBSTACLE
from sim.integrators import CALM, INTEGRATORS
from sim.ledger import UNBOOKED, Part
from sim.model import Model
from sim.report import StepReport
from sim.scene import Scene
from sim.settings import Settings
from sim.solve.implicit import Solution

MOST_SOLVES = 3
"""Solves of one step at most: one more where a solve led vertices into contacts that it did not feel."""

MOST_ROUNDS = 8
"""Rounds of impulses and continuous detection before a step is done in halves."""

STALLED, STILL = 2, 1e-2
"""Rounds running that met just what the one before did, and moved no vertex by this part of the thickness
since, after which none is tried: they lead nowhere."""

MOST_HALVINGS = 5
"""Times that a step is halved before vertices are held back."""

NEWTON, STIFFER = 2, 10.0
"""Newton iterations of a step that put in energy with fewer, as their line search asks the springs; and how
much stiffer its gap springs are where it was impulses, which do not ask: so they have less to do."""

LIMITED = MOST_HALVINGS - 2
"""Halvings left at which cloth may stretch beyond its limit, which might leave it no way past obstacles."""

MOST_PARTS = 128
"""Parts that a step is done in; the last of them end as well as they can in one go."""

MOST_FAILSAFES = 4
"""Parts of a step whose vertices were held back, after which no other part is halved: it is of no use."""

MOST_DEEPER = 7
"""Times that a step is halved beyond that where an obstacle would run over what is held back."""

MOST_OVERRUNS = 4
"""Parts of a step in which one did after all: it is a pinch, and no other part is halved so often for it."""


class Pipeline:
    """Contact of a scene's cloth with obstacles and with itself.

    Attributes:
        obstacles: Of the scene.
        touched: What the contacts of the last step remember.
        booked: Whether a ledger is kept; then `parts` has the books of each part of the last step.
    """

    def __init__(self, scene: Scene, model: Model) -> None:
        self.obstacles = Obstacles(scene, model.mesh.shells)
        self._model, self._detectors = model, Detectors(model, self.obstacles)
        self.booked, self.parts = False, []
        self.touched = UNTOUCHED

    def forget(self) -> None:
        """Start with nothing touched."""
        self.touched = UNTOUCHED
        self._detectors.forget()

    @property
    def joins(self) -> np.ndarray:
        """(k, 2) parts of the cloth that contacts joined in the last step, where some of it may sleep."""
        return self._detectors.joins

    def depths(self, time: float, positions: np.ndarray, settings: Settings | None = None) -> np.ndarray:
        """As `sim.contact.detectors.Detectors.depths`."""
        return self._detectors.depths(time, positions, settings)

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
        self.parts = []
        self._detectors.begin(settings)
        response = self._response(settings)
        touched = self._not_apart(settings, response, time, x)
        solution, after = self._part(
            self._way(settings, response, time, x, v, touched, solve, report), MOST_HALVINGS
        )
        self._detectors.tell(report)
        if len(resting := self._detectors.resting):
            after = after.and_also(self.touched.only(np.isin(self.touched.key, resting)).still())
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

    def _way(
        self,
        settings: Settings,
        response: Response | None,
        time: float,
        x: np.ndarray,
        v: np.ndarray,
        touched: Touch,
        solve: Solve,
        report: StepReport,
    ) -> Way:
        poses = self.obstacles.poses(time), self.obstacles.poses(time + settings.dt)
        part = UNBOOKED
        if self.booked:
            with report.spent("ledger", alone=True):
                part = Part(self._model, x, v)
        return Way(settings, response, time, *poses, x, v, touched, solve, report, part, touched.over)

    def _part(self, way: Way, halvings: int) -> tuple[Solution, Touch]:
        """Take a step, or where that leads to a tangle its two halves one after the other.

        One that puts in energy is first repeated, from where it led, with more Newton iterations: cloth
        that is stopped within an edge's length stretches in a way that no linear model tells.
        """
        report = way.report
        spent = self._spent(report)
        way.last = spent or halvings <= 0 or report.failsafes >= MOST_FAILSAFES
        few = halvings <= 0 and report.overruns >= MOST_OVERRUNS
        way.deepest = spent or halvings == -MOST_DEEPER or few
        found = self._attempt(way)
        if way.erupted and way.response is not None and way.settings.newton < NEWTON:
            response = way.response
            if way.erupted == "impulses":
                response = replace(response, stiffness=STIFFER * response.stiffness)
            settings = replaced(way.settings, newton=NEWTON)
            way = replace(way, settings=settings, response=response, erupted="")
            found = self._attempt(way)
        if way.erupted and way.last:
            found = self._unfelt(way)
        if found is not None:
            if isinstance(way.part, Part):
                with report.spent("ledger", alone=True):
                    way.part.close(found[0])
                self.parts.append(way.part)
            return found
        report.substeps += 1
        limit = way.settings.strain_limit if halvings > LIMITED else 0.0
        half = replaced(way.settings, dt=0.5 * way.settings.dt, strain_limit=limit)
        x, v, touched = way.x, way.v, way.touched
        for time in (way.time, way.time + half.dt):
            about = half, way.response, time, x, v, touched, way.solve, report
            solution, touched = self._part(self._way(*about), halvings - 1)
            x, v = solution.positions, solution.velocities
        return solution, touched

    def _attempt(self, way: Way) -> tuple[Solution, Touch] | None:
        """Take a step in one go; None where it would end in a tangle and is not the last try.

        Contacts are looked for where vertices are and on the way that they would take by themselves; then on
        the way that they took, and the step solved again where that led into some.
        """
        s, response, report, h = way.settings, way.response, way.report, way.settings.dt
        way.over = way.touched.over
        if response is None or self._detectors.idle(s):
            return self._solved_unfelt(way), UNTOUCHED._replace(over=way.over)
        if response.projects:
            return self._projected(way)
        fall = self._model.confined(np.broadcast_to(h * np.asarray(s.gravity), way.x.shape))
        end = way.x + h * (way.v + fall)
        look = self._detectors
        with report.phase("detect"):
            near = look.at_start(way)
        if look.pairs is not None:
            report.near, report.candidates = len(near.key), look.pairs.listed
            report.thickness = look.pairs.thickness
        solves = 0
        while True:
            with report.phase("detect"):
                found = self._fitted(near, look.of_vertices(way, end), end, report)
                springs = self._gap_springs(way, response, len(near.key), found, end)
            with report.phase("solve"):
                solution = way.solve(springs, s, way.x, way.v, way.guess)
            way.springs, way.guess = springs, solution.velocities
            with report.phase("detect"):
                x = solution.positions
                contacts = self._fitted(near, look.of_vertices(way, x), x, report)
                lack = (lacks(response, c, x, h) for c in (contacts, springs.contacts))
                contacts = contacts.or_else(springs.contacts, *lack)
                late = self._late(way, response, contacts.only(slice(len(near.key), None)), x)
                hits = NO_CONTACTS
                if not (response.impulses and s.newton == 1):  # those, impulses stop
                    hits = look.on_the_way(way, x)
                    hits = hits.only(~np.isin(hits.key, near.key))
            solves, report.iterations = solves + 1, report.iterations + solution.iterations
            if not (len(late) or len(hits.key)) or solves == MOST_SOLVES:
                break
            end[late] = x[late]
            node = hits.node[hits.weight != 0.0]
            end[node] = x[node]
            near = near.and_also(hits)
        with report.phase("respond"):
            return self._respond(way, response, contacts, solution)

    @staticmethod
    def _solved_unfelt(way: Way) -> Solution:
        """Where a step leads that feels no contact."""
        with way.report.phase("solve"):
            solution = way.solve(NO_GAP_SPRINGS, way.settings, way.x, way.v, None)
        way.report.iterations += solution.iterations
        return solution

    def _unfelt(self, way: Way) -> tuple[Solution, Touch] | None:
        """Take a step that feels no contact and hold back what meets; None where halves might do better.

        For where contacts ask for what only a throw could do, however short the step.
        """
        solution = self._solved_unfelt(way)
        way.part.respond_anew()
        resort = self._detectors.last_resort(way)
        if not self._held_back(resort, way, solution.positions, solution.velocities):
            return None
        return solution, UNTOUCHED._replace(over=way.over)

    def _projected(self, way: Way) -> tuple[Solution, Touch]:
        """Take a step that feels nothing, then put right what it led into.

        As where contacts are felt, that is a step of backward Euler: what others keep of the energy that
        projection puts into springs would grow from step to step.
        """
        s, report = way.settings, way.report
        solution, seen, met, touching = self._led_into(way)
        if INTEGRATORS[s.integrator].implicit and s.integrator != CALM:
            found = met.and_also(touching)
            if (found.gaps(solution.positions) < found.thickness).any():
                calm = replace(way, settings=replaced(s, integrator=CALM))
                solution, seen, met, touching = self._led_into(calm)
        x, v = solution.positions, solution.velocities
        self._put_right(way, met.and_also(touching), x, v)
        report.contacts = len(met.key) + len(touching.key)
        if len(met.key):  # which may have pushed vertices into obstacles that they did not touch
            with report.phase("detect"):
                touching = self._detectors.of_vertices(seen, x)
            self._put_right(way, touching, x, v)
        return solution, UNTOUCHED

    def _led_into(self, way: Way) -> tuple[Solution, Way, Contacts, Contacts]:
        """A step that feels nothing, the way on which it is seen, and what pairs and vertices it led into."""
        solution, look = self._solved_unfelt(way), self._detectors
        x = solution.positions
        if not np.isfinite(x).all():
            return solution, way, NO_CONTACTS, NO_CONTACTS
        with way.report.phase("detect"):
            static = replace(way, before=way.after, x=x)
            seen, hits = static, NO_CONTACTS
            if way.settings.detection == "continuous":
                seen = way
                look.at_start(way)
                hits = look.on_the_way(way, x)
            met = hits.and_also(look.at_start(static))
            return solution, seen, met, look.of_vertices(seen, x)

    def _put_right(self, way: Way, contacts: Contacts, x: np.ndarray, v: np.ndarray) -> None:
        """Take the contacts' overlaps out of `x` (n, 3) [m], and the speed at which they close out of `v`."""
        masses = self._model.inverse_masses
        with way.report.phase("respond"):
            way.part.project(contacts, way.settings.friction, contacts.masses(masses), masses, x, v)

    def _response(self, settings: Settings) -> Response | None:
        """How cloth answers; forces that are not solved for must be soft enough for an explicit step."""
        response = RESPONSES.get(settings.contact)
        if response is None or INTEGRATORS[settings.integrator].implicit or not response.solved:
            return response
        return replace(
            response, stiffness=1.0, damping=min(response.damping, 0.5), carries=False, solved=False
        )

    @staticmethod
    def _fitted(known: Contacts, more: Contacts, end: np.ndarray, report: StepReport) -> Contacts:
        """Both, with no more thickness than obstacles leave room for."""
        contacts, pinched = fit(known.and_also(more), end)
        report.pinched = max(report.pinched, pinched)
        return contacts

    def _gap_springs(
        self, way: Way, response: Response, near: int, contacts: Contacts, end: np.ndarray
    ) -> GapSprings:
        if way.report.pinched:  # there, forces grow from step to step without end
            response = replace(response, carries=False)
        ahead = way.touched.ahead(contacts.key, way.settings.dt)
        state = self._model.inverse_masses, end, way.x, way.v, *ahead
        springs = gap_springs(response, contacts, near, *state, way.settings)
        springs.begin_like(way.springs)
        if not response.solved:
            springs.drag[:] = 0.0  # only a solve can feel drag; all friction is given after the step
        return springs

    @staticmethod
    def _late(way: Way, response: Response, contacts: Contacts, end: np.ndarray) -> np.ndarray:
        """Vertices that an impulse would have to push, as the solve did not feel a contact that it led to."""
        if not (response.impulses and response.solved):
            return np.zeros(0, dtype=np.int64)
        felt = np.isin(contacts.key, way.springs.contacts.key)
        near = lacks(response, contacts, end, way.settings.dt) > way.settings.tolerance
        return contacts.node[near & ~felt, 0]

    def _respond(
        self, way: Way, response: Response, contacts: Contacts, solution: Solution
    ) -> tuple[Solution, Touch] | None:
        """Impulses and friction after the solve."""
        s, h, springs, report = way.settings, way.settings.dt, way.springs, way.report
        report.contacts = max(len(contacts.key), len(springs.contacts.key))
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
        found = self._push(way, response, contacts, *known, solution)
        if found is None:
            return None
        end, met, pressed = found
        tries_more = response.impulses or s.newton < NEWTON  # penalty has nothing beyond that
        if response.solved and tries_more:
            way.erupted = erupts(self._model, s, met, pressed, way.x, way.v, solution, end)
        pressing = touch(met.key, pressed, felt.of(met.key)[1], h)
        return None if way.erupted else (end, pressing._replace(over=way.over))

    def _push(
        self,
        way: Way,
        response: Response,
        contacts: Contacts,
        felt: Touch,
        crept: np.ndarray,
        solution: Solution,
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
        elif (found := self._untangle(way, response, contacts, given, x, v)) is None:
            return None
        else:
            contacts, pressed = found
            pressed[: len(impulses)] += impulses
        return solution, contacts, pressed

    def _untangle(
        self,
        way: Way,
        response: Response,
        contacts: Contacts,
        given: np.ndarray,
        x: np.ndarray,
        v: np.ndarray,
    ) -> tuple[Contacts, np.ndarray] | None:
        """Give pairs that would meet impulses until none does; None where that fails and another try is left.

        Contacts that came before keep their say, as do the impulses that they were `given`.

        Returns:
            All contacts, and the impulses [N s] that they were given after the solve.
        """
        s, h, report, inverse_masses = way.settings, way.settings.dt, way.report, self._model.inverse_masses
        resort, stalls, met, places = self._detectors.last_resort(way), 0, NO_CONTACTS.key, way.x
        for _ in range(MOST_ROUNDS):
            with report.phase("detect"):
                hits, lost = resort.met(x)
                beyond = self._detectors.of_vertices(way, x)
                beyond = beyond.only(
                    ~np.isin(beyond.key, contacts.key) & (lacks(response, beyond, x, h) > s.tolerance)
                )
            if not len(hits.key) and not len(beyond.key):
                way.over = joined(way.over, resort.run_over(lost))
                return contacts, given
            again = np.sort(np.append(hits.key, beyond.key))
            still = np.array_equal(again, met) and np.abs(x - places).max() < STILL * s.thickness
            stalls, met, places = (stalls + 1 if still else 0), again, x.copy()
            if stalls == STALLED:
                break
            report.hits += len(hits.key)
            known = len(contacts.key)
            contacts = self._fitted(contacts, hits.and_also(beyond), x, report)
            given = np.append(given, np.zeros(len(contacts.key) - known))
            had = given.copy()
            masses = contacts.masses(inverse_masses)
            push = masses, inverse_masses, h, x, v
            way.part.keep_apart(contacts, targets(response, contacts, h), *push, given, report)
            if s.friction > 0.0:
                way.part.rub(contacts, *push, s.friction * np.maximum(given - had, 0.0))
        return (contacts, given) if way.last and self._held_back(resort, way, x, v) else None

    def _held_back(self, resort: LastResort, way: Way, x: np.ndarray, v: np.ndarray) -> bool:
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
        report.cut_short |= self._spent(report) and bool(len(which))
        return True

    def _spent(self, report: StepReport) -> bool:
        """Whether a budget of the step leaves no more parts: that of pairs asked, or that of parts."""
        return self._detectors.many or report.substeps >= MOST_PARTS
