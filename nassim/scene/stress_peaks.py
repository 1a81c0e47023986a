"""Largest stress in a motion of bodies or in a record of sensors."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from nassim.base.checks import Array, known
from nassim.base.field_types import ArrayLike
from nassim.base.short_repr import short_repr
from nassim.base.warning_log import warn
from nassim.bodies.readouts import readouts_of
from nassim.bodies.stress import COMPONENTS, StressField, principal_stresses, von_mises
from nassim.scene.bodies import Body, FlexibleBody
from nassim.scene.motion import Motion
from nassim.scene.port_voltages import stressing_voltages
from nassim.scene.scene import Scene
from nassim.scene.stress_sensors import CURE
from nassim.signals.time_history import TimeHistory

VALUES_AT_ONCE = 5_000_000
"""Number of stress components that are held at once."""
LARGE_MESH_ERROR = 0.1
"""Estimated error of the mesh over the stress above which a warning is given."""


@dataclass(frozen=True)
class PeakStress:
    """The largest von Mises stress over points and time.

    Attributes:
        von_mises: von Mises stress [Pa]
        principal: principal stresses there and then, descending, (3,) [Pa]
        stress: components in the order of `nassim.bodies.stress.COMPONENTS`, along the axes of the body, (6,) [Pa]
        time: time [s]
        place: name of the surface, point or sensor
        position: the point in the body's frame, (3,) [m]; None for a record, which does not know it
        mesh_error: estimated error by the finite elements [Pa]; nan for a record
    """

    von_mises: float
    principal: Array
    stress: Array
    time: float
    place: str
    position: Array | None = None
    mesh_error: float = np.nan

    __repr__ = short_repr

    def __str__(self) -> str:
        """Describe the peak in MPa and mm."""
        error = "" if np.isnan(self.mesh_error) else f" (mesh: +-{1e-6 * self.mesh_error:.2g} MPa)"
        principal = ", ".join(f"{1e-6 * s + 0.0:.4g}" for s in self.principal)
        return (
            f"{1e-6 * self.von_mises:.4g} MPa von Mises{error} at {self.place!r}{place_text(self.position)}, "
            f"t = {self.time:.6g} s; principal {principal} MPa"
        )


def peak_stress(
    source: Motion | TimeHistory,
    body: Body | str,
    *,
    place: str | None = None,
    voltages: Mapping[str, ArrayLike] | None = None,
) -> PeakStress:
    """Find the largest von Mises stress: where, when, and its components.

    Args:
        source: a motion, as of `simulate_motion` or `static_motion`, or a record of `simulate`.
        body: for a motion, the scene's flexible body; for a record, the name of a `StressAt` sensor without a
            component.
        place: name of the body's stress surface or point (default: all of them).
        voltages: for a motion, voltages of the body's electrical ports, by name [V]: numbers, or one value per time.
            They stress the stacks themselves. Motions of `simulate_motion` and `static_motion` know those of their
            scene; what is given here takes their place.

    Returns:
        The peak.

    Raises:
        ValueError: for a body that keeps no stress, for unknown names, for a record without the six components, and
            for a motion that does not know the voltage of a port that stresses the body.

    Warns:
        UserWarning: for a peak whose estimated error of the mesh is above a tenth of it.
    """
    if isinstance(source, TimeHistory):
        if not isinstance(body, str):
            raise ValueError("a record has the outputs of sensors only: give the name of a StressAt sensor")
        stress = sensor_stress(source, body)
        k = int(np.argmax(von_mises(stress)))
        return _peak(stress[k], float(source.time[k]), body)
    if not isinstance(body, FlexibleBody):
        raise ValueError("for a motion, give the flexible body of the scene itself, which knows its stress")
    fields = stress_fields(body, place)
    q = source.coordinates[known("flexible body of the motion", body.name, source.coordinates)]
    all_volts = stressing_voltages(body.reduced, fields, voltages, source.voltages.get(body.name, {}))
    volts = {name: np.broadcast_to(value, len(q)) for name, value in all_volts.items()}
    best: PeakStress | None = None
    for field in fields:
        step = max(1, VALUES_AT_ONCE // (6 * len(field.positions)))
        for start in range(0, len(q), step):
            part = slice(start, start + step)
            stress = field.stress(q[part], {name: value[part] for name, value in volts.items()})
            values = von_mises(stress)
            i, j = np.unravel_index(int(np.argmax(values)), values.shape)
            if best is None or values[i, j] > best.von_mises:
                error = float(field.mesh_error(q[start + i])[j])
                best = _peak(stress[i, j], float(source.time[start + i]), field.name, field.positions[j], error)
    assert best is not None
    warn_of_mesh_error(body.name, best.place, best.position, best.von_mises, best.mesh_error)
    return best


def warn_of_mesh_error(body: str, place: str, position: Array | None, stress: float, error: float) -> None:
    """Warn of a peak whose estimated error of the mesh is a large share of it.

    Args:
        body: name of the body.
        place: name of the surface or point.
        position: the point in the body's frame, (3,) [m]; None where it is unknown.
        stress: von Mises stress [Pa].
        error: its estimated error [Pa].
    """
    if error > LARGE_MESH_ERROR * stress:
        warn(
            f"body {body!r}: the largest stress, {1e-6 * stress:.4g} MPa at {place!r}{place_text(position)}, is "
            f"uncertain by some {100 * error / stress:.2g} % because of the mesh: give smaller elements there "
            "(local_sizes) or a higher order; stress_convergence tells whether it is a sharp edge, where no mesh is "
            "fine enough"
        )


def place_text(position: Array | None) -> str:
    """Return a position in millimetres for a text, with a space before it; '' for None."""
    return "" if position is None else f" ({', '.join(f'{round(1e3 * x, 6) + 0.0:.4g}' for x in position)}) mm"


def stress_fields(body: FlexibleBody, place: str | None) -> tuple[StressField, ...]:
    """Return the stress that a body keeps: at all places, or at one.

    Raises:
        ValueError: for a body that keeps none or does not deform, and for an unknown place.
    """
    fields = {field.name: field for field in readouts_of(body.reduced.readouts, StressField) if len(field.positions)}
    if not fields:
        raise ValueError(f"body {body.name!r} keeps no stress: {CURE}")
    if not body.deforms:
        raise ValueError(
            f"body {body.name!r} has the fidelity {body.fidelity!r}, so it does not deform and has no stress: take "
            '"linear" or "ffrf"'
        )
    return tuple(fields.values()) if place is None else (fields[known(f"stress of body {body.name!r}", place, fields)],)


def stressed_body(scene: Scene, name: str) -> FlexibleBody:
    """Return a flexible body of a scene by its name.

    Raises:
        ValueError: for an unknown name and for a rigid body.
    """
    body = scene.body(name)
    if not isinstance(body, FlexibleBody):
        raise ValueError(f"body {name!r} is rigid, so it has no stress")
    return body


def sensor_stress(record: TimeHistory, sensor: str) -> Array:
    """Return the stress that a `StressAt` sensor recorded, (n_samples, 6) [Pa].

    Raises:
        ValueError: for a record without its six components.
    """
    return np.column_stack([record[known("output", f"{sensor}.{name}", record.names)] for name in COMPONENTS])


def _peak(stress: Array, time: float, place: str, position: Array | None = None, error: float = np.nan) -> PeakStress:
    return PeakStress(float(von_mises(stress)), principal_stresses(stress), stress, time, place, position, error)
