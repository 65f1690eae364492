"""What the studies of cost write as JSON, as types: the published schema is made of them.

Times are in seconds, costs in milliseconds of wall time per simulated second, errors relative, unless a name
says otherwise.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta, Struct

from sim.settings import Settings

Cost = Annotated[float, Meta(ge=0.0, description="wall milliseconds per simulated second")]
Relative = Annotated[float, Meta(ge=0.0, description="relative")]
Seconds = Annotated[float, Meta(ge=0.0, description="simulated seconds")]
Hardware = dict[str, str | int | float | None]


class Growth(Struct, kw_only=True, frozen=True):
    """How fast runs that differ by a hair drift apart: the largest distance of any member."""

    times: list[float]
    distance: list[float]
    members: int
    horizon: Seconds
    reached: bool
    e_fold: float | None


class Truth(Struct, kw_only=True, frozen=True):
    """The reference: its step, how far it is from its checks at the horizon, how often it was refined."""

    integrator: str
    dt: float
    floor: Relative
    checks: dict[str, float]
    times: list[float]
    floor_by_time: list[float]
    refined: int


class Run(Struct, kw_only=True, frozen=True):
    """A measured run. `error` is the largest distance e_x from the reference up to the horizon."""

    settings: Settings
    changed: dict[str, Any]
    curves: list[str]
    ms: Cost
    ms_repeats: list[float]
    phases: dict[str, float]
    matvecs: Annotated[float, Meta(description="matrix–vector products per simulated second")]
    queries: Annotated[
        float, Meta(description="pairs of features looked at by contact, per simulated second")
    ]
    newton_per_step: float
    unconverged: Annotated[float, Meta(description="part of the steps whose solver did not converge")]
    stood_in: Annotated[float, Meta(description="part of the steps that backward Euler took instead")]
    error: Relative
    error_at_end: Relative
    error_energy: Relative
    error_strain: float
    error_observables: dict[str, float]
    penetrations: Annotated[int, Meta(description="most vertices inside an obstacle at the end of a step")]
    deepest: Annotated[float, Meta(description="m")]
    front: bool
    front_by_work: bool


class Failure(Struct, kw_only=True, frozen=True):
    """A run that a step ended."""

    settings: Settings
    changed: dict[str, Any]
    curves: list[str]
    reason: str


class Curve(Struct, kw_only=True, frozen=True):
    """Runs along which one knob is turned; `order` is the slope of its errors over the time step."""

    name: str
    order: float | None
    expected: int | None


class Source(Struct, kw_only=True, frozen=True):
    """What turning one knob towards accuracy changes of the chosen run; observables in their own units."""

    source: str
    what: str
    change: float | None
    observables: dict[str, float]
    reason: str = ""


class MeshLevel(Struct, kw_only=True, frozen=True):
    """The chosen settings on one of the nested meshes; observables at the horizon."""

    vertices: int
    ms: Cost
    observables: dict[str, float]
    error_observables: dict[str, float] | None


class Band(Struct, kw_only=True, frozen=True):
    """Mean and standard deviation of an observable over seeded runs."""

    settings: str
    observable: str
    members: int
    times: list[float]
    mean: list[float]
    deviation: list[float]


class Verdict(Struct, kw_only=True, frozen=True):
    """What to do about it."""

    target: Relative
    sentence: str
    dominates: str
    settings: dict[str, Any]
    toml: str
    ms: Cost
    error: Relative
    pays: Annotated[float, Meta(description="cost of the chosen settings over that of the recommended")]


class CostReport(Struct, kw_only=True, frozen=True):
    """`muslin cost`."""

    study: Literal["cost"] = "cost"
    scene: str
    command: str = ""
    date: str = ""
    seconds: Seconds
    vertices: int
    chosen: Settings
    horizon: Seconds
    floor: Relative
    why_horizon: str
    growth: Growth
    reference: Truth
    runs: list[Run]
    failed: list[Failure]
    curves: list[Curve]
    sources: list[Source]
    meshes: list[MeshLevel]
    bands: list[Band]
    verdict: Verdict
    notes: list[str]
    hardware: Hardware
    versions: dict[str, str]


class Balance(Struct, kw_only=True, frozen=True):
    """Where the energy of a run went [J], by entry: start + injected − dissipated + residual = energy.

    `turnover` is what changed its kind, without sign: the scale of `residual`, which does not add up.
    """

    start: float
    injected: Annotated[dict[str, float], Meta(description="an entry below zero took energy out")]
    dissipated: Annotated[dict[str, float], Meta(description="an entry below zero put energy in")]
    residual: float
    energy: Annotated[dict[str, float], Meta(description="by kind, at the end")]
    turnover: Annotated[float, Meta(ge=0.0)]


class Variant(Struct, kw_only=True, frozen=True):
    """One of the runs that are compared."""

    name: str
    settings: Settings
    ms: Cost | None
    ms_repeats: list[float]
    phases: dict[str, float]
    matvecs: float
    queries: float
    error: Annotated[float, Meta(description="largest distance from the reference up to the horizon")] | None
    floor: float | None
    energy: Annotated[dict[str, float], Meta(description="J by kind, at the end")]
    energy_start: float
    energy_change: Annotated[float, Meta(description="J; the total at the end less that at the start")]
    energy_rise: Annotated[
        float, Meta(description="J; the largest rise of the total above its smallest before")
    ]
    balance: Annotated[Balance, Meta(description="of a run of its own, which is not timed")]
    penetrations: Annotated[int, Meta(description="most vertices inside an obstacle at the end of a step")]
    deepest: Annotated[float, Meta(description="m")]
    crossings: Annotated[
        int, Meta(description="most edges that go through triangles, of cloth or mesh obstacles, at a look")
    ]
    stretch: Annotated[float, Meta(description="largest strain of an edge seen")]
    observables: dict[str, float]
    stopped: str


class CompareReport(Struct, kw_only=True, frozen=True):
    """`muslin compare`."""

    study: Literal["compare"] = "compare"
    scene: str
    command: str = ""
    date: str = ""
    seconds: Seconds
    vertices: int
    by: str
    reference: Annotated[str, Meta(description="what errors are told against, or why they are not")]
    horizon: Seconds | None
    growth: Growth
    variants: list[Variant]
    notes: list[str]
    hardware: Hardware
    versions: dict[str, str]


class AuditedEffect(Struct, kw_only=True, frozen=True):
    """What an audit found of one effect."""

    name: str
    now: Annotated[Literal["auto", "on", "off"], Meta(description="as the scene has it")]
    verdict: Literal["matters", "below the numerical error", "uncertain"]
    cost_share: Annotated[float, Meta(description="what it adds to a step, as part of the step as it is")]
    own_ms: Annotated[float, Meta(description="ms per step of the work that is done for it alone")]
    influence: Annotated[float, Meta(description="relative")] | None
    errors: Annotated[float, Meta(description="influence over the numerical error of the window")] | None
    ran: Annotated[float, Meta(ge=0.0, le=1.0, description="part of the steps")]
    why: Annotated[str, Meta(description="what the last step said of it")]


class AuditReport(Struct, kw_only=True, frozen=True):
    """`muslin audit`. An influence that is null is that of a run which failed."""

    study: Literal["audit"] = "audit"
    scene: str
    command: str = ""
    date: str = ""
    seconds: Seconds
    vertices: int
    settings: Settings
    tolerance: Relative
    numerical_error: Relative
    cost_noise: Annotated[
        float, Meta(ge=0.0, description="how far costs are off, as part of the step as it is")
    ]
    windows: int
    ms: Annotated[float, Meta(ge=0.0, description="wall milliseconds per step as it is")]
    effects: list[AuditedEffect]
    recommended: Annotated[dict[str, str], Meta(description="effects to force, as in a scene file")]
    recommended_ms: Annotated[float, Meta(ge=0.0, description="wall milliseconds per step with those")]
    recommended_error: Relative
    toml: str
    notes: list[str]
    hardware: Hardware
    versions: dict[str, str]


REPORTS: dict[str, type[Struct]] = {"cost": CostReport, "compare": CompareReport, "audit": AuditReport}


def schema(study: str) -> dict[str, Any]:
    """The JSON schema (draft 2020-12) of what a study writes.

    Args:
        study: One of REPORTS.
    """
    made = msgspec.json.schema(REPORTS[study])
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": f"muslin {study}", **made}
