"""Analytical model of the APA300ML and its bench: four arms, a stack line, two levers; see docs/actuator.md.

By symmetry a quarter is sufficient. Its arm is a beam whose ends do not rotate. The end at the pad can only rise (w),
the end at the end block only move outwards (u). Along its axis the arm is as stiff as a bar, across it as a beam guided
at both ends:

    stretch a = u cos t + w sin t,   deflection p = u sin t - w cos t,   t: slope of the arm

    energy of the whole actuator = 2 k_a a^2 + 2 k_b p^2 + 1/2 k_l (2 u - e)^2

Here e is the free elongation of the stack line and k_l its stiffness, in series with the bending of the end blocks
between stack and arms (the levers). No value is fitted or taken from finite elements.
"""

import math
from dataclasses import dataclass

import numpy as np

from . import PZT, STACK, STEEL, APAGeometry

SECTION = 10e-3
"""Side of the stacks' square cross-section [m]."""
SPACER = 5e-3
ARM_START = (4.5e-3, 12.06e-3)
"""Centre line of the arm where it leaves the pad: x, z [m]."""
SLOPE = math.radians(9.98)
BLOCK_START, BLOCK_END = 32.5e-3, 39.397e-3
"""Positions of the stack's end and of the outside of the end block [m]."""
MOVING_MASS = 0.035
"""Part of the actuator's mass that moves with the payload [kg].

It consists of the upper pad, most of its arms, and a quarter of stack line and end blocks, which rise half as far.
"""
ROOT = 0.4
"""Extra length of a beam per built-in end that rotates a little [beam thicknesses].

Source: W. J. O'Donnell, J. Appl. Mech. 27 (1960) 461-464: the root in a half plane rotates by
5.3 (1 - nu^2) M / (E b t^2).
"""


@dataclass(frozen=True)
class BeamModel:
    """Stiffnesses of the analytical model [N/m].

    Attributes:
        arm_length: length of the arm between the roots, including their rotation [m]
        stretching: stiffness of one arm along its axis
        bending: stiffness of one arm across its axis
        line: stiffness of the stack line with the bending of the end blocks
        open_line: the same with the charge of the sensor stack held
        span: stiffness of one stack at constant voltage
    """

    arm_length: float
    stretching: float
    bending: float
    line: float
    open_line: float
    span: float


def beam_model(geometry: APAGeometry | None = None, *, pzt_modulus: float = PZT.young_modulus) -> BeamModel:
    """Compute the stiffnesses from dimensions and moduli."""
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
    """Return the stiffness of an end block: a short beam between two arms, loaded by the stack at its centre [N/m]."""
    height = BLOCK_END - BLOCK_START
    # Between the slots the block is as high as the stack with its margins, 11 mm. The arms pull at its outer corners.
    arm_end = ARM_START[1] - (BLOCK_START + g.relief - ARM_START[0]) * math.tan(SLOPE)
    reach, half = arm_end, SECTION / 2
    shear = STEEL.young_modulus / (2 * (1 + STEEL.poisson_ratio))
    inertia, area = g.depth * height**3 / 12, g.depth * height
    # Deflection of the centre relative to the ends of a beam of length 2 reach, with a uniform load over 2 half and
    # Timoshenko's shear factor 6/5.
    bend = (8 * reach**3 - 4 * reach * half**2 + half**3) / (48 * STEEL.young_modulus * inertia)
    slide = 1.2 * (2 * reach - half) / (4 * shear * area)
    return 1 / (bend + slide)


def _elasticity(model: BeamModel, line: float) -> np.ndarray:
    """Return the matrix of the energy in (u, w) with a stack line of the given stiffness, shape (2, 2)."""
    c, s = math.cos(SLOPE), math.sin(SLOPE)
    stretch, across, out = np.array([c, s]), np.array([s, -c]), np.array([2.0, 0.0])
    shell = 4 * (model.stretching * np.outer(stretch, stretch) + model.bending * np.outer(across, across))
    result: np.ndarray = shell + line * np.outer(out, out)
    return result


def axial_stiffness(model: BeamModel, *, line: float | None = None) -> float:
    """Compute force over elongation between the pads [N/m].

    Args:
        model: stiffnesses
        line: stiffness of the stack line [N/m] (default: all stacks shorted)
    """
    flexibility = np.linalg.inv(_elasticity(model, model.line if line is None else line))
    # The force acts on both pads, and each pad moves by w.
    return float(1 / (2 * flexibility[1, 1] * 2))


def stroke(model: BeamModel) -> float:
    """Compute the elongation between the pads with all three stacks over their whole voltage range [m]."""
    elongation = 3 * STACK.free_stroke
    motion = np.linalg.solve(_elasticity(model, model.line), [2 * model.line * elongation, 0.0])
    return float(2 * abs(motion[1]))


def static_gains(model: BeamModel, *, amplifier: float = 20.0) -> tuple[float, float]:
    """Compute the static V_s/V_a [V/V] and d_e/V_a [m/V] with two stacks driven and the third one open, V = -d F / C.

    Args:
        model: stiffnesses
        amplifier: stack voltage per drive voltage [V/V]
    """
    elongation = 2 * STACK.stroke_per_volt * amplifier
    line = model.open_line
    motion = np.linalg.solve(_elasticity(model, line), [2 * line * elongation, 0.0])
    force = line * (2 * motion[0] - elongation)  # tension
    return float(-STACK.stroke_per_volt * force / STACK.capacitance), float(2 * motion[1])


def pole_and_zero(model: BeamModel, payload_mass: float = 5.0) -> tuple[float, float]:
    """Compute the pole with the sensor open and the zero of V_s/V_a [Hz], at which the shell alone carries the load."""
    mass = payload_mass + MOVING_MASS
    pole = axial_stiffness(model, line=model.open_line)
    zero = axial_stiffness(model, line=0.0)
    return math.sqrt(pole / mass) / (2 * math.pi), math.sqrt(zero / mass) / (2 * math.pi)
