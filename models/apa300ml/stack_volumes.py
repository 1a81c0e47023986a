"""Properties of the bench from stresses in the stacks' volume: an independent check of reduction, points and ports.

The actuator stacks have the free strain s of a voltage (an eigenstrain). The voltage V of the sensor stack follows from
the stress averaged over its volume: without charge, 0 = integral of s : sigma + C V. Here sigma is the stress of the
strain beyond s V, and C is the capacitance of the unloaded stack. This module has its own mesh of tetrahedra, boundary
conditions on the faces of the pads (clamped below, guided above with the payload distributed over the face), elasticity
and loads.
"""

from dataclasses import dataclass

import netgen.occ as occ
import ngsolve as ng
import numpy as np
import scipy.linalg
import scipy.optimize

from . import PZT, STACK, STEEL, make_apa300ml

ACTUATORS, SENSOR = "actuator_stack_1|actuator_stack_2", "sensor_stack"
N_MOMENTS = 4
"""Number of Krylov vectors per load; below 200 Hz, more vectors change less than eight digits."""


@dataclass(frozen=True)
class StackFigures:
    """Properties of the bench from stresses.

    Attributes:
        zero: frequency of the zero of V_s/V_a [Hz]
        axial_zero: the same for a sensor that measures the mean axial stress only [Hz]
        pole: first eigenfrequency with the sensor open [Hz]
        shorted_pole: first eigenfrequency with the sensor shorted [Hz]
        sensor_gain: static V_s/V_a with the sensor open [V/V]
        encoder_gain: static d_e/V_a with the sensor open [m/V]
        shorted_encoder_gain: static d_e/V_a with the sensor shorted [m/V]
        stiffness: stiffness of the whole actuator with all stacks shorted [N/m]
        stroke: displacement of the top under the full voltage range on all three stacks [m]
    """

    zero: float
    axial_zero: float
    pole: float
    shorted_pole: float
    sensor_gain: float
    encoder_gain: float
    shorted_encoder_gain: float
    stiffness: float
    stroke: float


def stack_figures(
    *, payload_mass: float = 5.0, gain: float = 20.0, element_size: float = 5e-3, order: int = 3
) -> StackFigures:
    """Compute the properties of the bench from stresses in the stacks' volume.

    Args:
        payload_mass: mass on top, guided along z [kg]
        gain: stack voltage per drive voltage [V/V]
        element_size: size of the tetrahedra [m]
        order: order of the tetrahedra
    """
    k, m, (drive, sensor, both, top_row, axial_stress), capacitance = _reduced(payload_mass, element_size, order)
    drive = gain * drive
    opened = k + np.outer(sensor, sensor) / capacitance

    def zero_of(reading: np.ndarray) -> float:
        def reads(frequency: float) -> float:
            return float(reading @ np.linalg.solve(k - (2 * np.pi * frequency) ** 2 * m, drive))

        return float(scipy.optimize.brentq(reads, 15.0, 80.0))

    def first(matrix: np.ndarray) -> float:
        return float(np.sqrt(scipy.linalg.eigvalsh(matrix, m)[0]) / (2 * np.pi))

    static = np.linalg.solve(opened, drive)
    return StackFigures(
        zero=zero_of(sensor),
        axial_zero=zero_of(axial_stress),
        pole=first(opened),
        shorted_pole=first(k),
        sensor_gain=float(-sensor @ static / capacitance),
        encoder_gain=float(top_row @ static),
        shorted_encoder_gain=float(top_row @ np.linalg.solve(k, drive)),
        stiffness=float(1 / (top_row @ np.linalg.solve(k, top_row))),
        stroke=float(abs(STACK.voltage_range * top_row @ np.linalg.solve(k, both))),
    )


def _reduced(
    payload_mass: float, element_size: float, order: int
) -> tuple[np.ndarray, np.ndarray, list[np.ndarray], float]:
    """Return the bench in few coordinates, see `stack_figures` for the arguments.

    Returns:
        Stiffness and mass matrix, (k, k). Rows on the coordinates, (k,): forces by a volt on the actuator stacks, on
        the sensor stack and on all stacks; the displacement of the top; the sensor's mean axial stress. The
        capacitance of the sensor stack with all strains held [F].
    """
    shape = make_apa300ml().shape
    geometry = occ.OCCGeometry(shape)
    mesh = ng.Mesh(
        geometry.GenerateMesh(maxh=element_size, curvaturesafety=1.0, segmentsperedge=0.3, grading=0.5, nthreads=1)
    )
    mesh.Curve(order)
    space = ng.VectorH1(
        mesh, order=order, dirichletx="bottom_pad|top_pad", dirichlety="bottom_pad|top_pad", dirichletz="bottom_pad"
    )
    u, v = space.TnT()
    metal = {"frame": STEEL, "spacer": STEEL}
    materials = {name: metal.get(name, PZT) for name in mesh.GetMaterials()}
    young = mesh.MaterialCF({name: m.young_modulus for name, m in materials.items()})
    poisson = mesh.MaterialCF({name: m.poisson_ratio for name, m in materials.items()})
    density = mesh.MaterialCF({name: m.density for name, m in materials.items()})

    def stress(strain: ng.CoefficientFunction) -> ng.CoefficientFunction:
        return young / (1 + poisson) * (strain + poisson / (1 - 2 * poisson) * ng.Trace(strain) * ng.Id(3))

    strain_u, strain_v = ng.Sym(ng.Grad(u)), ng.Sym(ng.Grad(v))
    stiffness = ng.BilinearForm(space, symmetric=True)
    stiffness += ng.InnerProduct(stress(strain_u), strain_v) * ng.dx
    mass = ng.BilinearForm(space, symmetric=True)
    mass += density * u * v * ng.dx
    face = ng.Integrate(1.0, mesh, definedon=mesh.Boundaries("top_pad"))
    mass += payload_mass / face * u[2] * v[2] * ng.ds("top_pad")

    along = STACK.free_stroke / STACK.voltage_range / STACK.length
    across = STACK.transverse_ratio * along
    free_strain = ng.CoefficientFunction((along, 0, 0, 0, across, 0, 0, 0, across), dims=(3, 3))
    axial = ng.CoefficientFunction((1, 0, 0, 0, 0, 0, 0, 0, 0), dims=(3, 3))

    def row(integrand: ng.CoefficientFunction, region: str) -> np.ndarray:
        form = ng.LinearForm(space)
        form += integrand * ng.dx(definedon=mesh.Materials(region))
        return form.Assemble().vec.FV().NumPy().copy()

    drive, sensor, both = (
        row(ng.InnerProduct(stress(free_strain), strain_v), region)
        for region in (ACTUATORS, SENSOR, f"{ACTUATORS}|{SENSOR}")
    )
    axial_stress = row(ng.InnerProduct(axial, stress(strain_v)), SENSOR)
    top = ng.LinearForm(space)
    top += v[2] / face * ng.ds("top_pad")
    top_row = top.Assemble().vec.FV().NumPy().copy()
    # With all strains held, the stress from the sensor's own voltage reduces its charge.
    held = ng.Integrate(ng.InnerProduct(stress(free_strain), free_strain), mesh, definedon=mesh.Materials(SENSOR))
    capacitance = STACK.capacitance - held

    loads = np.stack([drive, sensor, both, top_row], axis=1)
    with ng.TaskManager():
        stiffness.Assemble()
        mass.Assemble()
        basis = _moments(stiffness.mat, mass.mat, space.FreeDofs(), loads)
    k, m = (_projected(matrix, basis) for matrix in (stiffness.mat, mass.mat))
    return k, m, [basis.T @ r for r in (drive, sensor, both, top_row, axial_stress)], capacitance


def _moments(stiffness: ng.BaseMatrix, mass: ng.BaseMatrix, free: ng.BitArray, loads: np.ndarray) -> np.ndarray:
    """Return an orthonormal basis of K^-1 f, K^-1 M K^-1 f, ... for the loads f, shape (n, k)."""
    inverse = stiffness.Inverse(free, inverse="sparsecholesky")
    source, answer = stiffness.CreateColVector(), stiffness.CreateColVector()
    vectors = []
    for load in loads.T:
        source.FV().NumPy()[:] = load
        for _ in range(N_MOMENTS):
            answer.data = inverse * source
            vectors.append(answer.FV().NumPy().copy())
            source.data = mass * answer
    scaled = np.stack(vectors, axis=1)
    left, size, _ = np.linalg.svd(scaled / np.linalg.norm(scaled, axis=0), full_matrices=False)
    result: np.ndarray = left[:, size > 1e-9 * size[0]]
    return result


def _projected(matrix: ng.BaseMatrix, basis: np.ndarray) -> np.ndarray:
    source, answer = matrix.CreateColVector(), matrix.CreateColVector()
    columns = []
    for vector in basis.T:
        source.FV().NumPy()[:] = vector
        answer.data = matrix * source
        columns.append(basis.T @ answer.FV().NumPy())
    result = np.stack(columns, axis=1)
    return 0.5 * (result + result.T)
