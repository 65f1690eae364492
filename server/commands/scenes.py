"""`muslin run`, `check` and `scenes`: scenes without a page."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from typing import Annotated

from tyro.conf import Positional, arg

from server.commands.options import Overrides, SceneName, Texts, parse_settings
from server.commands.speech import complain, say
from sim.scene import Scene, SceneError, load_scene, read_scene, scene_files


@dataclass(kw_only=True)
class Run:
    """Run a scene without a page and say what it cost."""

    scene: SceneName
    """A scene file, or one of `muslin scenes`."""
    seconds: float = 2.0
    """Time to simulate [s]."""
    overrides: Overrides = ()
    """Settings that differ from the scene's, such as gamma=0.5."""
    out: Annotated[str | None, arg(metavar="FILE.npz")] = None
    """Record the positions of every frame."""
    fps: float = 60.0
    """Frames per simulated second in the recording; never more than steps."""
    json: Annotated[str | None, arg(metavar="FILE.json")] = None
    """Write the table's numbers as JSON."""

    def __call__(self) -> int:
        """Do it and return the exit code."""
        from server.headless import run

        overrides = parse_settings([text for texts in self.overrides for text in texts])
        return run(load_scene(self.scene), overrides, self.seconds, self.fps, self.out, self.json)


@dataclass(kw_only=True)
class Check:
    """Check scenes, build their cloth and say what looks like a mistake."""

    scenes: Annotated[Texts, Positional, arg(metavar="SCENE ...")] = ()
    """Scene files; all that come with Muslin if none is given."""

    def __call__(self) -> int:
        """Do it and return the exit code."""
        from sim.check import check_scene, memory
        from sim.refusal import counted

        failures = 0
        for name in self.scenes or map(str, scene_files()):
            try:
                mesh, warnings = check_scene(read_scene(name))
            except SceneError as error:
                failures += 1
                complain(error)
                continue
            for warning in warnings:
                say(f"{name}: {warning}")
            vertices = counted(len(mesh.vertices), "vertex", "vertices")
            triangles = counted(len(mesh.triangles), "triangle")
            warned = f", {counted(len(warnings), 'warning')}" if warnings else ""
            pinned, needed = f"{len(mesh.pinned):,} pinned", f"some {memory(mesh):,.0f} MB to simulate"
            say(f"{name}: fine: {vertices}, {triangles}, {pinned}, {needed}{warned}")
        return 1 if failures else 0


@dataclass(kw_only=True)
class Scenes:
    """List the scenes that come with Muslin."""

    def __call__(self) -> int:
        """Do it and return the exit code."""
        from rich.console import Console
        from rich.table import Table

        table = Table("scene", "title", "vertices", "what to look for")
        table.columns[2].justify = "right"
        for path in scene_files():
            scene = read_scene(path)
            lesson = scene.lesson
            count = f"{n:,}" if (n := count_vertices(scene)) is not None else "–"
            table.add_row(path.stem, lesson.title if lesson else "", count, lesson.look_for if lesson else "")
        Console(width=None if sys.stdout.isatty() else 120).print(table)
        return 0


def count_vertices(scene: Scene) -> int | None:
    """Vertices of a scene without building its mesh; None where only building it can tell."""
    from sim.scene import Arrays, Equilateral, Grid

    total = 0
    for cloth in scene.cloth:
        if isinstance(cloth, Grid | Equilateral):
            total += cloth.resolution[0] * cloth.resolution[1]
            total += cloth.resolution[1] // 2 if isinstance(cloth, Equilateral) else 0
        elif isinstance(cloth, Arrays):
            total += len(cloth.vertices)
        else:
            from sim.meshclaims import vertex_count

            claimed = vertex_count(cloth.file, scene.folder)
            if claimed is None:
                return None
            total += claimed
    return total
