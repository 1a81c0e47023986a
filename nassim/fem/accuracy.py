"""FE models of a wanted accuracy: rounds of mesh, static condensation, error estimate and refinement.

The first mesh takes its element sizes from the CAD. After each round, the released energy (`mesh_error`) gives the
error of every target, element by element. If the error is spread over many elements, the order rises on the same mesh;
if a few elements hold it, a new mesh has other sizes.
"""

import time
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import ngsolve as ng
import numpy as np

from nassim.base.checks import Array, known, of_kind, positive, whole_number
from nassim.base.library_lock import hold_library_lock
from nassim.base.progress import stage, tell
from nassim.base.warning_log import collect_messages, note, warn
from nassim.bodies.reduced_body import LARGEST_KNOWN_ERROR, SATURATION, error_text
from nassim.fem.assembly import assemble_mesh, build_by_size, check_order, curved_mesh
from nassim.fem.condensation import Condensation, condense
from nassim.fem.curving import Curving, reduce_curvature
from nassim.fem.fe_model import FEModel, MeshRound
from nassim.fem.mesh_checks import check_volume, factorization_memory, free_memory
from nassim.fem.mesh_sizes import MeshSizing
from nassim.fem.mesh_targets import EXTRA_MODES, MeshTargets, find_targets
from nassim.fem.meshing import PrismsFailedError
from nassim.fem.modes import with_interface_modes
from nassim.fem.solid import Solid

LOWEST_ORDER, FIRST_ORDER, HIGHEST_ORDER = 2, 3, 4
"""Orders between which rounds change that of the elements, and that of the first round.

Order 1 locks, and beyond order 4 the matrices cost more than the number of unknowns shows.
"""
HIGHEST_CURVE_ORDER = 3
"""Highest order of curved edges; unfolded elements of higher orders are more distorted, which increases the error."""
SMALL_TOLERANCE = 0.004
"""Tolerance that elements of order 3 hardly ever meet with sizes from CAD, so that the first round has order 4."""
MOST_ROUNDS = 6
SPREAD = 0.08
"""Share of the elements that hold 80 % of the error above which a higher order pays more than smaller elements."""
SLIGHTLY_ABOVE = 1.3
"""Error relative to the tolerance up to which smaller elements cost less than a higher order."""
AIM, LARGEST_AIM_CHANGE, SMALLEST_AIM_CHANGE = 0.8, 0.4, 0.8
"""Share of the tolerance at which new sizes aim, and the factors by which each round lowers it."""
COARSENING = 1.3
"""Smallest factor on all sizes if a mesh is beyond the limits."""
MOST_REFUSED = 4
"""Largest number of meshes that are made in vain, beyond the limits, once there is a model."""
SMALLEST_GROWTH = 1.1
"""Smallest useful ratio of the unknowns of two meshes, if a larger one is beyond the limits."""


def build_fe_model(
    solid: Solid,
    *,
    element_size: float | None = None,
    tolerance: float | None = None,
    n: int = 5,
    fixed: Sequence[Collection[str]] | None = None,
    max_unknowns: int = 300_000,
    max_time: float = np.inf,
    order: int | None = None,
    curvature: float = 0.5,
    local_sizes: Mapping[str, float] | None = None,
    extrude: str | None = None,
    layer_thickness: float | None = None,
    progress: bool = True,
) -> FEModel:
    """Mesh a solid and assemble its stiffness and mass, for a wanted accuracy or with elements of a given size.

    With a tolerance, the mesh is refined until the estimated relative discretisation errors are below it: those of the
    first n elastic eigenfrequencies, of the static stiffnesses at each remote point with the first one fixed, and of
    the responses to the electrical ports. The error includes the effect of mesh faces that differ from the CAD. If a
    limit ends this first, the result is the model of the smallest error.

    Args:
        solid: the solid; a tolerance needs remote points
        element_size: largest edge length of the elements [m]; see `meshing.generate_mesh` for this and the other
            arguments of the mesh. Give either this or tolerance
        tolerance: largest allowed estimate of the relative errors, at most 0.5 [-]
        n: number of eigenfrequencies to which the tolerance applies
        fixed: sets of remote points that cannot move, for which the frequencies count, such as [(), ("bottom",)]
            (default: none, each one alone, and all)
        max_unknowns: largest number of unknowns of a mesh for a tolerance
        max_time: time after which no further mesh for a tolerance begins, and within which it must be expected to end
            [s]
        order: polynomial order of the displacements, 1 to 6, or that of the first mesh for a tolerance (default: 3, or
            4 for a tolerance below 0.4 %); order 1 is far too stiff in thin walls
        curvature: elements per radius of curvature of curved edges and faces
        local_sizes: largest edge length on faces, by the names of the faces [m]
        extrude: axis "x", "y" or "z" along which CAD bodies are extruded and meshed with prisms; None for tetrahedra,
            or, for a tolerance, for prisms if most of the solid is extruded along one axis
        layer_thickness: largest height of the prisms [m] (default: element_size; for a tolerance from the CAD)
        progress: show the stages and their times, and for a tolerance the unknowns and the error of every round

    Raises:
        ValueError: for invalid arguments, for a solid whose CAD bodies are not connected, and for a mesh that does not
            fit in memory

    Warns:
        UserWarning: for thin walls in elements of order 1, and for a tolerance that the limits do not let it reach
    """
    of_kind("solid", solid, Solid, "Solid(name, shape, materials) makes one of a shape")
    mesh_options: dict[str, Any] = {
        "curvature": curvature,
        "local_sizes": local_sizes,
        "extrude": extrude,
        "layer_thickness": layer_thickness,
    }
    if element_size is not None and tolerance is None:
        order = FIRST_ORDER if order is None else order
        model = build_by_size(solid, element_size=element_size, order=order, progress=progress, **mesh_options)
    elif tolerance is not None and element_size is None:
        tolerance = _check_tolerance(tolerance)
        seconds = np.inf if max_time == np.inf else positive("max_time", max_time, "s")
        limits = MeshLimits(positive("max_unknowns", max_unknowns), time.perf_counter(), seconds)
        if order is None:
            order = FIRST_ORDER if tolerance > SMALL_TOLERANCE else HIGHEST_ORDER
        order, n = check_order(order), whole_number("n", n, 1)
        task = MeshTask(solid, tolerance, n, _conditions(solid, fixed), limits, mesh_options, progress)
        model = _build_within(task, order)
    else:
        raise ValueError(
            f"give either element_size [m] or tolerance [-], got element_size={element_size!r} and "
            f"tolerance={tolerance!r}; tolerance=0.01 asks for errors below 1 %"
        )
    if progress:
        tell(model.description)
    return model


def _check_tolerance(tolerance: float) -> float:
    """Return a tolerance, checked to be one that an estimate can show to be met."""
    tolerance = positive("tolerance", tolerance)
    if tolerance > LARGEST_KNOWN_ERROR:
        raise ValueError(
            f"tolerance must be at most {LARGEST_KNOWN_ERROR:g}, above which no error can be estimated, got "
            f"{tolerance:g}; it is relative: 0.01 for 1 %"
        )
    return tolerance


@dataclass(frozen=True)
class MeshLimits:
    """Limits of the rounds.

    Attributes:
        unknowns: largest number of unknowns
        start: time at which the work began, of `time.perf_counter` [s]
        seconds: largest time [s]
    """

    unknowns: float
    start: float
    seconds: float

    def refusal(self, mesh: Any, order: int, rounds: Sequence[MeshRound]) -> str:
        """Return why a mesh must not be factorised, '' if it may."""
        unknowns = _n_unknowns(mesh, order)
        if unknowns > self.unknowns:
            return f"{unknowns} unknowns, max_unknowns is {self.unknowns:.0f}"
        need, free = factorization_memory(mesh, order), free_memory()
        if need > free:
            return f"{unknowns} unknowns and {need / 1e9:.1f} GB to factorise, {free / 1e9:.1f} GB are free"
        if not rounds:
            return ""
        last = rounds[-1].seconds - (rounds[-2].seconds if len(rounds) > 1 else 0.0)
        expected = time.perf_counter() - self.start + last * (unknowns / rounds[-1].n_dofs) ** 1.5
        return f"about {expected:.0f} s, max_time is {self.seconds:g} s" if expected > self.seconds else ""


def _conditions(solid: Solid, fixed: Sequence[Collection[str]] | None) -> list[tuple[str, ...]]:
    """Return the sets of fixed remote points, each once."""
    names = [point.name for point in solid.remote_points]
    if not names:
        raise ValueError(
            f"solid {solid.name!r} has no remote points, at which a tolerance is defined: give it at least one, or "
            "give element_size instead"
        )
    if fixed is None:
        return list(dict.fromkeys([(), *((name,) for name in names), tuple(names)]))
    if isinstance(fixed, str) or any(isinstance(choice, str) for choice in fixed) or not len(fixed):
        raise ValueError(f"fixed must be sets of remote points, such as [(), ({names[0]!r},)], got {fixed!r}")
    for name in (name for choice in fixed for name in choice):
        known("remote point", name, names)
    return [tuple(choice) for choice in fixed]


@dataclass(frozen=True)
class MeshTask:
    """Request of a user, which is the same in all rounds of refinement.

    Attributes:
        solid: the solid
        tolerance: largest allowed estimate of the relative errors [-]
        n: number of elastic eigenfrequencies under each condition
        conditions: sets of fixed remote points
        limits: limits of the rounds
        mesh_options: arguments of `generate_mesh` that the user gave
        progress: whether stages are shown
    """

    solid: Solid
    tolerance: float
    n: int
    conditions: Sequence[tuple[str, ...]]
    limits: MeshLimits
    mesh_options: Mapping[str, Any]
    progress: bool


@dataclass(frozen=True)
class MeshPlan:
    """The mesh of the next round.

    Attributes:
        sizing: element sizes
        order: order of the elements
        aim: share of the tolerance at which the next new sizes aim
        netgen_mesh: the Netgen mesh, None if it is not made yet or if Netgen failed
        unknowns: its number of unknowns
        refusal: why it must not be solved, '' if it may
    """

    sizing: MeshSizing
    order: int
    aim: float = AIM
    netgen_mesh: Any = None
    unknowns: int = 0
    refusal: str = ""

    def made(self, task: MeshTask, rounds: Sequence[MeshRound]) -> "MeshPlan":
        """Return the plan with its mesh, and the reason if that must not be solved."""
        netgen_mesh = self.netgen_mesh
        with stage(f"round {len(rounds) + 1}: mesh", enabled=task.progress):
            try:
                netgen_mesh = netgen_mesh or self.sizing.mesh(
                    task.solid, task.mesh_options, tetrahedra_instead=not rounds
                )
            except PrismsFailedError:
                return replace(self, refusal="prisms of sizes for which Netgen fails")
        mesh = ng.Mesh(netgen_mesh)
        refusal = task.limits.refusal(mesh, self.order, rounds)
        return replace(self, netgen_mesh=netgen_mesh, unknowns=_n_unknowns(mesh, self.order), refusal=refusal)

    def cheaper(self, limits: MeshLimits) -> "MeshPlan":
        """Return a plan with larger sizes, or a lower order where these are the largest already.

        Raises:
            ValueError: where the order is the lowest already
        """
        if self.sizing.can_be_coarser:
            factor = max(COARSENING, (self.unknowns / limits.unknowns) ** (1 / 3))
            return MeshPlan(self.sizing.coarsened(factor), self.order, self.aim)
        if self.order <= LOWEST_ORDER:
            raise ValueError(f"the coarsest mesh would need {self.refusal}; allow more, or simplify the CAD")
        return MeshPlan(self.sizing, self.order - 1, self.aim)

    def of_higher_order(self, task: MeshTask, rounds: Sequence[MeshRound]) -> "MeshPlan":
        """Return the plan for the same mesh with elements one order higher, and the reason if it must not be solved."""
        mesh, order = ng.Mesh(self.netgen_mesh), self.order + 1
        refusal = task.limits.refusal(mesh, order, rounds)
        return replace(self, order=order, unknowns=_n_unknowns(mesh, order), refusal=refusal)

    def with_new_sizes(self, task: MeshTask, trial: "Trial") -> "MeshPlan":
        """Return the plan for a new mesh, whose sizes follow from the errors by element.

        Netgen's meshes jump: slightly smaller sizes may give as many elements as before, so the aim falls every time.
        """
        sizing = self.sizing.refined(trial.mesh, trial.targets, trial.curving, self.aim * task.tolerance)
        change = float(np.clip(task.tolerance / trial.error, LARGEST_AIM_CHANGE, SMALLEST_AIM_CHANGE))
        return MeshPlan(sizing, self.order, change * self.aim)


def _n_unknowns(mesh: Any, order: int) -> int:
    """Return the number of unknowns of elements of an order."""
    return int(3 * ng.H1(mesh, order=order).ndof)


def _build_within(task: MeshTask, order: int) -> FEModel:
    """Return the model of `_refine` with the notes and warnings of all rounds, each once."""
    with hold_library_lock(), collect_messages() as log:
        model = _refine(task, order)
    description = "; ".join([model.description, *dict.fromkeys(log.notes)])
    return replace(model, description=description, warnings=tuple(dict.fromkeys(log.warnings)))


def _refine(task: MeshTask, order: int) -> FEModel:
    """Return the model of the smallest error, with all rounds."""
    plan = MeshPlan(MeshSizing.from_cad(task.solid, task.mesh_options), order)
    best: Trial | None = None
    best_plan = plan
    softest: Array | float = np.inf
    rounds: list[MeshRound] = []
    refusals: list[str] = []
    while len(rounds) < MOST_ROUNDS:
        plan = plan.made(task, rounds)
        if _gains_nothing(plan, rounds, refusals):
            break
        if plan.refusal:
            refusals.append(plan.refusal)
            if rounds and not plan.netgen_mesh and (higher := _raise_order(best_plan, task, rounds)):
                plan = higher
                continue
            if rounds and (len(refusals) > MOST_REFUSED or not plan.sizing.can_be_coarser):
                break
            plan = plan.cheaper(task.limits)
            continue
        trial = _solve(plan, task, softest, rounds)
        # Values of faces that are far from the CAD are right to first order only.
        right = np.abs(trial.targets.geometry) <= task.tolerance
        softest = np.minimum(softest, np.where(right, trial.targets.values, np.inf))
        worse = best is not None and trial.error > best.error
        if best is None or trial.error < best.error:
            best, best_plan = trial, plan
        if trial.error <= task.tolerance:
            break
        if worse and (higher := _raise_order(best_plan, task, rounds)):
            plan = higher
            continue
        plan, refusal = _improve(plan, task, trial, rounds)
        refusals += [refusal] if refusal else []
    assert best is not None
    if best.error > task.tolerance:
        _warn_of_missed_tolerance(task, best, refusals)
    if best.curving.n_folded:
        note(str(best.curving))
    check_volume(best.mesh, task.solid)
    return best.model(rounds)


def _gains_nothing(plan: MeshPlan, rounds: Sequence[MeshRound], refusals: Sequence[str]) -> bool:
    """Return whether a mesh is hardly larger than the one before although a larger one is beyond the limits."""
    if not refusals or not rounds or not plan.netgen_mesh or plan.order > rounds[-1].order:
        return False
    return plan.unknowns < SMALLEST_GROWTH * rounds[-1].n_dofs


def _raise_order(best: MeshPlan, task: MeshTask, rounds: Sequence[MeshRound]) -> MeshPlan | None:
    """Return the plan of a higher order on the best mesh, for where other sizes failed or made the error larger.

    None if this is beyond the limits, or one of the rounds.
    """
    if best.order >= HIGHEST_ORDER:
        return None
    higher = best.of_higher_order(task, rounds)
    tried = (higher.order, higher.unknowns) in [(made.order, made.n_dofs) for made in rounds]
    return None if higher.refusal or tried else higher


def _solve(plan: MeshPlan, task: MeshTask, softest: Array | float, rounds: list[MeshRound]) -> "Trial":
    """Condense the model of a mesh, estimate its errors and append the round to the others."""
    with stage(f"round {len(rounds) + 1}: solve, estimate", enabled=task.progress):
        trial = Trial.of(plan.netgen_mesh, task.solid, plan.order, task.n, task.conditions, softest)
    seconds = time.perf_counter() - task.limits.start
    rounds.append(MeshRound(plan.order, trial.mesh.ne, plan.unknowns, seconds=seconds, error=trial.error))
    if task.progress:
        tell(f"round {len(rounds)}: {rounds[-1]}")
    return trial


def _improve(plan: MeshPlan, task: MeshTask, trial: "Trial", rounds: Sequence[MeshRound]) -> tuple[MeshPlan, str]:
    """Return the next plan, and why a higher order was refused, '' if it was not.

    A higher order pays where the error is spread over many elements and more than slightly above the tolerance. It does
    not mend mesh faces that differ from the CAD.
    """
    smaller, reason = plan.with_new_sizes(task, trial), ""
    of_elements = float((trial.errors - np.abs(trial.targets.geometry)).max())
    far = of_elements > SLIGHTLY_ABOVE * task.tolerance
    if far and plan.order < HIGHEST_ORDER and _spread(trial.targets, task.tolerance) > SPREAD:
        higher = plan.of_higher_order(task, rounds)
        if not higher.refusal:
            return higher, ""
        reason = higher.refusal
    return smaller, reason


def _warn_of_missed_tolerance(task: MeshTask, best: "Trial", refusals: Sequence[str]) -> None:
    """Warn how far off the best model is, and of what ended the rounds."""
    reason = f"the next mesh would need {refusals[0]}" if refusals else f"{MOST_ROUNDS} meshes were tried"
    warn(
        f"solid {task.solid.name!r}: the tolerance {task.tolerance:g} was not reached, the estimated error is "
        f"{best.error_text}: {reason}; allow more, or simplify or fillet the CAD there",
    )


@dataclass(frozen=True)
class Trial:
    """Result of one round.

    Attributes:
        condensed: static condensation of the model
        mesh: its NGSolve mesh
        curving: record of how the mesh was curved
        targets: what a tolerance applies to
        errors: estimated relative errors of the targets, shape (t,)
    """

    condensed: Condensation
    mesh: Any
    curving: Curving
    targets: MeshTargets
    errors: Array

    @staticmethod
    def of(
        netgen_mesh: Any,
        solid: Solid,
        order: int,
        n: int,
        conditions: Sequence[tuple[str, ...]],
        softest: Array | float,
    ) -> "Trial":
        """Condense the model of a mesh and estimate its errors; softest: smallest values of the targets on others."""
        curve_order = min(order, HIGHEST_CURVE_ORDER)
        mesh, curving = curved_mesh(netgen_mesh, curve_order)
        curving = reduce_curvature(mesh, curve_order, curving)
        condensed = condense(assemble_mesh(mesh, solid, order), progress=False)
        condensed = with_interface_modes(condensed, n_modes=n + EXTRA_MODES)
        targets = find_targets(condensed, n, conditions, curving.restoring)
        # Finite elements only stiffen, so what another mesh found softer is at least this one's error.
        errors = np.maximum(targets.errors(), targets.values / softest - 1) + np.abs(targets.geometry)
        return Trial(condensed, mesh, curving, targets, errors)

    @property
    def error(self) -> float:
        """Largest error of all targets."""
        return float(self.errors.max())

    @property
    def error_text(self) -> str:
        """Largest error and its target, as text."""
        return f"{error_text(self.error)} ({self.targets.labels[int(np.argmax(self.errors))]})"

    def model(self, rounds: Sequence[MeshRound]) -> FEModel:
        """Return the FE model with the record of all rounds."""
        model = self.condensed.fe_model
        description = f"{model.description}; estimated error {self.error_text}"
        return replace(model, description=description, rounds=tuple(rounds), _condensation=self.condensed)


def _spread(targets: MeshTargets, goal: float) -> float:
    """Return the share of the elements that hold 80 % of the error."""
    load = np.sort(np.max(targets.shares * (SATURATION * targets.powers / goal), axis=1))[::-1]
    return float((1 + np.searchsorted(np.cumsum(load), 0.8 * load.sum())) / len(load))
