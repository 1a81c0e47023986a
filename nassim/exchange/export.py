"""Export of reduced bodies and linear models to .mat and .npz files, and of bodies to linear models."""

from pathlib import Path

import numpy as np
import scipy

from nassim.base.checks import Array, known
from nassim.base.field_types import ArrayLike
from nassim.base.modal import elastic_damping_ratios, modal_damping_matrix
from nassim.base.storage import write_atomically
from nassim.bodies.reduced_body import ReducedBody
from nassim.bodies.remote_points import coordinate_names
from nassim.systems.linear_model import LinearModel


def export_body(body: ReducedBody, path: str | Path, *, damping_ratio: ArrayLike = 0.0) -> Path:
    """Write the matrices of a body to a .mat or .npz file, which `read_superelement` reads back exactly.

    The variables fit Simscape's block Reduced Order Flexible Solid: P, origins of the interfaces, (r, 3) [m]; K, M and
    the damping matrix C, (6 r + p, 6 r + p) [SI], with Tx Ty Tz Rx Ry Rz of each interface and then the p modal
    coordinates. The variable `names` contains the names of the interfaces. Electrical ports, passive points and inertia
    integrals other than K and M are omitted, because the format has no variables for them.

    Args:
        body: the reduced body.
        path: file with the ending .mat or .npz.
        damping_ratio: damping ratio of each free elastic mode, one number or one per mode from the lowest [-]; it adds
            to `ReducedBody.damping_matrix`.

    Returns:
        Path of the file.

    Raises:
        ValueError: for another ending.

    Source: MathWorks, Simscape Multibody, Reduced Order Flexible Solid.
    """
    variables = {
        "K": body.stiffness_matrix,
        "M": body.mass_matrix,
        "C": body_damping(body, damping_ratio),
        "P": body.positions,
        "names": np.array(body.point_names),
    }
    return _write(variables, path)


def export_model(model: LinearModel, path: str | Path) -> Path:
    """Write a state space to a .mat or .npz file: A, B, C, D [SI], the time step Ts [s], names of inputs and outputs.

    Ts is 0 for a continuous model. MATLAB reads both kinds by m = load(file); ss(m.A, m.B, m.C, m.D, m.Ts).

    Args:
        model: the linear model.
        path: file with the ending .mat or .npz.

    Returns:
        Path of the file.

    Raises:
        ValueError: for another ending.
    """
    return _write(
        {
            "A": model.A,
            "B": model.B,
            "C": model.C,
            "D": model.D,
            "Ts": np.array(model.time_step or 0.0),
            "inputs": np.array(model.inputs, dtype=str),
            "outputs": np.array(model.outputs, dtype=str),
        },
        path,
    )


def body_state_space(body: ReducedBody, *, damping_ratio: ArrayLike = 0.0) -> LinearModel:
    """Return a free body as a state space from forces and moments at its remote points to their motions.

    Inputs and outputs are named "bottom.ux" ... [N, N m; m, rad]. The states are the amplitudes of the eigenmodes, then
    their rates.

    Args:
        body: the reduced body.
        damping_ratio: damping ratio of each free elastic mode, one number or one per mode from the lowest [-].
    """
    frequency, shapes = body.eigenmodes()
    omega = 2 * np.pi * frequency
    n, b = len(omega), 6 * len(body.remote_points)
    damping = np.diag(2 * elastic_damping_ratios(frequency, damping_ratio) * omega)
    if body.damping_matrix is not None:
        damping += shapes.T @ body.damping_matrix @ shapes
    system = np.block([[np.zeros((n, n)), np.eye(n)], [-np.diag(omega**2), -damping]])
    forces = np.vstack([np.zeros((n, b)), shapes[:b].T])
    motions = np.hstack([shapes[:b], np.zeros((b, n))])
    names = coordinate_names(body.point_names)
    units = tuple("rad" if name.rsplit(".", 1)[1].startswith("r") else "m" for name in names)
    return LinearModel(system, forces, motions, np.zeros((b, b)), names, names, units=units)


def body_damping(body: ReducedBody, damping_ratio: ArrayLike) -> Array:
    """Return the body's damping matrix plus the one that gives each free elastic mode its damping ratio.

    Args:
        body: the reduced body.
        damping_ratio: damping ratio of each free elastic mode, one number or one per mode from the lowest [-].

    Returns:
        Damping matrix, (n, n) [N s/m for translations, N m s for rotations].
    """
    frequency, shapes = body.eigenmodes()
    ratio = elastic_damping_ratios(frequency, damping_ratio)
    modal = modal_damping_matrix(body.mass_matrix, frequency, shapes, ratio)
    return modal if body.damping_matrix is None else modal + body.damping_matrix


def _write(variables: dict[str, Array], path: str | Path) -> Path:
    target = Path(path)
    known("file ending", target.suffix, (".mat", ".npz"))
    with write_atomically(path) as temporary, temporary.open("wb") as file:
        if target.suffix == ".mat":
            scipy.io.savemat(file, variables, do_compression=True)
        else:
            np.savez_compressed(file, **variables)  # type: ignore[arg-type]
    return target
