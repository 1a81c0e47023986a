"""Places of a solid at which a reduced body keeps its stress or strain."""

import numpy as np

from nassim.base.checks import Array, finite_array, freeze, positive, unique
from nassim.base.field_types import ArrayField, Names, data_class, held
from nassim.base.short_repr import short_repr


@data_class
class StressPoint:
    """A point inside or on a solid at which a reduced body keeps its stress.

    Attributes:
        name: name of the read-out
        position: the point in the frame of the CAD, shape (3,) [m]
        cad_body: name of the CAD body, for a point where several meet; "" where there is only one
    """

    name: str
    position: ArrayField
    cad_body: str = ""

    __repr__ = short_repr

    def __post_init__(self) -> None:
        freeze(self, position=finite_array(f"stress point {self.name!r}: position", self.position, (3,)))


@data_class
class StressSurface:
    """The outer surface of a solid, or some of its faces, on which a reduced body keeps its stress.

    Attributes:
        name: name of the read-out
        faces: names of outer faces; empty for all
    """

    name: str = "stress"
    faces: Names = held(())

    __repr__ = short_repr

    def __post_init__(self) -> None:
        faces = (self.faces,) if isinstance(self.faces, str) else self.faces
        freeze(self, faces=unique(f"stress surface {self.name!r}: face", faces))


@data_class
class GaugeLine:
    """A strain gauge on a face of a solid: a straight line over which the strain along it is averaged.

    Attributes:
        name: name of the read-out
        position: middle of the line on the face, in the frame of the CAD, shape (3,) [m]
        direction: direction of the line, of any length, shape (3,)
        length: length of the line [m]
    """

    name: str
    position: ArrayField
    direction: ArrayField
    length: float

    __repr__ = short_repr

    def __post_init__(self) -> None:
        label = f"gauge {self.name!r}"
        direction = finite_array(f"{label}: direction", self.direction, (3,))
        if not np.any(direction):
            raise ValueError(f"{label}: direction must not be zero")
        freeze(
            self,
            position=finite_array(f"{label}: position", self.position, (3,)),
            direction=direction / np.linalg.norm(direction),
            length=positive(f"{label}: length", self.length, "m"),
        )

    @property
    def ends(self) -> Array:
        """Positions of the two ends of the line, shape (2, 3) [m]."""
        half = 0.5 * self.length * np.asarray(self.direction)
        return np.asarray(self.position) + np.array([-half, half])


Place = StressPoint | StressSurface | GaugeLine
"""Kinds of places that `craig_bampton` accepts as `stress`."""
