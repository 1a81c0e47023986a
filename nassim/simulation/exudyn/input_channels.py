"""Channels of inputs: the effect of an input on an Exudyn system, and the loads and objects that carry forces."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import exudyn.itemInterface as eii
import numpy as np

from nassim.base.checks import Array


@dataclass(frozen=True)
class InputChannel:
    """The effect of an input on an Exudyn system.

    Attributes:
        number: number of a load or an object, to which other inputs may add.
        input: name of the input.
        forces: forces per unit of the input.
        parameter: parameter of the load or object that holds the forces.
        rate: rate of the amplifier, a low-pass of first order [1/s].
        offset: offset of a joint whose motion the input is, which the joint reads at every iteration; None for forces.
    """

    number: int
    input: str
    forces: Array
    parameter: str = "forceVector"
    rate: float = math.inf
    offset: Array | None = None


@dataclass
class ForceCarrier:
    """A load or an object that carries the forces of inputs.

    Attributes:
        places: indices of the channels that add to it.
        forces: forces per unit of each channel, (places, m).
        constant: other, constant forces, (m,).
        setting: function that sets the forces.
        last: values of its channels at the last call.
    """

    places: Array | slice
    forces: Array
    constant: Array | None
    setting: Callable[[Array], None]
    last: bytes = b""

    def update(self, values: Array) -> None:
        """Set the forces by the values of all channels if they changed.

        A call into Exudyn takes a microsecond or more.
        """
        now = values[self.places]
        now_bytes = now.tobytes()
        if now_bytes != self.last:
            forces = now.dot(self.forces)
            self.setting(forces if self.constant is None else forces + self.constant)
            self.last = now_bytes


def add_forces(mbs: Any, nodes: Sequence[int], size: int) -> int:
    """Add an object that only carries forces: one call a step sets them, where loads would need one each."""
    nothing = np.zeros((0, 0))
    return int(
        mbs.AddObject(
            eii.ObjectGenericODE2(
                nodeNumbers=list(nodes), massMatrix=nothing, stiffnessMatrix=nothing, forceVector=np.zeros(size)
            )
        )
    )
