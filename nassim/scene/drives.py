"""Drives of scenes: motors that prescribe a joint's free component by an input, at constant speed or at rest."""

import math
from dataclasses import dataclass

from nassim.base.checks import above_zero, finite, freeze, known
from nassim.base.rigid_motion import DIRECTIONS
from nassim.scene.field_kinds import Signal
from nassim.scene.part import Actuator
from nassim.scene.scene import Scene
from nassim.scene.terms import Constraint, PrescribedMotion


@dataclass(frozen=True)
class Drive(Actuator):
    """A stiff motor in a joint: one of its free components, of b against a, follows an input or runs at constant speed.

    An input that starts with a rate jolts what is at rest: in small motion all bodies. In large motion the bodies start
    to move with the drive as rigid bodies. Where drives turn a joint about several of its axes, the angles follow one
    another: about x of a, then about the y that turned with it, then about z. Where a joint leaves two rotations free,
    the axis of the first stays in a and that of the second in b, as in a universal joint. This holds too where a drive
    turns only one of them.

    Attributes:
        name: name of the drive.
        joint: name of the joint.
        direction: a direction that the joint leaves free, "x" ... "rz" of its axes; "" for its only one.
        input: name of the scene's input, displacement [m] or angle [rad], 0 at the start; "" for a constant speed.
        speed: constant speed from the start [m/s] or [rad/s]; 0 holds the component, None with an input.
        bandwidth: -3 dB frequency [Hz] of a servo between the input and the motion, a low-pass of first order. Without
            a servo, a velocity that follows the input at once is the input's derivative, which linear models refuse.
    """

    name: str
    joint: Signal
    direction: str = ""
    input: Signal = ""
    speed: float | None = None
    bandwidth: float = math.inf

    def __post_init__(self) -> None:
        if self.direction:
            known("direction", self.direction, DIRECTIONS)
        if self.speed is not None:
            freeze(self, speed=finite(f"drive {self.name!r}: speed", self.speed))
        freeze(self, bandwidth=above_zero(f"drive {self.name!r}: bandwidth", self.bandwidth, "Hz"))
        if not self.input and self.speed is None:
            raise ValueError(
                f"drive {self.name!r} has neither an input nor a speed: name an input that it follows, or give a "
                "constant speed, 0 for a drive that holds its direction"
            )
        if self.input and self.speed:
            raise ValueError(f"drive {self.name!r} follows either an input or a constant speed; give one of them")
        if not self.input and math.isfinite(self.bandwidth):
            raise ValueError(f"drive {self.name!r} runs at constant speed, which needs no bandwidth; leave it out")

    def terms(self, scene: Scene) -> tuple[PrescribedMotion | Constraint]:
        """Return the prescribed motion of the joint, or at rest a constraint."""
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
                f"{', '.join(free) or 'none'}, a direction of its own axes; where one is free, leave the direction out"
            )
        if not any(scene.split(path)[0].moves for path in joint.points):
            raise ValueError(f"drive {self.name!r}: joint {self.joint!r} connects fixed bodies, which nothing moves")
        if self.speed == 0 and not self.input:
            return (Constraint(f"{self.name} at rest", joint.measure, (direction,)),)
        unit = "rad" if direction.startswith("r") else "m"
        return (PrescribedMotion(self.joint, direction, self.input, unit, self.speed or 0.0, self.bandwidth),)

    def describe(self) -> str:
        """Describe the joint and its motion."""
        lag = f" with {self.bandwidth:g} Hz" if math.isfinite(self.bandwidth) else ""
        unit = "rad/s" if self.direction.startswith("r") else "m/s" if self.direction else "in SI units"
        runs = f"runs at {self.speed:g} {unit}" if self.speed else "is held at rest"
        does = f"follows {self.input}{lag}" if self.input else runs
        return f"drive {self.name}: {self.direction and self.direction + ' of '}joint {self.joint} {does}"
