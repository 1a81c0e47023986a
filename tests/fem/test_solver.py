"""The sparse solver: against SciPy, with unknowns held, refused matrices, choice of the solver."""

import sys
import threading
from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import ngsolve as ng
import numpy as np
import psutil
import pytest
import scipy.sparse as sp
from netgen.csg import unit_cube
from threadpoolctl import threadpool_info

from nassim.fem import multifrontal, pardiso, solver as solver_module
from nassim.fem.native_threads import LARGE_PRODUCT, blas_threads, share, threads
from nassim.fem.solver import SOLVERS, factor_memory, factorize, solver_name
from nassim.fem.sparse import symmetric_matrix

INSTALLED = [name for name, solver in SOLVERS.items() if solver.is_installed()]


def laplacian(n=12):
    """A 3D grid's Laplacian plus a little: sparse, symmetric positive definite."""
    line = sp.diags([-np.ones(n - 1), 2.01 * np.ones(n), -np.ones(n - 1)], offsets=[-1, 0, 1])
    eye = sp.eye(n)
    return sum(sp.kron(sp.kron(a, b), c) for a, b, c in ((line, eye, eye), (eye, line, eye), (eye, eye, line))).tocsr()


@pytest.fixture(params=INSTALLED)
def solver(request, monkeypatch):
    monkeypatch.setenv("NASSIM_SOLVER", request.param)
    return request.param


def test_symmetric_matrix_multiplies_as_the_whole():
    matrix = laplacian(5)
    half = symmetric_matrix(matrix)
    columns = np.random.default_rng(0).standard_normal((125, 3))
    assert half.lower.nnz < 0.7 * matrix.nnz
    assert np.allclose(half @ columns, matrix @ columns, atol=1e-12)
    assert np.allclose(half @ columns[:, 0], matrix @ columns[:, 0], atol=1e-12)
    between = half.between(columns)
    assert np.allclose(between, columns.T @ (matrix @ columns), atol=1e-11)
    assert np.array_equal(between, between.T)
    assert abs(half.to_scipy() - matrix).max() < 1e-15


def test_solves_one_and_many_right_hand_sides(solver):
    matrix = laplacian()
    factor = factorize(symmetric_matrix(matrix))
    rhs = np.random.default_rng(0).standard_normal((len(matrix.indptr) - 1, 37))
    assert factor.solver == solver
    assert np.abs(matrix @ factor.solve(rhs) - rhs).max() < 1e-10
    assert np.allclose(factor.solve(rhs[:, 0]), factor.solve(rhs)[:, 0], rtol=1e-9)


@pytest.fixture(scope="module")
def cube():
    return ng.Mesh(unit_cube.GenerateMesh(maxh=0.5, nthreads=1))


def test_held_unknowns_stay_at_zero(solver):
    matrix = laplacian(6)
    held = np.array([0, 17, 100])
    free = np.setdiff1d(np.arange(216), held)
    rhs = np.random.default_rng(1).standard_normal(216)
    solution = factorize(symmetric_matrix(matrix), held=held).solve(rhs)
    assert np.all(solution[held] == 0.0)
    assert np.allclose(matrix[free][:, free] @ solution[free], rhs[free], atol=1e-10)


def test_solves_with_an_assembled_matrix_of_ngsolve(solver, cube):
    """Its half storage is read as it is, or unfolded for solvers that need the whole matrix."""
    space = ng.H1(cube, order=2)
    u, v = space.TnT()
    form = ng.BilinearForm(space, symmetric=True, symmetric_storage=True)
    form += (ng.grad(u) * ng.grad(v) + u * v) * ng.dx
    matrix = symmetric_matrix(form.Assemble().mat)
    rhs = np.random.default_rng(2).standard_normal(space.ndof)
    assert np.allclose(matrix.to_scipy() @ factorize(matrix).solve(rhs), rhs, atol=1e-11)


def test_every_column_is_counted(solver):
    counted = []
    factorize(symmetric_matrix(laplacian(4))).solve(np.ones((64, 21)), advance=lambda n=1: counted.append(n))
    assert sum(counted) == 21


@pytest.mark.parametrize("name", ["multifrontal", "sparsecholesky"])
def test_singular_matrix_is_refused(monkeypatch, name):
    """A chain of springs without a wall."""
    monkeypatch.setenv("NASSIM_SOLVER", name)
    chain = sp.csr_matrix([[1.0, -1.0, 0.0], [-1.0, 2.0, -1.0], [0.0, -1.0, 1.0]])
    with pytest.raises(ValueError, match="singular or indefinite"):
        factorize(symmetric_matrix(chain))


def test_choice_of_the_solver(monkeypatch):
    monkeypatch.delenv("NASSIM_SOLVER", raising=False)
    assert solver_name() == INSTALLED[0]
    monkeypatch.setenv("NASSIM_SOLVER", "sparsecholesky")
    assert solver_name() == "sparsecholesky"
    monkeypatch.setenv("NASSIM_SOLVER", "superlu")
    with pytest.raises(ValueError, match="known: pardiso, multifrontal, cholmod, sparsecholesky, umfpack"):
        solver_name()


def only(monkeypatch, *packages):
    """Let only the solvers of these packages be installed."""
    table = {
        name: replace(solver, is_installed=lambda p=solver.package: p in packages) for name, solver in SOLVERS.items()
    }
    monkeypatch.setattr(solver_module, "SOLVERS", table)


def test_solvers_that_are_installed_are_preferred_in_order(monkeypatch):
    monkeypatch.delenv("NASSIM_SOLVER", raising=False)
    for there, expected in (
        (["nassim", "ngsolve", "cvxopt"], "multifrontal"),
        (["nassim", "ngsolve", "cvxopt", "mkl"], "pardiso"),
    ):
        only(monkeypatch, *there)
        assert solver_name() == expected


@pytest.mark.parametrize("name", ["cholmod", "pardiso"])
def test_missing_solver_says_how_to_get_it(monkeypatch, name):
    only(monkeypatch, "ngsolve")
    monkeypatch.setenv("NASSIM_SOLVER", name)
    with pytest.raises(ValueError, match=rf"pip install {SOLVERS[name].package}"):
        solver_name()


@pytest.mark.parametrize(
    ("code", "kind", "text"),
    [(-4, ArithmeticError, "not positive definite"), (-2, MemoryError, "memory"), (-10, RuntimeError, "error -10")],
)
def test_pardisos_errors_are_raised(monkeypatch, code, kind, text):
    """Codes of the manual of oneMKL, by a library that returns nothing else; its seven threads are set again."""
    threads_of_mkl = [7]

    def set_threads(count):
        threads_of_mkl.append(count)
        return threads_of_mkl[-2]

    def refuse(*arguments):
        arguments[-1]._obj.value = code

    library = SimpleNamespace(pardiso_64=refuse, MKL_Set_Num_Threads_Local=set_threads)
    monkeypatch.setattr(pardiso, "_library", lambda: library)
    with pytest.raises(kind, match=text):
        pardiso.Factor(sp.csr_matrix(np.eye(2)), n_threads=2)
    assert threads_of_mkl == [7, 2, 7]


@pytest.mark.parametrize("place", ["lib/libmkl_rt.so.2", "Library/bin/mkl_rt.2.dll", "lib/python3/libmkl_rt.so.2"])
def test_mkl_is_found_where_conda_and_pip_install_it(tmp_path, monkeypatch, place):
    """Beside an import library of Windows, which cannot be loaded."""
    library = tmp_path / place
    library.parent.mkdir(parents=True)
    files = [library.with_name("mkl_rt.lib"), *([library] if "python" in place else ())]
    for file in (*files, library):
        file.touch()
    monkeypatch.setattr(sys, "prefix", str(tmp_path))
    monkeypatch.setattr(
        pardiso.metadata,
        "files",
        lambda _: [SimpleNamespace(name=f.name, suffix=f.suffix, locate=f.resolve) for f in files],
    )
    assert pardiso.library_path.__wrapped__() == str(library.resolve())


def test_threads_may_be_nested(capfd):
    with threads(), threads():
        pass
    assert "can't change" not in capfd.readouterr().err


@pytest.mark.skipif(not hasattr(psutil.Process, "cpu_affinity"), reason="this system tells no processors of a process")
def test_threads_are_as_many_as_told_or_as_there_are_processors(monkeypatch):
    asked = []
    monkeypatch.setattr("ngsolve.SetNumThreads", asked.append)
    monkeypatch.setenv("NASSIM_THREADS", "3")
    with threads():
        pass
    monkeypatch.delenv("NASSIM_THREADS")
    with threads():
        pass
    assert asked == [3, len(psutil.Process().cpu_affinity())]


def test_only_large_products_are_shared_among_threads(monkeypatch):
    """Of the threads that BLAS has, as it says. Within a context of two, solves by fronts and small fronts have one."""
    counts, solve, eliminate = [], multifrontal.Factor.solve, multifrontal.factorize_in_place

    def counting(work, *given, **options):
        libraries = [one for one in threadpool_info() if one["internal_api"] == "openblas"]
        counts.append({one["num_threads"] for one in libraries if "cvxopt" not in one["filepath"]})  # has its own
        return work(*given, **options)

    monkeypatch.setenv("NASSIM_SOLVER", "multifrontal")
    monkeypatch.setenv("NASSIM_THREADS", "2")
    monkeypatch.setattr(multifrontal.Factor, "solve", lambda *given: counting(solve, *given))
    monkeypatch.setattr(multifrontal, "factorize_in_place", partial(counting, eliminate))
    with blas_threads(LARGE_PRODUCT):
        counting(factorize, symmetric_matrix(laplacian(4)))
    assert counts[0] == {2}
    assert counts[1:] == [{1}] * (len(counts) - 1)
    assert len(counts) > 2


def test_pieces_of_work_run_at_once_with_blas_on_one_thread_in_each(monkeypatch):
    """As many at once as there are threads, in an order of results that does not depend on who ends first."""
    together = threading.Barrier(3)

    def work(number):
        together.wait(timeout=30)
        with blas_threads(LARGE_PRODUCT):
            limits = {one["num_threads"] for one in threadpool_info() if one["internal_api"] == "openblas"}
        return number, limits, share(lambda _: threading.get_ident(), range(2)) == 2 * [threading.get_ident()]

    monkeypatch.setenv("NASSIM_THREADS", "3")
    assert share(work, range(6)) == [(number, {1}, True) for number in range(6)]
    with pytest.raises(ZeroDivisionError):
        share(lambda number: 1 / number, range(3))
    assert threading.get_ident() not in share(lambda _: threading.get_ident(), range(3))
    monkeypatch.setenv("NASSIM_THREADS", "1")
    assert share(lambda _: threading.get_ident(), range(3)) == 3 * [threading.get_ident()]


def test_memory_estimate_of_a_dense_triangle():
    """One element joins all its unknowns: half of n^2 numbers of eight bytes, with three unknowns per scalar one."""
    assert factor_memory(np.zeros((1, 3)), [np.arange(50)]) == 8 * 150**2 / 2


def test_memory_estimate_of_fronts_between_quarters():
    """Four fronts of 24 elements with an unknown each, then one between the last two quarters, then one of the halves.

    The last one is of the first and the third quarter, so that these fronts, and the one before it, contain it.
    """
    unknowns = [np.array([k]) for k in range(96)]
    for shared, members in ((96, (0, 48)), (97, (49, 72))):
        for k in members:
            unknowns[k] = np.append(unknowns[k], shared)
    one, quarter = 3**2, (3 * 24) ** 2
    entries = 4 * quarter / 2 + 4 * 24 * one + (one / 2 + one) + one / 2
    assert factor_memory(np.arange(96.0)[:, None] * np.eye(1, 3), unknowns) == 8 * entries


def test_memory_estimate_of_a_line_and_of_a_cube():
    """A line of n linear elements factorises without fill; a cube of n^3 takes about n^4 entries."""
    n = 4096
    line = factor_memory(np.column_stack([np.arange(n), np.zeros((n, 2))]), [np.array([k, k + 1]) for k in range(n)])
    assert line < 8 * 9 * 60 * n
    sizes = []
    for m in (8, 16):
        corner = np.stack(np.meshgrid(*[np.arange(m)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
        offsets = np.stack(np.meshgrid(*[np.arange(2)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
        nodes = (corner[:, None] + offsets) @ np.array([(m + 1) ** 2, m + 1, 1])
        sizes.append(factor_memory(corner + 0.5, list(nodes)))
    assert 3.3 < np.log2(sizes[1] / sizes[0]) < 4.7


def test_random_matrix_with_held_unknowns():
    rng = np.random.default_rng(3)
    part = sp.csr_matrix(rng.standard_normal((300, 300)) * (rng.random((300, 300)) < 0.02))
    matrix = (part @ part.T + sp.eye(300)).tocsr()
    held = rng.choice(300, 30, replace=False)
    free = np.setdiff1d(np.arange(300), held)
    factor = factorize(symmetric_matrix(matrix), held=held)
    for rhs in (rng.standard_normal(300), rng.standard_normal((300, 5))):
        solution = factor.solve(rhs)
        assert solution.shape == rhs.shape
        assert np.all(solution[held] == 0.0)
        assert np.allclose(solution[free], np.linalg.solve(matrix.toarray()[np.ix_(free, free)], rhs[free]), rtol=1e-8)


@pytest.mark.parametrize("turned", [False, True])
def test_indefinite_matrix_is_refused(solver, turned):
    """By a diagonal entry so large that energies are positive, or, where a rotation hides the sign, by an energy."""
    turn = np.linalg.qr(np.random.default_rng(0).standard_normal((4, 4)))[0] if turned else np.eye(4)
    factorize(symmetric_matrix(sp.csr_matrix(turn @ np.diag([3.0, 2.0, 3.0, 4.0]) @ turn.T)))
    with pytest.raises(ValueError, match="singular or indefinite"):
        factorize(symmetric_matrix(sp.csr_matrix(turn @ np.diag([3.0, -0.1 if turned else -100.0, 3.0, 4.0]) @ turn.T)))
