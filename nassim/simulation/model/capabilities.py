"""What an engine cannot do with a term: one table, read before a run.

Every engine realises every law on every measure, but for the rows below. A term that no engine knows is refused when a
scene is made, see `nassim.scene.terms`.
"""

from collections.abc import Callable
from dataclasses import dataclass

from nassim.scene.scene import Scene
from nassim.scene.terms import BaseAcceleration, Constraint, ForceLaw, Output, Term

EXACT, LARGE_MOTION = "exact steps", "large motion"
"""Engines with limits; models of small motion, stepped by Exudyn, have none."""


@dataclass(frozen=True)
class Limit:
    """A kind of term that an engine refuses.

    Attributes:
        engine: "exact steps" or "large motion".
        applies: whether the limit applies to a term of a scene.
        reason: why, and what to do.
    """

    engine: str
    applies: Callable[[Scene, Term], bool]
    reason: str


def _is_nonlinear(_scene: Scene, term: Term) -> bool:
    return isinstance(term, ForceLaw) and not term.is_linear


def _records_quasi_velocity(_scene: Scene, term: Term) -> bool:
    return isinstance(term, Output) and not term.measure.has_value and not term.derivative


def _ties_three_bodies(scene: Scene, term: Term) -> bool:
    moving = {body.name for body in scene.bodies if body.moves}
    return isinstance(term, Constraint) and len(moving & set(term.measure.bodies)) > 2


def _base_turns(_scene: Scene, term: Term) -> bool:
    return isinstance(term, BaseAcceleration) and bool(term.axes_of)


LIMITS = (
    Limit(EXACT, _is_nonlinear, "is not linear, as no spring with a preload is: take the method generalized_alpha"),
    Limit(
        LARGE_MOTION,
        _records_quasi_velocity,
        "has a value in small motion only: take derivative=1, or a Displacement or a RotationAngle",
    ),
    Limit(LARGE_MOTION, _base_turns, "turns with a body, which is for small motion only: take the world's axes"),
    Limit(
        LARGE_MOTION,
        _ties_three_bodies,
        "constrains more than two moving bodies, which Exudyn cannot: take a stiff Spring on the measure",
    ),
)


def check_capabilities(scene: Scene, engine: str) -> None:
    """Check that an engine can do all terms of a scene.

    Args:
        scene: the scene.
        engine: "exact steps" or "large motion".

    Raises:
        ValueError: for a part whose term the engine cannot do, with the part's name and the reason.
    """
    for part in scene.parts:
        for term in part.terms(scene):
            for limit in LIMITS:
                if limit.engine == engine and limit.applies(scene, term):
                    what = type(term).__name__
                    measure = getattr(term, "measure", None)
                    on = f" on a {type(measure).__name__}" if measure is not None else ""
                    raise ValueError(f"{engine}: the {what}{on} of {type(part).__name__} {part.name!r} {limit.reason}")
