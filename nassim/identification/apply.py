"""Identified modes written into a scene: damping ratios, and factors of its actuators and sensors."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from nassim.base.checks import Array, finite, freeze, frozen_mapping, known, not_negative, positive
from nassim.identification.modal_fit import ModalFit
from nassim.scene.part import Actuator, Sensor
from nassim.scene.scene import Scene
from nassim.scene.terms import AppliedForce, BaseAcceleration
from nassim.simulation.model.assembly import Assembly, assemble

Kind = TypeVar("Kind", Actuator, Sensor)

VISIBLE = 1e-4
"""Least share of an output's static response, over the largest of its modes, that makes a mode of a scene visible."""


@dataclass(frozen=True)
class Change:
    """One parameter of a scene before and after; std: standard deviation of `after`."""

    parameter: str
    before: float
    after: float
    std: float


@dataclass(frozen=True)
class UpdateReport:
    """What `apply_identification` changed in a scene, and what it could not.

    changes: damping ratios of modes, then factors of parts
    matches: per identified mode the index of the scene's mode, (modes,), or -1 where the scene has none
    identified: frequencies of the identified modes, (modes,) [Hz]; scene: of those matched to them, 0 where none is
    unmeasured: damping ratio of all other modes of the scene [-]
    static_ratio: identified static response over the scene's before, each by the modes in the band, (outputs,)
    """

    changes: tuple[Change, ...]
    matches: Array
    identified: Array
    scene: Array
    unmeasured: Mapping[str, float]
    static_ratio: Array

    def __post_init__(self) -> None:
        freeze(self, unmeasured=frozen_mapping(self.unmeasured))

    @property
    def unmodelled(self) -> Array:
        """Frequencies of identified resonances that the scene has no mode for [Hz]."""
        result: Array = self.identified[self.matches < 0]
        return result

    def summary(self) -> str:
        """The report as text."""
        lines = []
        for k, (identified, scene) in enumerate(zip(self.identified, self.scene, strict=True)):
            if self.matches[k] < 0:
                lines.append(f"{identified:.3f} Hz: not modelled, the scene has no mode of about its gain near it")
            else:
                off = 100 * (identified / scene - 1)
                lines.append(
                    f"{identified:.3f} Hz: mode {self.matches[k] + 1:.0f} of the scene, {scene:.3f} Hz ({off:+.2f} %)"
                )
        for change in self.changes:
            lines.append(f"{change.parameter}: {change.before:.5g} -> {change.after:.5g} ± {change.std:.1g}")
        if self.unmeasured:
            ratios = sorted(set(self.unmeasured.values()))
            text = ", ".join(f"{100 * ratio:.3g}" for ratio in ratios)
            lines.append(f"damping ratio of the {len(self.unmeasured)} other modes, not measured: {text} %")
        return "\n".join(lines)


def modal_gains(assembly: Assembly) -> Array:
    """Each mode's share of the static response, (outputs, inputs, modes), output units over V; 0 for rigid motion."""
    modes = assembly.basis @ assembly.shapes
    omega = 2 * np.pi * assembly.frequency
    compliance = np.zeros(len(omega))
    flexible = ~assembly.rigid_modes
    compliance[flexible] = 1 / omega[flexible] ** 2
    readings, drives = assembly.output_matrix @ modes, assembly.input_matrix.T @ modes
    return np.einsum("or,ir,r->oir", readings, drives, compliance)


def apply_identification(
    scene: Scene,
    fit: ModalFit,
    *,
    trusted: str,
    distance: float = 0.1,
    factor: float = 5.0,
    unmeasured_damping_ratio: float | None = None,
) -> tuple[Scene, UpdateReport]:
    """Write identified damping ratios and gains into a scene; returns the new scene and what was changed.

    trusted: output whose sensor is taken as right, such as an encoder. Its identified static response over the scene's
        is the factor of the actuators at the fit's input; that ratio of another output, over this factor, is the
        factor of its sensor
    distance: relative difference in frequency up to which an identified mode is one of the scene's
    factor: largest ratio, either way, of their gains, which have the same sign: at the trusted output or, where the
        mode does not show there, at the output where it shows most. So a resonance of cables or of the table close by
        is not taken for the mode
    unmeasured_damping_ratio: of the scene's other modes (default: as they are)

    Static response is the sum of all modal gains in the band, unmodelled resonances included: masses, even unknown
    ones, shift frequencies and divide that sum among the modes, but do not change it. Masses and stiffnesses of the
    scene stay as they are.

    Raises ValueError for unknown names, for outputs of the scene that do not respond to the input, for scenes with
    damping that is not modal (bodies' own, dampers, resistances, bandwidths, loops), when no mode matches (a reversed
    polarity is named), and when a match is not unique: two modes of the scene that the outputs see near one identified,
    or two identified near one.
    """
    positive("distance", distance)
    if not finite("factor", factor) > 1:
        raise ValueError(f"factor must be above 1, got {factor:g}: gains never agree exactly")
    known("input", fit.input, scene.inputs)
    for output in fit.outputs:
        known("output", output, scene.outputs)
    known("trusted output", trusted, fit.outputs)
    assembly = assemble(scene)
    if not assembly.modes_uncoupled or scene.loops:
        raise ValueError(
            "damping ratios are written into a scene whose damping is all modal: take out bodies' own damping_ratio, "
            "dampers, resistances at ports, amplifiers' bandwidths, loops and drives that follow inputs"
        )
    rows = [scene.outputs.index(output) for output in fit.outputs]
    gains = modal_gains(assembly)[rows, scene.inputs.index(fit.input)]
    for output, row in zip(fit.outputs, gains, strict=True):
        if not np.any(row):
            raise ValueError(f"output {output!r} of the scene does not respond to {fit.input!r}: leave it out")
    visible = np.abs(gains) > VISIBLE * np.abs(gains).max(axis=1, keepdims=True)
    alike = _alike(fit.gains, gains, visible, fit.outputs.index(trusted), factor)
    matches = _match(fit.frequency, assembly.frequency, alike, distance, factor)
    if np.all(matches < 0):
        opposite = _alike(-fit.gains, gains, visible, fit.outputs.index(trusted), factor)
        raise ValueError(_no_match(fit.frequency, assembly.frequency, alike, opposite, distance, factor))

    n_free = np.count_nonzero(assembly.rigid_modes)  # a scene counts its elastic modes only
    ratios = assembly.damping.ratio.copy()
    if unmeasured_damping_ratio is not None:
        ratios[:] = not_negative("unmeasured_damping_ratio", unmeasured_damping_ratio)
    changes = []
    for k, mode in enumerate(matches):
        if mode >= 0:
            ratios[mode], std = fit.damping_ratio[k], fit.damping_ratio_std[k]
            name = f"damping ratio of mode {mode + 1 - n_free}"
            changes.append(Change(name, float(assembly.damping.ratio[mode]), float(ratios[mode]), float(std)))
    within = (assembly.frequency >= fit.recorded.frequency[0]) & (assembly.frequency <= fit.recorded.frequency[-1])
    within[matches[matches >= 0]] = True
    static = gains[:, within].sum(axis=1)
    scaled, factors = _scale(scene, fit, static, trusted)
    unmeasured = {f"mode {k + 1 - n_free}": float(r) for k, r in enumerate(ratios) if k not in matches and k >= n_free}
    found = np.where(matches >= 0, assembly.frequency[matches], 0.0)
    report = UpdateReport(
        changes=(*changes, *factors),
        matches=matches,
        identified=fit.frequency,
        scene=found,
        unmeasured=unmeasured,
        static_ratio=fit.gains.sum(axis=1) / static,
    )
    return replace(scaled, damping_ratio=ratios[n_free:]), report


def _alike(identified: Array, gains: Array, visible: Array, base: int, factor: float) -> Array:
    """Whether an identified mode may be a mode of the scene by its gain, (identified, modes).

    identified: (outputs, identified); gains, visible: (outputs, modes); base: row of the trusted output
    """
    share = np.abs(gains) / np.abs(gains).max(axis=1, keepdims=True)
    row = np.where(visible[base], base, share.argmax(axis=0))
    columns = np.arange(gains.shape[1])
    size = np.abs(gains[row, columns])
    found = identified[row].T * np.sign(gains[row, columns])
    result: Array = visible.any(axis=0) & (found <= factor * size) & (size <= factor * found)
    return result


def _match(identified: Array, frequency: Array, alike: Array, distance: float, factor: float) -> Array:
    """Index of each identified mode among the scene's, -1 for none; alike: (identified, modes)."""
    result = np.full(len(identified), -1)
    for k, f in enumerate(identified):
        near = np.flatnonzero(alike[k] & (np.abs(frequency / f - 1) <= distance))
        if len(near) > 1:
            modes = ", ".join(f"{x:.4g}" for x in frequency[near])
            raise ValueError(
                f"{f:.4g} Hz may be any of the scene's modes at {modes} Hz, all within {100 * distance:g} %: lessen "
                "the distance, or bring the scene's masses closer to the real ones"
            )
        if len(near):
            result[k] = near[0]
    for mode in set(result[result >= 0]):
        rivals = identified[result == mode]
        if len(rivals) > 1:
            raise ValueError(
                f"identified modes at {', '.join(f'{x:.4g}' for x in rivals)} Hz are all within {100 * distance:g} % "
                f"of the scene's mode at {frequency[mode]:.4g} Hz: lessen the distance"
            )
    return result


def _no_match(
    identified: Array, frequency: Array, alike: Array, opposite: Array, distance: float, factor: float
) -> str:
    """Why no mode matches; alike, opposite: by gain and by gain of the other sign, (identified, modes)."""
    found = ", ".join(f"{x:.4g}" for x in identified)
    seen = ", ".join(f"{x:.4g}" for x in frequency[alike.any(axis=0)][:5])
    near = np.abs(frequency / identified[:, None] - 1) <= distance
    reversed_ones = ", ".join(f"{x:.4g}" for x in frequency[(opposite & near).any(axis=0)][:5])
    text = (
        f"no identified mode ({found} Hz) lies within {100 * distance:g} % of a mode that the scene's outputs see "
        f"with a gain within {factor:g} times its own ({seen or 'none'} Hz): "
    )
    if reversed_ones:
        return text + (
            f"that of the scene at {reversed_ones} Hz has the opposite sign: correct the polarity of the actuator or "
            "of the sensor, in the record or in the scene"
        )
    return text + "check units, the scene's masses, or give a larger distance or factor"


def _scale(scene: Scene, fit: ModalFit, static: Array, trusted: str) -> tuple[Scene, list[Change]]:
    """Scale actuators and sensors by the fit's static responses over the scene's, (outputs,)."""
    n_outputs, n_modes = fit.gains.shape
    base = fit.outputs.index(trusted)
    identified = fit.gains.sum(axis=1)
    ratio = identified / static
    summing = np.kron(np.eye(n_outputs), np.ones(n_modes)) / identified[:, None]
    covariance = summing @ fit.covariance[2 * n_modes :, 2 * n_modes :] @ summing.T
    actuator = float(ratio[base]), float(np.sqrt(covariance[base, base]))
    drives = {part.name: actuator for part in scene.actuators if _acts_by(scene, part, fit.input)}
    factors = {}
    for row, output in enumerate(fit.outputs):
        if row != base:
            variance = covariance[row, row] + covariance[base, base] - 2 * covariance[row, base]
            factors[output] = float(ratio[row] / ratio[base]), float(np.sqrt(variance))
    changes: list[Change] = []
    actuators = tuple(_scaled(part, drives, changes) for part in scene.actuators)
    sensors = tuple(_scaled(part, factors, changes) for part in scene.sensors)
    return replace(scene, actuators=actuators, sensors=sensors), changes


def _acts_by(scene: Scene, part: Actuator, name: str) -> bool:
    return any(isinstance(term, (AppliedForce, BaseAcceleration)) and term.input == name for term in part.terms(scene))


def _scaled(part: Kind, factors: Mapping[str, tuple[float, float]], changes: list[Change]) -> Kind:
    """A part with its factor corrected, which is noted in `changes`; parts that have none are trusted."""
    if part.name not in factors or part.factor is None:
        return part
    factor, std = factors[part.name]
    before = getattr(part, part.factor)
    changes.append(Change(f"{part.name}.{part.factor}", before, before * factor, abs(before * factor * std)))
    return replace(part, **{part.factor: before * factor})
