"""Drives of scenes: motors that prescribe a joint's free component by an input or at constant speed."""

import math
from dataclasses import dataclass

from nassim.base.checks import above_zero, finite, freeze, known
from nassim.base.rigid_motion import DIRECTIONS
from nassim.scene.measures import Signal
from nassim.scene.part import Actuator
from nassim.scene.scene import Scene
from nassim.scene.terms import Constraint, PrescribedMotion


@dataclass(frozen=True)
class Drive(Actuator):
    """A stiff motor in a joint: one of its free components, of b against a, follows an input or runs at constant speed.

    An input that starts with a rate jolts what is at rest: in small motion all bodies. In large motion the bodies start
    to move with the drive as rigid bodies.

    Attributes:
        name: name of the drive.
        joint: name of the joint.
        direction: a direction that the joint leaves free, "x" ... "rz" of its axes; "" for its only one.
        input: name of the scene's input, displacement [m] or angle [rad], 0 at the start; "" for a constant speed.
        speed: constant speed from the start [m/s] or [rad/s].
        bandwidth: -3 dB frequency [Hz] of a servo between the input and the motion, a low-pass of first order. Without
            a servo, a velocity that follows the input at once is the input's derivative, which linear models refuse.
    """

    name: str
    joint: Signal
    direction: str = ""
    input: Signal = ""
    speed: float = 0.0
    bandwidth: float = math.inf

    def __post_init__(self) -> None:
        if self.direction:
            known("direction", self.direction, DIRECTIONS)
        freeze(
            self,
            speed=finite(f"drive {self.name!r}: speed", self.speed),
            bandwidth=above_zero(f"drive {self.name!r}: bandwidth", self.bandwidth, "Hz"),
        )
        if bool(self.input) == bool(self.speed):
            raise ValueError(
                f"drive {self.name!r} follows either an input or a constant speed that is not 0; give one of them, and "
                "at rest a joint that holds the direction"
            )
        if self.speed and math.isfinite(self.bandwidth):
            raise ValueError(f"drive {self.name!r} runs at constant speed, which needs no bandwidth; leave it out")

    def terms(self, scene: Scene) -> tuple[PrescribedMotion]:
        """Return the prescribed motion of the joint."""
        joints = {
            term.name: term for part in scene.joints for term in part.terms(scene) if isinstance(term, Constraint)
        }
        joint = joints[known(f"joint of drive {self.name!r}", self.joint, joints)]
        free = [d for d in DIRECTIONS if d not in joint.held]
        if not self.direction and len(free) != 1:
            raise ValueError(
                f"drive {self.name!r}: joint {self.joint!r} leaves {', '.join(free) or 'nothing'} free; give the "
                "direction that it drives"
            )
        direction = self.direction or free[0]
        if direction in joint.held:
            raise ValueError(
                f"drive {self.name!r}: joint {self.joint!r} holds {direction!r}; it leaves free: "
                f"{', '.join(free) or 'none'}"
            )
        if not any(scene.split(path)[0].moves for path in joint.points):
            raise ValueError(f"drive {self.name!r}: joint {self.joint!r} connects fixed bodies, which nothing moves")
        unit = "rad" if direction.startswith("r") else "m"
        return (PrescribedMotion(self.joint, direction, self.input, unit, self.speed, self.bandwidth),)

    def describe(self) -> str:
        """Describe the joint and its motion."""
        lag = f" with {self.bandwidth:g} Hz" if math.isfinite(self.bandwidth) else ""
        unit = "rad/s" if self.direction.startswith("r") else "m/s" if self.direction else "in SI units"
        does = f"follows {self.input}{lag}" if self.input else f"runs at {self.speed:g} {unit}"
        return f"drive {self.name}: {self.direction and self.direction + ' of '}joint {self.joint} {does}"
