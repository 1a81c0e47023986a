"""The APA300ML and its bench by hand: four arms, a stack line, two levers. Explained in docs/actuator.md.

By symmetry one quarter tells all. Its arm is a beam that neither end lets turn: at the pad it may only rise (w), at the
end block only move out (u). Along its axis it is as stiff as a bar, across it as a beam that is guided at both ends:

    stretch a = u cos t + w sin t,   deflection p = u sin t - w cos t,   t: slope of the arm

    energy of the whole actuator = 2 k_a a^2 + 2 k_b p^2 + 1/2 k_l (2 u - e)^2

with e the free elongation of the stack line and k_l its stiffness, in series with what the end blocks bend between
stack and arms (the levers). Nothing here is fitted, and nothing is taken from finite elements.
"""

import math
from dataclasses import dataclass

import numpy as np

from models.apa300ml import PZT, STACK, STEEL, APAGeometry

SECTION = 10e-3
"""Sides of the stacks' cross-section [m]."""
STACK_LINE = 65e-3
"""Three stacks of 20 mm and the spacer [m]."""
SPACER = 5e-3
ARM_START = (4.5e-3, 12.06e-3)
"""Middle of the arm where it leaves the pad: x, z [m]."""
SLOPE = math.radians(9.98)
BLOCK_START, BLOCK_END = 32.5e-3, 39.397e-3
"""From the stack's end to the outside of the end block [m]."""
MOVING_MASS = 0.035
"""What of the actuator moves with the payload [kg]: the upper pad and most of its arms, and a quarter of stack line and
end blocks, which rise half as far."""
ROOT = 0.4
"""Built-in ends turn a little: each lengthens a beam by so many thicknesses (W. J. O'Donnell, J. Appl. Mech. 27 (1960)
461-464: a root in a half plane turns by 5.3 (1 - nu^2) M / (E b t^2))."""


@dataclass(frozen=True)
class BeamModel:
    """Stiffnesses that the hand calculation needs [N/m], per quarter or of the line.

    arm_length: between the roots, their own turning included [m]
    stretching, bending: of one arm along and across its axis; line: of the stack line with the end blocks' bending
    open_line: with the sensor stack's charge held; span: of one stack at constant voltage
    """

    arm_length: float
    stretching: float
    bending: float
    line: float
    open_line: float
    span: float


def beam_model(geometry: APAGeometry | None = None, *, pzt_modulus: float = PZT.young_modulus) -> BeamModel:
    """The stiffnesses from dimensions and moduli."""
    g = geometry or APAGeometry()
    e, depth, t = STEEL.young_modulus, g.depth, g.arm_thickness
    end = BLOCK_START + g.relief
    length = (end - ARM_START[0]) / math.cos(SLOPE) + 2 * ROOT * t
    bending = e * depth * t**3 / length**3  # 12 E I / l^3
    area = SECTION**2
    span = pzt_modulus * area / STACK.length
    spacer = e * area / SPACER
    # An open stack is stiffer by its coupling factor: k33^2 = d^2 k / C.
    opened = span / (1 - STACK.stroke_per_volt**2 * span / STACK.capacitance)
    lever = 2 / _block_stiffness(g)
    return BeamModel(
        length,
        e * depth * t / length,
        bending,
        1 / (3 / span + 1 / spacer + lever),
        1 / (2 / span + 1 / opened + 1 / spacer + lever),
        span,
    )


def _block_stiffness(g: APAGeometry) -> float:
    """Of one end block as a short beam between its two arms, pushed by the stack over its middle [N/m]."""
    height = BLOCK_END - BLOCK_START
    # The slots leave the block as high as the stack with its margins, 11 mm; the arms pull at its outer corners.
    arm_end = ARM_START[1] - (BLOCK_START + g.relief - ARM_START[0]) * math.tan(SLOPE)
    reach, half = arm_end, SECTION / 2
    shear = STEEL.young_modulus / (2 * (1 + STEEL.poisson_ratio))
    inertia, area = g.depth * height**3 / 12, g.depth * height
    # Middle of the loaded part against the ends of a beam of 2 reach, uniform load over 2 half; Timoshenko's shear 6/5.
    bend = (8 * reach**3 - 4 * reach * half**2 + half**3) / (48 * STEEL.young_modulus * inertia)
    slide = 1.2 * (2 * reach - half) / (4 * shear * area)
    return 1 / (bend + slide)


def _elasticity(model: BeamModel, line: float) -> np.ndarray:
    """Matrix of the energy in (u, w) with a stack line of the given stiffness, (2, 2)."""
    c, s = math.cos(SLOPE), math.sin(SLOPE)
    stretch, across, out = np.array([c, s]), np.array([s, -c]), np.array([2.0, 0.0])
    shell = 4 * (model.stretching * np.outer(stretch, stretch) + model.bending * np.outer(across, across))
    result: np.ndarray = shell + line * np.outer(out, out)
    return result


def axial_stiffness(model: BeamModel, *, line: float | None = None) -> float:
    """Force over elongation between the pads [N/m]; line: stiffness of the stack line (default: all stacks shorted)."""
    flexibility = np.linalg.inv(_elasticity(model, model.line if line is None else line))
    # The force acts on both pads, and each moves by w.
    return float(1 / (2 * flexibility[1, 1] * 2))


def stroke(model: BeamModel) -> float:
    """Of the pads against each other with all three stacks over their whole voltage range [m]."""
    elongation = 3 * STACK.free_stroke
    motion = np.linalg.solve(_elasticity(model, model.line), [2 * model.line * elongation, 0.0])
    return float(2 * abs(motion[1]))


def static_gains(model: BeamModel, *, amplifier: float = 20.0) -> tuple[float, float]:
    """V_s/V_a [V/V] and d_e/V_a [m/V] at rest, sensor open: two stacks driven, the third one read by V = -d F / C."""
    elongation = 2 * STACK.stroke_per_volt * amplifier
    line = model.open_line
    motion = np.linalg.solve(_elasticity(model, line), [2 * line * elongation, 0.0])
    force = line * (2 * motion[0] - elongation)  # tension
    return float(-STACK.stroke_per_volt * force / STACK.capacitance), float(2 * motion[1])


def pole_and_zero(model: BeamModel, payload_mass: float = 5.0) -> tuple[float, float]:
    """Pole with the sensor open, and zero of V_s/V_a [Hz]: where no force passes the line, the shell carries alone."""
    mass = payload_mass + MOVING_MASS
    pole = axial_stiffness(model, line=model.open_line)
    zero = axial_stiffness(model, line=0.0)
    return math.sqrt(pole / mass) / (2 * math.pi), math.sqrt(zero / mass) / (2 * math.pi)
