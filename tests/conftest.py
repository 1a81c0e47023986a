"""Shared fixtures: small models made by hand, and the real APA, reduced once for all; how tests are spread."""

import gc
import os
from dataclasses import dataclass, replace
from pathlib import Path

os.environ.setdefault("MPLBACKEND", "Agg")
PROCESSORS = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
if "PYTEST_XDIST_WORKER" in os.environ:  # threads that spin while they wait would take the other workers' processors
    _share = max(1, PROCESSORS // int(os.environ["PYTEST_XDIST_WORKER_COUNT"]))
    for _threads in ("NASSIM_THREADS", "NGS_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        _asked = os.environ.get(_threads, "1")
        os.environ[_threads] = str(min(int(_asked) if _asked.isdigit() else 1, _share))

import exudyn as exu
import netgen.occ as occ
import ngsolve as ng
import numpy as np
import pytest
import scipy.sparse as sp
from scipy.spatial.transform import Rotation

from models.apa300ml import COARSE, PORTS, PRISMS, STACK, make_apa300ml, reduced_apa300ml
from models.bench import AMPLIFIER_GAIN, make_bench, sensor_span_constant
from nassim import (
    FEModel,
    GaugeLine,
    Material,
    RemotePoint,
    Solid,
    StressPoint,
    StressSurface,
    build_fe_model,
    condense,
    craig_bampton,
)
from nassim.fem.assembly import assemble_mesh
from nassim.fem.curving import curve_mesh
from nassim.fem.fe_model import make_coupling
from nassim.fem.meshing import generate_mesh
from nassim.scene.part import ForceElement
from nassim.simulation.model import period_correction as compensation

MOST_WORKERS = 8
"""Each imports everything and condenses the APA for itself, so more of them gain little."""


@pytest.hookimpl(tryfirst=True)
def pytest_cmdline_main(config):
    """Folders of tests, so all of them too, are spread over the processors; files and single tests are not.

    `-n 0` spreads nothing, nor does anything without pytest-xdist.
    """
    asked = config.getoption("numprocesses", 0) is not None or config.option.dist != "no" or config.option.usepdb
    folders = all(Path(place).is_dir() for place in config.args)
    if folders and PROCESSORS > 1 and not asked and not hasattr(config, "workerinput"):
        config.option.numprocesses, config.option.dist = min(PROCESSORS, MOST_WORKERS), "worksteal"


@pytest.hookimpl(wrapper=True)
def pytest_collection():
    """Modules and thousands of tests stay until the end, so garbage is looked for neither meanwhile nor in them."""
    gc.disable()
    collected = yield
    gc.freeze()
    gc.enable()
    return collected


@pytest.fixture(scope="session", autouse=True)
def _cache(tmp_path_factory, pytestconfig):
    """Tests neither read nor fill the user's cache; all workers share one."""
    folder = tmp_path_factory.getbasetemp()
    os.environ["NASSIM_CACHE"] = str((folder.parent if hasattr(pytestconfig, "workerinput") else folder) / "cache")


@dataclass(frozen=True)
class OwnReadout:
    """A kind of read-out that nassim does not know: a number that is linear in the coordinates; row: (n,)."""

    name: str
    row: np.ndarray

    @property
    def n_coordinates(self):
        return len(self.row)

    def projected(self, change):
        return replace(self, row=self.row @ change)


STEEL = Material("steel", young_modulus=200e9, poisson_ratio=0.3, density=7800.0)


def assert_limit(make, message):
    """A size may be 0.9 of its limit, and 1.1 of it is refused with a message; make: function of the share."""
    make(0.9)
    with pytest.raises(ValueError, match=message):
        make(1.1)


def make_bar(length=0.1, side=0.01, material=STEEL, coupling="rbe3", height=None):
    """A square or rectangular bar along x with a remote point at either end."""
    height = height or side
    shape = occ.Box(occ.Pnt(0, -side / 2, -height / 2), occ.Pnt(length, side / 2, height / 2))
    shape.name = "bar"
    shape.faces.Min(occ.X).name, shape.faces.Max(occ.X).name = "left", "right"
    points = (
        RemotePoint("left", "left", np.zeros(3), coupling),
        RemotePoint("right", "right", np.array([length, 0, 0]), coupling),
    )
    return Solid("bar", shape, {"bar": material}, points)


def turn(axis, angle):
    """Rotation about an axis, by Rodrigues' formula."""
    x, y, z = np.asarray(axis) / np.linalg.norm(axis)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


def turned_by(*vector):
    """Rotation by a rotation vector [rad]."""
    return Rotation.from_rotvec(vector).as_matrix()


def motion_beside(offset):
    """Motion of a point beside a rigid body's centre per unit of the centre's motion, (6, 6)."""
    x, y, z = offset
    result = np.eye(6)
    result[:3, 3:] = [[0, z, -y], [-z, 0, x], [y, -x, 0]]
    return result


@dataclass(frozen=True)
class Given(ForceElement):
    """A part of any terms."""

    given: tuple = ()

    def terms(self, scene):
        return self.given


def lattice(coupling="rbe3", n=4, stiffness=1e6, node_mass=0.01):
    """A box of n x 3 x 3 point masses with springs to all neighbours: an FE model made by hand."""
    grid = np.array([[i, j, k] for i in range(n) for j in range(3) for k in range(3)], dtype=float) * 0.01
    count = len(grid)
    gaps = grid[:, None] - grid
    a, b = np.nonzero(np.tril(np.linalg.norm(gaps, axis=2) < 0.018, -1))
    arms = gaps[a, b]
    blocks = stiffness * np.einsum("ki,kj->kij", arms, arms) / np.sum(arms**2, axis=1)[:, None, None]
    matrix = np.zeros((3, count, 3, count))
    for p, q, sign in ((a, a, 1), (b, b, 1), (a, b, -1), (b, a, -1)):
        np.add.at(matrix, (slice(None), p, slice(None), q), sign * blocks)
    matrix = matrix.reshape(3 * count, 3 * count)
    fields = np.vstack([np.ones(count), grid.T])
    couplings = []
    for name, x in (("left", 0.0), ("right", grid[:, 0].max())):
        dofs = np.flatnonzero(np.abs(grid[:, 0] - x) < 1e-9)
        point = RemotePoint(name, name, np.array([x, 0.01, 0.01]), coupling)
        couplings.append(make_coupling(point, dofs, fields[:, dofs], fields[:, dofs]))
    # Unequal masses: no double eigenvalues, whose shapes would not be unique.
    mass = sp.diags(node_mass * np.random.default_rng(0).uniform(0.7, 1.3, count)).tocsr()
    return FEModel(
        "lattice",
        stiffness=sp.csr_matrix(matrix),
        scalar_mass_matrix=sp.csr_matrix(mass),
        fields=fields,
        couplings=tuple(couplings),
    )


def angular_momentum(system, body):
    """About the world's origin, from the state of Exudyn's nodes and the body's Gram matrix, shape (3,)."""

    def read(node, kind):
        return np.array(system.mbs.GetNodeOutput(node, getattr(exu.OutputVariableType, kind)))

    rigid, modal = system.nodes["bar"], system.flexible["bar"].nodes[0][0]
    rotation = read(rigid, "RotationMatrix").reshape(3, 3)
    n = len(body.mass_matrix)
    fields = np.zeros((4 + 3 * n, 3))  # position from the frame's origin, in the frame
    fields[0], fields[1:4] = -body.remote_points[0].position, np.eye(3)
    fields[4 + 18 :] += np.kron(read(modal, "Coordinates")[:, None], np.eye(3))
    velocity = np.cross(read(rigid, "AngularVelocityLocal"), fields)
    velocity[0] += rotation.T @ read(rigid, "Velocity")
    velocity[4 + 18 :] += np.kron(read(modal, "Coordinates_t")[:, None], np.eye(3))
    position = fields.copy()
    position[0] += rotation.T @ read(rigid, "Position")
    moment = position.T @ body.gram @ velocity
    return rotation @ np.array([moment[1, 2] - moment[2, 1], moment[2, 0] - moment[0, 2], moment[0, 1] - moment[1, 0]])


def pair_forces_and_readings():
    """The force-pair bench's input and outputs at the actuator's remote points, for `full_frequency_response`."""
    force, sensitivity = AMPLIFIER_GAIN * STACK.force_per_volt, sensor_span_constant()
    inputs = {"actuator_voltage": {"actuator_end.ux": force, "junction.ux": -force}}
    outputs = {
        "sensor_voltage": {"sensor_end.ux": sensitivity, "junction.ux": -sensitivity},
        "encoder": {"top.uz": 1.0},
    }
    return inputs, outputs


def meshed(mesh, solid, order):
    """The FE model of a solid on a copy of a Netgen mesh: as of `build_fe_model`, whose time is mostly Netgen's.

    Models of one mesh share its curving, so that another order would change those that are there.
    """
    curved = ng.Mesh(mesh.Copy())
    curve_mesh(curved, order)
    return assemble_mesh(curved, solid, order)


@pytest.fixture(scope="session")
def stressed_bar():
    """The square bar of `make_bar`, reduced with stress at two points and on its surface, and with a gauge."""
    solid = make_bar()
    model = meshed(generate_mesh(solid, element_size=0.005, layer_thickness=0.0125, extrude="x"), solid, 4)
    places = (
        StressPoint("top", (0.043, 0.0, 0.005)),
        StressPoint("inside", (0.052, 0.0021, -0.0013)),
        GaugeLine("gauge", (0.043, 0.001, 0.005), (1, 0, 0), 0.02),
        StressSurface("surface stress"),
    )
    return craig_bampton(model, n_modes=4, stress=places, progress=False)


@pytest.fixture(scope="session")
def apa_solid():
    return make_apa300ml()


@pytest.fixture(scope="session")
def apa_tetrahedra(apa_solid):
    """Netgen mesh of the APA300ML."""
    return generate_mesh(apa_solid, element_size=5e-3)


@pytest.fixture(scope="session")
def apa_prisms(apa_solid):
    """Netgen mesh of the APA300ML, the default one of `reduced_apa300ml`."""
    return generate_mesh(apa_solid, element_size=5e-3, **PRISMS)


@pytest.fixture(scope="session")
def apa_with_ports_condensed():
    model = build_fe_model(make_apa300ml(ports=PORTS), element_size=8e-3, order=2, progress=False)
    return condense(model, progress=False)


@pytest.fixture(scope="session")
def apa_with_ports(apa_with_ports_condensed):
    """The APA300ML with its electrical ports, on a coarse mesh: for scripts, the cache has it then."""
    return reduced_apa300ml(ports=PORTS, **COARSE, condensed=apa_with_ports_condensed, progress=False)


@pytest.fixture(scope="session")
def apa_model(apa_with_ports_condensed, apa_solid):
    """That without ports, which costs no mesh of its own."""
    model = apa_with_ports_condensed.fe_model
    return replace(model, ports=(), _condensation=None, _source=(model._source[0], apa_solid))


@pytest.fixture(scope="session")
def apa_condensed(apa_model):
    return condense(apa_model, progress=False)


@pytest.fixture(scope="session")
def apa(apa_condensed):
    """The APA300ML, on a mesh which is coarser than the default."""
    return craig_bampton(apa_condensed, n_modes=6, discretization=False, progress=False)


@pytest.fixture(scope="session")
def bench(apa):
    """With a pair of forces for the stacks: no circuits, which most tests do without."""
    return make_bench(apa=apa)


@pytest.fixture
def told(capsys):
    """What was printed since the last call, as one line: nassim folds what it prints to the terminal's width."""
    return lambda: " ".join(capsys.readouterr().out.split())


@pytest.fixture
def plain_steps(monkeypatch):
    """Steps of generalized-alpha alone, whose error in periods is not made up for."""
    monkeypatch.setattr(compensation, "FASTEST", 1e-4)


@pytest.fixture(scope="session")
def fmpy():
    """FMPy, which the extra `dev` installs."""
    pytest.importorskip("fmpy.validation", reason="FMPy is not installed: pip install fmpy")
    return pytest.importorskip("fmpy")
