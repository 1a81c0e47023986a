"""Programs in other states, of which at most two are coupled: the same outputs for far fewer operations.

Damping that is not modal, gravity and circuits couple the modes of a scene, so its state matrix is full. In the
directions of its eigenvectors it consists of blocks of one or two states.
"""

from dataclasses import replace

import numpy as np
import scipy

from nassim.base.checks import Array
from nassim.systems.state_space import WELL_CONDITIONED, balanced_states, uncoupled
from nassim.systems.step_program import RateProgram, SampleMatrices, StepProgram, run_program

CHECKED_SAMPLES = 500
"""Number of samples for which a program in other states is compared with the original one."""
DISTINCT = 1e-10
"""Difference of eigenvalues, relative to the largest, below which their eigenvectors are not refined in each other."""
AGREED = 1e-12
"""Largest difference between the outputs of both, relative to the largest value of each output."""


def block_diagonal(state: Array) -> tuple[Array, Array, Array]:
    """Find states z of x = T z in which a matrix has blocks of at most two states, where eigenvectors allow it.

    A part whose eigenvectors are not independent, as a rigid-body motion under a load, keeps its states.

    Args:
        state: A, (n, n).

    Returns:
        T, its inverse, and the matrix T^-1 A T, (n, n) each.
    """
    balanced, scale = balanced_states(state)
    n = len(state)
    to_x, to_z, result = np.eye(n), np.eye(n), np.array(state)
    for parts in uncoupled(state):
        if parts.shape[1] <= 2:
            continue
        for part in parts:
            place = np.ix_(part, part)
            poles, vectors = refined_eigenvectors(balanced[place])
            kept = poles.imag >= 0
            columns = [
                column
                for pole, vector in zip(poles[kept], vectors[:, kept].T, strict=True)
                for column in ((vector.real, vector.imag) if pole.imag else (vector.real,))
            ]
            basis = np.array(columns).T
            if basis.shape[1] != len(part) or np.linalg.cond(basis) > WELL_CONDITIONED:
                continue
            blocks = [
                np.array([[pole.real, pole.imag], [-pole.imag, pole.real]]) if pole.imag else np.array([[pole.real]])
                for pole in poles[kept]
            ]
            own = scale[part]
            to_x[place], to_z[place] = own[:, None] * basis, np.linalg.inv(basis) / own
            result[place] = scipy.linalg.block_diag(*blocks)
    return to_x, to_z, result


def refined_eigenvectors(matrix: Array) -> tuple[Array, Array]:
    """Compute eigenvalues and eigenvectors to the accuracy of the matrix's entries.

    The usual ones have errors of the size of the matrix times its number of rows, which a lightly damped motion shows
    as an error of its period after many samples. A step of Newton's method in extended precision removes them.

    Args:
        matrix: (n, n).

    Returns:
        Eigenvalues, complex, (n,), and unit eigenvectors as columns, complex, (n, n).

    Source: J. J. Dongarra, C. B. Moler, J. H. Wilkinson, Improving the accuracy of computed eigenvalues and
        eigenvectors, SIAM J. Numerical Analysis 20 (1983) 23-45.
    """
    poles, vectors = np.linalg.eig(matrix)
    if np.linalg.cond(vectors) > WELL_CONDITIONED:
        return poles, vectors
    right = vectors.astype(np.clongdouble)
    left = np.linalg.inv(vectors).astype(np.clongdouble)
    for _ in range(2):
        left = 2 * left - left @ (right @ left)
        projected = left @ (matrix.astype(np.longdouble) @ right)
        found = np.diagonal(projected)
        gap = found[None, :] - found[:, None]
        close = np.abs(gap) < DISTINCT * np.abs(found).max()
        right = right + right @ np.where(close, 0.0, projected / np.where(close, 1.0, gap))
        right = right / np.sqrt((np.abs(right) ** 2).sum(axis=0))
        left = np.linalg.inv(right.astype(complex)).astype(np.clongdouble)
    real = poles.imag == 0
    return np.where(real, found.real, found).astype(complex), np.where(real, right.real, right).astype(complex)


def uncoupled_steps(program: StepProgram) -> StepProgram:
    """Return a program in states that are not coupled, or the same one where its outputs would differ.

    The states of controllers stay as they are.
    """
    if not program.n_states:
        return program
    n = program.commands.start
    plant = program.samples[0].state[:n, :n]
    to_x, to_z, blocks = block_diagonal(plant)
    if np.count_nonzero(blocks) >= np.count_nonzero(plant):
        return program
    more = program.n_states - n
    to_x, to_z = (scipy.linalg.block_diag(matrix, np.eye(more)) for matrix in (to_x, to_z))

    def changed(sample: SampleMatrices) -> SampleMatrices:
        by_converted = to_z @ sample.state[:, program.n_states :]
        state = to_z @ sample.state[:, : program.n_states] @ to_x
        state[:n, :n] = blocks
        outputs = sample.outputs @ to_x
        return SampleMatrices(sample.due, np.hstack([state, by_converted]), outputs, sample.corrections)

    result = replace(
        program,
        start=to_z @ program.start,
        start_by_inputs=to_z @ program.start_by_inputs,
        samples=tuple(map(changed, program.samples)),
        taken=to_z @ program.taken,
        reading=program.reading @ to_x,
    )
    noise = np.random.default_rng(0).normal(size=(len(program.inputs), CHECKED_SAMPLES))
    expected, found = run_program(program, noise), run_program(result, noise)
    largest = np.abs(expected).max(axis=1, keepdims=True)
    return result if np.all(np.abs(found - expected) <= AGREED * largest) else program


def uncoupled_rates(program: RateProgram) -> RateProgram:
    """Return a continuous program in states that are not coupled, where its eigenvectors allow it."""
    a, b, c, d = program.matrices
    to_x, to_z, blocks = block_diagonal(a)
    if np.count_nonzero(blocks) >= np.count_nonzero(a):
        return program
    return replace(program, matrices=(blocks, to_z @ b, c @ to_x, d), start=to_z @ program.start)
