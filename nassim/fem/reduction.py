"""Craig-Bampton reduction of an FE model to remote points and fixed-interface modes."""

import math
import time
from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np

from nassim.base.checks import Array, of_kind, positive, unique
from nassim.base.memory import peak_memory
from nassim.base.progress import stage, tell
from nassim.base.warning_log import collect_messages, warn
from nassim.bodies.piezo import PortCoupling
from nassim.bodies.projection import keep_modes, keeps_stress
from nassim.bodies.readouts import Picture, Readout, by_name, readouts_of
from nassim.bodies.reduced_body import ReducedBody, error_text, truncation_errors
from nassim.bodies.stress import StressField, von_mises
from nassim.bodies.stress_stiffness import BODY_FORCES
from nassim.fem.assembly import mesh_and_solid
from nassim.fem.condensation import Condensation, condense, deformation_projector
from nassim.fem.fe_model import FEModel
from nassim.fem.mesh_error import released_stiffness
from nassim.fem.modes import InterfaceModes, check_n_modes, largest_n_modes, modes_below, residual_vectors
from nassim.fem.native_threads import blas_threads
from nassim.fem.sparse import symmetric_from_upper, symmetric_product
from nassim.fem.stress import StressPlan, plan_stress, stress_readouts
from nassim.fem.stress_places import Place
from nassim.fem.stress_stiffness import body_forces, stress_stiffness

DEFAULT_MODES = 6
LARGEST_N_MODES = 400
"""Largest number of modes for a tolerance; the number is doubled until the tolerance is met."""
LARGE_MESH_ERROR = 0.02
"""Estimated discretisation error above which there is a warning."""
STRESSED_MODES = 6
"""Number of clamped modes in which the error of the stress at points is told."""


def craig_bampton(
    fe_model: FEModel | Condensation,
    *,
    n_modes: int | None = None,
    cutoff_frequency: float | None = None,
    tolerance: float | None = None,
    remote_points: Sequence[str] | None = None,
    ports: Sequence[str] | None = None,
    discretization: bool | None = None,
    geometric_stiffness: bool = False,
    stress: Sequence[Place] = (),
    progress: bool = True,
) -> ReducedBody:
    """Reduce an FE model to the motions of its remote points and fixed-interface modes, and estimate the error.

    Args:
        fe_model: the model, or its condensation from `condense`
        n_modes: number p of fixed-interface modes (default: 6, or all of a smaller model, if neither of the next two
            arguments is given)
        cutoff_frequency: keep the modes below this frequency [Hz]; a usual value is twice the highest frequency of
            interest
        tolerance: largest allowed estimate of the relative error of eigenfrequencies [-]; the smallest sufficient
            number of modes is kept. It applies to the first five elastic eigenfrequencies, or to those below
            cutoff_frequency if that is given, of the free body and of the body clamped at any one of its remote points
        remote_points: names (default: all)
        ports: names of the electrical ports to keep (default: all); each adds one modal coordinate, which makes the
            static response to its voltage exact
        discretization: also estimate the error of the finite elements, for `ReducedBody.discretization_errors`, and
            warn where it is large; doubles the time (default: only for a model of `build_fe_model` with an
            element_size; with a tolerance its error is known)
        geometric_stiffness: also compute the body's geometric stiffness under loads, `ReducedBody.stress_stiffness`,
            for 12 more solves and one scalar matrix per coordinate, omitted modes included; condensation and reduction
            then take two to four times as long
        stress: points, gauges and surfaces at which the body keeps its stress or strain, as read-outs of their names:
            `StressPoint`, `GaugeLine`, `StressSurface`. Up to 12 further modal coordinates then make the static
            responses to body forces (gravity, accelerations, spin) exact
        progress: show the stages and the report

    Raises:
        ValueError: for no remote points, unknown names, more modes than unknowns, n_modes together with
            cutoff_frequency or tolerance, a tolerance that cannot be met (the message gives one that can), with
            geometric_stiffness, stress or discretization for a model that was not made from a mesh, and for stress
            outside the solid or of a gauge that is not on one face

    Warns:
        UserWarning: if the estimated error of the finite elements exceeds 2 %
    """
    start = time.perf_counter()
    _check_mode_selection(n_modes, cutoff_frequency, tolerance)
    with blas_threads(0), collect_messages() as log:
        model = fe_model.fe_model if isinstance(fe_model, Condensation) else fe_model
        of_kind("fe_model", model, FEModel, "build_fe_model makes one of a solid")
        count = None if n_modes is None else check_n_modes(n_modes, model.n_dofs)
        kept = model.ports if ports is None else [model.port(name) for name in unique("electrical port", ports)]
        if discretization is None:
            discretization = bool(model.rounds) and math.isnan(model.discretization_error)
        if discretization or geometric_stiffness:
            mesh_and_solid(model)  # refuses a model without a mesh before the long steps
        plan = plan_stress(model, stress) if stress else None
        condensed = _condensation(fe_model, remote_points, progress)
        count = min(DEFAULT_MODES, largest_n_modes(condensed)) if count is None else count
        rich, count, frequency, basis = (
            _reduce(condensed, count, cutoff_frequency, kept, progress, plan)
            if tolerance is None
            else _reduce_within(condensed, tolerance, cutoff_frequency, kept, progress, plan)
        )
        if plan is not None:
            rich = _add_stress(rich, condensed, plan, basis, progress)
        if discretization:
            rich = _with_released_stiffness(rich, condensed, frequency, basis[1], progress)
        if geometric_stiffness:
            rich = _add_stress_stiffness(rich, condensed, basis, kept, progress)
        body = keep_modes(rich, count)
        error = _mesh_error(body, model)
        if discretization:
            _warn_of_coarse_mesh(body.name, error)
    seconds = time.perf_counter() - start if fe_model is model else math.nan
    record = {**body.record, **_report(body, rich, count), **_cost(model, seconds, error)}
    if progress:
        tell("\n".join(f"{label}: {text}" for label, text in record.items() if label != "finite element model"))
    if warnings := [*model.warnings, *log.warnings]:
        record["warnings"] = "\n".join(warnings)
    return replace(body, record=record)


def _check_mode_selection(n_modes: int | None, cutoff_frequency: float | None, tolerance: float | None) -> None:
    """Check what decides how many modes are kept."""
    if n_modes is not None and not (cutoff_frequency is None and tolerance is None):
        raise ValueError("give either n_modes, or cutoff_frequency and/or tolerance, not both")
    for label, value, unit in (("cutoff_frequency", cutoff_frequency, "Hz"), ("tolerance", tolerance, "")):
        if value is not None:
            positive(label, value, unit)


def _condensation(
    fe_model: FEModel | Condensation, remote_points: Sequence[str] | None, progress: bool
) -> Condensation:
    """Return the condensation that was given, or condense the FE model that was given."""
    if not isinstance(fe_model, Condensation):
        return condense(fe_model, remote_points=remote_points, progress=progress)
    if remote_points is not None:
        raise ValueError("a Condensation has its remote points already; give them to condense instead")
    return fe_model


def _reduce(
    condensed: Condensation,
    n_modes: int,
    cutoff_frequency: float | None,
    ports: Sequence[PortCoupling],
    progress: bool,
    plan: StressPlan | None = None,
    found: InterfaceModes | None = None,
) -> tuple[ReducedBody, int, Array, list[Array]]:
    """Reduce with extra modes and with vectors for all other modes.

    Args:
        condensed: static condensation of the model
        n_modes: number of modes, if there is no cutoff_frequency
        cutoff_frequency: keep the modes below this frequency [Hz]
        ports: electrical ports to keep
        progress: show the stages
        plan: places of stress
        found: modes that are known already; they are extended (default: none)

    Returns:
        The body; the number of modes to keep; the frequencies of its modes [Hz]; its basis: constraint modes, modes and
        vectors for other modes, of n_dofs rows each.
    """
    with stage("fixed-interface modes", unit="solves", enabled=progress) as advance:
        if cutoff_frequency is None:
            # One more, if there is one, tells from which frequency on modes are left out.
            n_computed = max(n_modes, min(n_modes + 1, largest_n_modes(condensed)))
            frequency, modes = (found or InterfaceModes(condensed)).lowest(n_computed, advance=advance)
        else:
            frequency, modes = modes_below(condensed, cutoff_frequency, advance=advance)
            n_modes = int(np.count_nonzero(frequency <= cutoff_frequency))
    model, parts = condensed.fe_model, [condensed.constraint_modes, modes]
    with stage("integrals", enabled=progress):
        gram = symmetric_product(model.fields.T, model.scalar_mass_matrix @ model.fields.T)
        for i in range(len(parts)):
            gram = _extended_gram(gram, parts[: i + 1], model)
    with stage("truncation error", unit="solves", enabled=progress) as advance:
        loads = np.column_stack([np.zeros((len(modes), 0)), *(port.forces for port in ports)])
        if plan is not None:
            loads = np.hstack([loads, body_forces(model)])
        mass = _mass_matrix(gram)
        more, vectors = residual_vectors(condensed, frequency, modes, mass, loads=loads, advance=advance)
    with stage("integrals of omitted modes", enabled=progress):
        parts.append(vectors)
        gram = _extended_gram(gram, parts, model)
        rich = _project(condensed, np.concatenate([frequency, more]), parts, gram, ports)
    return rich, n_modes, frequency, parts


def _with_released_stiffness(
    rich: ReducedBody, condensed: Condensation, frequency: Array, modes: Array, progress: bool
) -> ReducedBody:
    """Return the body with the estimate of its discretisation error; the vectors for other modes have none."""
    with stage("discretisation error", unit="steps", enabled=progress) as advance:
        released = np.zeros_like(rich.stiffness_matrix)
        n = len(condensed.stiffness) + len(frequency)
        released[:n, :n] = released_stiffness(condensed, frequency, modes, advance=advance)
    return replace(rich, released_stiffness=released)


def _reduce_within(
    condensed: Condensation,
    tolerance: float,
    cutoff_frequency: float | None,
    ports: Sequence[PortCoupling],
    progress: bool,
    plan: StressPlan | None = None,
) -> tuple[ReducedBody, int, Array, list[Array]]:
    """Return the same as `_reduce`, with the smallest number of modes whose estimated errors meet a tolerance."""
    most = min(LARGEST_N_MODES, largest_n_modes(condensed))
    available, found = min(2 * DEFAULT_MODES, most), InterfaceModes(condensed)
    while True:
        rich, _, frequency, basis = _reduce(condensed, available, None, ports, progress, plan, found)
        better = {fixed: rich.eigenfrequencies(fixed=fixed) for fixed in [(), *((name,) for name in rich.point_names)]}
        conditions = list(better)
        for count in range(available + 1):
            body = keep_modes(rich, count)
            errors = (_truncation(body, fixed, better[fixed], cutoff_frequency) for fixed in conditions)
            failed = next((place for place, error in enumerate(errors) if error > tolerance), None)
            if failed is None:
                return rich, count, frequency, basis
            conditions.insert(0, conditions.pop(failed))  # which is the most likely to fail again
        if available == most:
            left = max(_truncation(body, fixed, better[fixed], cutoff_frequency) for fixed in conditions)
            raise ValueError(
                f"tolerance {tolerance:g} is out of reach: {most} modes, more of which are not computed, leave an "
                f"estimated error of {left:.2g}; ask for that or more, or give cutoff_frequency or n_modes"
            )
        available = min(2 * available, most)


def _add_stress_stiffness(
    body: ReducedBody, condensed: Condensation, basis: Sequence[Array], ports: Sequence[PortCoupling], progress: bool
) -> ReducedBody:
    """Return the body with its geometric stiffness among the read-outs."""
    n_fields = len(body.mass_matrix) - 6 + BODY_FORCES + len(ports)
    with stage("geometric stiffness", total=n_fields, unit="fields", enabled=progress) as advance:
        stress = stress_stiffness(condensed, np.hstack(basis), ports, advance=advance)
    return replace(body, readouts=by_name([*body.readouts.values(), stress]))


def _add_stress(
    body: ReducedBody, condensed: Condensation, plan: StressPlan, basis: Sequence[Array], progress: bool
) -> ReducedBody:
    """Return the body with stress and strain among its read-outs."""
    n, r, fields = len(body.mass_matrix), len(condensed.stiffness), np.hstack(basis)
    # A rigid motion has no stress, not even that of its rounding.
    fields[:, :r] = fields[:, :r] @ deformation_projector([c.point.position for c in condensed.couplings])
    stiffness = np.diag(body.stiffness_matrix)  # zero for the point of a body that has one alone
    with stage("stress", total=n, unit="fields", enabled=progress) as advance:
        found = stress_readouts(plan, fields, np.where(stiffness > 0, stiffness, np.inf) ** -0.5, advance=advance)
    return replace(body, readouts=by_name([*body.readouts.values(), *found]))


def _truncation(body: ReducedBody, fixed: Collection[str], better: Array, cutoff_frequency: float | None) -> float:
    """Return the largest estimated truncation error to which a tolerance applies.

    Args:
        body: the body with the modes that are kept
        fixed: remote points that cannot move
        better: eigenfrequencies with all modes [Hz]
        cutoff_frequency: highest frequency to which the tolerance applies [Hz] (None: the first five)
    """
    frequency = body.eigenfrequencies(fixed=fixed)
    errors = truncation_errors(frequency, better)[frequency > 0]
    n_counted = 5 if cutoff_frequency is None else np.count_nonzero(frequency[frequency > 0] <= cutoff_frequency)
    return float(np.max(errors[:n_counted], initial=0.0))


def _report(body: ReducedBody, rich: ReducedBody, p: int) -> dict[str, str]:
    """Describe as text which modes were kept, which were omitted and the error; p is the number of kept modes."""
    r, n = len(body.remote_points), len(body.mass_matrix)
    causes = [*(["electrical ports"] if body.ports else []), *(["body forces"] if keeps_stress(body) else [])]
    more = f" + {body.n_modes - p} for {' and '.join(causes)}" if causes else ""
    frequency = np.sqrt(np.diag(rich.stiffness_matrix)[6 * r :]) / (2 * np.pi)
    first = body.point_names[0]
    record = {
        "coordinates": f"{r} remote points x 6 + {p} fixed-interface modes{more} = {n}; in a floating frame on one "
        f"remote point ({first!r} unless the scene says otherwise): {n - 6} flexible + 6 rigid",
        "fixed-interface frequencies [Hz]": " ".join(f"{f:.1f}" for f in frequency[:p]) or "none",
    }
    if len(frequency) > p:
        record["modes left out"] = f"all from {frequency[p]:.1f} Hz"
    for label, fixed in (("free", ()), (f"{first!r} clamped", (first,))):
        found = body.eigenfrequencies(fixed=fixed)
        elastic = found > 0
        errors = truncation_errors(found, rich.eigenfrequencies(fixed=fixed))[elastic][:5]
        record[f"truncation error of the first eigenfrequencies, {label} (estimate)"] = _percent(errors)
        if body.released_stiffness is not None:
            errors = body.discretization_errors(fixed=fixed)[elastic][:5]
            record[f"discretisation error of the first eigenfrequencies, {label} (estimate)"] = _percent(errors)
    if told := _stress_errors(body):
        record[f"error of the stress by the mesh, in the first modes with {first!r} clamped (estimate)"] = told
    return record


def _stress_errors(body: ReducedBody) -> str:
    """Return the error of the stress at each stress point over the stress, in clamped modes of equal strain energy."""
    points = [field for field in readouts_of(body.readouts, StressField) if field.surface is None]
    if not points:
        return ""
    frequency, shapes = body.eigenmodes(fixed=body.point_names[:1], n=STRESSED_MODES)
    states = (shapes[:, frequency > 0] / frequency[frequency > 0]).T
    stresses = [np.linalg.norm(von_mises(field.stress(states))) for field in points]
    errors = [np.linalg.norm(field.mesh_error(states)) for field in points]
    shares = [(field.name, 100 * e / s) for field, e, s in zip(points, errors, stresses, strict=True) if s]
    return ", ".join(f"{name!r} {share:.2g} %" for name, share in shares)


def _mesh_error(body: ReducedBody, model: FEModel) -> float:
    """Return the largest estimated discretisation error of the first eigenfrequencies, free and clamped at one point.

    If it was not estimated, that of the model is returned, which is NaN if it is unknown.
    """
    if body.released_stiffness is None:
        return model.discretization_error
    errors = [
        body.discretization_errors(fixed=fixed)[body.eigenfrequencies(fixed=fixed) > 0][:5]
        for fixed in ((), body.point_names[:1])
    ]
    return float(np.max(np.concatenate(errors), initial=0.0))


def _warn_of_coarse_mesh(name: str, error: float) -> None:
    """Warn of a large discretisation error."""
    if error > LARGE_MESH_ERROR:
        warn(
            f"body {name!r}: the error that its finite elements leave in the first eigenfrequencies is estimated as "
            f"{error_text(error)}; give build_fe_model a tolerance in place of element_size, or smaller elements or a "
            "higher order",
        )


def _cost(model: FEModel, seconds: float, error: float) -> dict[str, str]:
    """Describe as text the unknowns, time, memory and error of a reduction, if the model was made from a mesh.

    Args:
        model: what was reduced
        seconds: time after the mesh was made, NaN if unknown [s]
        error: largest estimated discretisation error, NaN if unknown
    """
    if not model.rounds:
        return {}
    spent = ""
    if not math.isnan(seconds):
        whole = seconds + model.rounds[-1].seconds
        spent = f", {whole:.1f} s with the mesh, {1e-9 * peak_memory():.2f} GB at most in this process"
    known = "not estimated" if math.isnan(error) else f"{error_text(error)} (estimate)"
    return {"cost and error": f"{model.n_dofs} unknowns{spent}; discretisation error {known}"}


def _percent(errors: Array) -> str:
    """Return errors as text in per cent."""
    return ", ".join(map(error_text, errors)) if errors.size else "none: it has no such modes"


def _extended_gram(gram: Array, parts: Sequence[Array], model: FEModel) -> Array:
    """Return the Gram matrix of scalar fields: 1, x, y, z, then the components x, y, z of each basis vector.

    Args:
        gram: the Gram matrix without the last part
        parts: basis vectors, shape (n_dofs, k) each
        model: the FE model
    """
    known, n = len(gram), 4 + 3 * sum(part.shape[1] for part in parts)
    result = np.zeros((n, n))
    result[:known, :known] = gram
    for i, component in enumerate(np.split(parts[-1], 3)):
        products, columns = model.scalar_mass_matrix @ component, slice(known + i, n, 3)
        with blas_threads(n * products.size):
            result[:4, columns] = model.fields @ products
            end = 4
            for part in parts:
                begin, end = end, end + 3 * part.shape[1]
                for j, other in enumerate(np.split(part, 3)):
                    result[begin + j : end : 3, columns] = other.T @ products
    return symmetric_from_upper(result)


def _mass_matrix(gram: Array) -> Array:
    """Return the mass matrix of the basis vectors, shape (n, n), from their Gram matrix, shape (4 + 3 n, 4 + 3 n)."""
    n = len(gram) // 3 - 1
    return np.einsum("jckc->jk", gram[4:, 4:].reshape(n, 3, n, 3))


def _project(
    condensed: Condensation, frequency: Array, parts: Sequence[Array], gram: Array, ports: Sequence[PortCoupling]
) -> ReducedBody:
    """Project mass, stiffness and read-outs on the basis vectors.

    Args:
        condensed: static condensation of the model
        frequency: frequencies of all basis vectors but the constraint modes [Hz]
        parts: basis vectors, n_dofs rows each
        gram: Gram matrix of their fields
        ports: electrical ports to keep
    """
    model, mass = condensed.fe_model, _mass_matrix(gram)
    n, n_interface = len(mass), len(condensed.stiffness)
    stiffness = np.zeros((n, n))
    stiffness[:n_interface, :n_interface] = condensed.stiffness
    stiffness[n_interface:, n_interface:] = np.diag((2 * np.pi * frequency) ** 2)
    readouts: list[Readout] = []
    if model.surface is not None and model.surface_evaluation is not None:
        evaluation = model.surface_evaluation
        modes = [[evaluation @ component for component in np.split(part, 3)] for part in parts]
        readouts.append(Picture(model.surface, np.concatenate([np.stack(m, axis=1) for m in modes], axis=2)))
    keep = deformation_projector([c.point.position for c in condensed.couplings])
    for port in ports:
        forces = np.concatenate([port.forces @ part for part in parts])
        forces[:n_interface] = keep.T @ forces[:n_interface]
        readouts.append(replace(port, forces=forces))
    return ReducedBody(
        model.name,
        remote_points=tuple(c.point for c in condensed.couplings),
        mass_matrix=mass,
        stiffness_matrix=stiffness,
        gram=gram,
        readouts=by_name(readouts),
        record={"finite element model": model.description},
    )
