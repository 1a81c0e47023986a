"""Ties of a scene: the joints and springs that connect its bodies, and the bodies that they connect."""

from collections.abc import Collection, Iterable, Mapping, Sequence
from itertools import combinations

import numpy as np
import scipy

from nassim.scene.scene import Scene
from nassim.scene.terms import Constraint, ForceLaw

Tie = Constraint | ForceLaw
"""Terms that connect bodies: constraints and force laws."""


def find_ties(scene: Scene, without: Collection[str] = ()) -> list[Tie]:
    """Return the joints, without those of given names, and the springs that connect bodies."""
    joints = [joint for joint in scene.terms_of(Constraint) if joint.name not in without]
    return [*joints, *(law for law in scene.terms_of(ForceLaw) if not law.measure.within)]


def tied_groups(scene: Scene, ties: Iterable[Tie]) -> dict[str, int]:
    """Return the number of the group of bodies that ties connect, by name of each body that moves."""
    names = [body.name for body in scene.bodies if body.moves]
    matrix = np.eye(len(names))
    for tie in ties:
        among = [names.index(name) for name in tie.measure.bodies if name in names]
        matrix[np.ix_(among, among)] = 1.0
    _, labels = scipy.sparse.csgraph.connected_components(scipy.sparse.csr_matrix(matrix), directed=False)
    return dict(zip(names, labels.tolist(), strict=True))


def is_grounded(tie: Tie, moving: Collection[str]) -> bool:
    """Whether a tie connects a fixed body; moving: names of the bodies that move."""
    return not set(tie.measure.bodies) <= set(moving)


def grounded_groups(groups: Mapping[str, int], ties: Sequence[Tie]) -> set[int]:
    """Return the groups, see `tied_groups`, that a tie connects to a fixed body."""
    return {groups[n] for tie in ties if is_grounded(tie, groups) for n in tie.measure.bodies if n in groups}


def tied_bodies(scene: Scene) -> tuple[tuple[str, str], ...]:
    """Return all pairs of moving bodies that a tie connects; their relative position shapes the modes."""
    moving = {body.name for body in scene.bodies if body.moves}
    named = [sorted(moving & set(tie.measure.bodies)) for tie in find_ties(scene)]
    return tuple(dict.fromkeys(pair for names in named for pair in combinations(names, 2)))


def loose_bodies(scene: Scene) -> tuple[str, ...]:
    """Return the bodies that no chain of ties connects to a fixed body."""
    ties = find_ties(scene)
    groups = tied_groups(scene, ties)
    grounded = grounded_groups(groups, ties)
    return tuple(name for name, group in groups.items() if group not in grounded)
