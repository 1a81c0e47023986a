"""The APA300ML reduced by Exudyn's own means, for benchmark_reduction.py."""

from dataclasses import dataclass
from typing import Any

import exudyn.FEM as exudyn_fem
import netgen.occ  # noqa: F401  (before ngsolve: loads the CAD kernel)
import ngsolve as ng
import numpy as np
import scipy.sparse as sp

from nassim import FEModel, Solid
from nassim.base import eigenmodes
from nassim.fem import make_coupling


@dataclass(frozen=True)
class ExudynReduction:
    """Exudyn's FE interface with its mode basis, its bilinear forms of mass and stiffness, the interfaces' nodes."""

    fem: Any
    forms: tuple[Any, Any]
    interfaces: list[list[int]]


def reduce_by_exudyn(mesh: ng.Mesh, solid: Solid, *, n_modes: int, by_ngsolve: bool) -> ExudynReduction:
    """From the mesh to Exudyn's Hurty-Craig-Bampton basis, by its NGSolve variant or by SciPy."""
    materials = {
        name: {"youngsModulus": m.young_modulus, "poissonsRatio": m.poisson_ratio, "density": m.density}
        for name, m in solid.materials.items()
    }
    fem = exudyn_fem.FEMinterface()
    faces = sorted({face for point in solid.remote_points for face in point.faces})
    mass, stiffness, _ = fem.ImportMeshFromNGsolve(mesh, materials=materials, meshOrder=2, boundaryNamesList=faces)
    interfaces = [
        sorted({node for face in point.faces for node in fem.GetNodesOfNGsolveBoundary(mesh, face)})
        for point in solid.remote_points
    ]
    if by_ngsolve:
        fem.ComputeHurtyCraigBamptonModesNGsolve(mass, stiffness, interfaces, n_modes)
    else:
        fem.ComputeHurtyCraigBamptonModes(interfaces, n_modes, useSparseSolver=True)
    return ExudynReduction(fem, (mass, stiffness), interfaces)


def full_model(reduction: ExudynReduction, solid: Solid) -> FEModel:
    """Exudyn's own matrices in the form of which nassim knows the full eigenfrequencies."""
    positions = reduction.fem.GetNodePositionsAsArray()
    n = len(positions)
    fields = np.vstack([np.ones(n), positions.T])
    couplings = tuple(
        make_coupling(point, np.array(nodes), fields[:, nodes], fields[:, nodes])
        for point, nodes in zip(solid.remote_points, reduction.interfaces, strict=True)
    )
    mass, stiffness = (_to_scipy(form.mat) for form in reduction.forms)
    return FEModel(solid.name, stiffness=stiffness, scalar_mass_matrix=mass[:n, :n], fields=fields, couplings=couplings)


def clamped_eigenfrequencies(reduction: ExudynReduction, model: FEModel) -> np.ndarray:
    """Eigenfrequencies of Exudyn's basis [Hz]: it leaves out the first interface's motions, as if that were clamped."""
    basis = reduction.fem.modeBasis["matrix"]
    # Exudyn counts x y z per node, nassim all nodes per direction.
    basis = basis.reshape(-1, 3, basis.shape[1]).transpose(1, 0, 2).reshape(model.n_dofs, -1)
    return eigenmodes(basis.T @ (model.stiffness @ basis), basis.T @ (model.mass_matrix @ basis))[0]


def _to_scipy(matrix: Any) -> sp.csr_matrix:
    values, columns, starts = (np.array(part) for part in matrix.CSR())
    return sp.csr_matrix((values, columns, starts), shape=(matrix.height, matrix.width))
