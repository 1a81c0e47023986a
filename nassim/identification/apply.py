"""Correction of a scene by identified modes: damping ratios, and factors of actuators and sensors."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TypeVar

import numpy as np

from nassim.base.checks import Array, finite, freeze, known, not_negative, positive
from nassim.base.short_repr import short_repr
from nassim.base.tables import with_deviation
from nassim.base.warning_log import warn
from nassim.identification.modal_fit import ModalFit
from nassim.scene.part import Actuator, Sensor
from nassim.scene.scene import Scene
from nassim.scene.terms import AppliedForce, Output, SpringForce
from nassim.simulation.model.assembly import Assembly, assemble
from nassim.simulation.model.modal_model import ModalModel

Kind = TypeVar("Kind", Actuator, Sensor)

VISIBLE = 1e-4
"""Smallest gain of a visible mode, relative to the largest gain of any mode at the same output."""

CANCELLING = 0.05
"""Static response over the sum of the sizes of its modes' gains, up to which it gives no factor."""

SIGNIFICANT = 3.0
"""Standard deviations from 1 above which a factor that no part takes is worth a warning."""


@dataclass(frozen=True)
class Change:
    """Change of one parameter of a scene.

    Attributes:
        parameter: name of the parameter.
        before: value before the change.
        after: value after the change.
        std: standard deviation of `after`.
    """

    parameter: str
    before: float
    after: float
    std: float
    __repr__ = short_repr


@dataclass(frozen=True)
class UpdateReport:
    """Report of `apply_identification`: changes of a scene, and identified modes without a counterpart.

    Attributes:
        changes: changes of damping ratios, then of factors of parts.
        matches: index of the mode of the scene for each identified mode, (modes,); -1 where the scene has none.
        identified: frequencies of the identified modes, (modes,) [Hz].
        scene: frequencies of the matched modes of the scene, (modes,); 0 where the scene has none [Hz].
        unmeasured: damping ratios of all other modes of the scene, by name [-].
        static_ratio: identified static response over that of the scene before the update, each of the modes in the
            band, (outputs,); nan where the gains of modes cancel [-].
        unwritten: factors of parts that have no field for one, such as a point force or an encoder, and their standard
            deviations, by the signals' names: the scene still lacks them [-].
    """

    changes: tuple[Change, ...]
    matches: Array
    identified: Array
    scene: Array
    unmeasured: Mapping[str, float]
    static_ratio: Array
    unwritten: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    __repr__ = short_repr

    def __post_init__(self) -> None:
        freeze(self, unmeasured=self.unmeasured, unwritten=self.unwritten)

    @property
    def unmodelled(self) -> Array:
        """Frequencies of identified resonances without a mode of the scene [Hz]."""
        return self.identified[self.matches < 0]

    def __str__(self) -> str:
        """Return the summary."""
        return self.summary()

    def summary(self) -> str:
        """Return the report as text."""
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
            lines.append(f"{change.parameter}: {change.before:.5g} -> {with_deviation(change.after, change.std)}")
        for name, (factor, std) in self.unwritten.items():
            lines.append(f"factor of {name}: {with_deviation(factor, std)}, not written, its part has no factor")
        if self.unmeasured:
            ratios = sorted(set(self.unmeasured.values()))
            text = ", ".join(f"{100 * ratio:.3g}" for ratio in ratios)
            lines.append(f"damping ratio of the {len(self.unmeasured)} other modes, not measured: {text} %")
        return "\n".join(lines)


def modal_gains(assembly: Assembly) -> Array:
    """Compute the contribution of each mode to the static response.

    Args:
        assembly: the assembled scene.

    Returns:
        Gains, (outputs, inputs, modes) [output unit over V]; 0 for rigid-body modes.
    """
    modal, signals = assembly.modal, assembly.signals
    modes, omega = modal.modes, 2 * np.pi * modal.frequency
    compliance = np.zeros(len(omega))
    flexible = ~modal.rigid_modes
    compliance[flexible] = 1 / omega[flexible] ** 2
    readings, drives = signals.output_matrix @ modes, signals.forces_at_rest.T @ modes
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
    """Write identified damping ratios and gains into a scene.

    The static response is the sum of all modal gains in the band, including those of unmodelled resonances. Masses,
    also unknown ones, shift frequencies and change the distribution of this sum over the modes, but not the sum. Masses
    and stiffnesses of the scene do not change.

    Args:
        scene: the scene.
        fit: identified modes.
        trusted: output whose sensor counts as right, such as an encoder. The ratio of its identified static response to
            that of the scene is the factor of the actuators at the input of the fit. The same ratio of another output,
            divided by this factor, is the factor of its sensor.
        distance: largest relative difference in frequency between an identified mode and a mode of the scene [-].
        factor: largest ratio of their gains, in either direction. The gains must have the same sign. They are compared
            at the trusted output, or at the output with the largest gain where the mode is not visible there. This rule
            rejects nearby resonances of cables or of the table [-].
        unmeasured_damping_ratio: damping ratio of the other modes of the scene (default: unchanged) [-].

    Returns:
        The corrected scene, and a report of the changes.

    Warns:
        UserWarning: where a factor differs from 1 by more than three standard deviations and a part has no field for
            it: what acts at the input, or the sensor of an output. For outputs at which the gains of modes nearly
            cancel, as those of a force sensor in a branch that carries no static force: they give no factor.

    Raises:
        ValueError: for unknown names, for outputs of the scene that do not respond to the input, for scenes with
            non-modal damping (bodies' own damping, dampers, resistances, bandwidths, loops), when no mode matches (the
            message names a reversed polarity), when a match is not unique (two visible modes of the scene near one
            identified mode, or two identified modes near one), and where the gains of modes nearly cancel at the
            trusted output.
    """
    positive("distance", distance)
    if not finite("factor", factor) > 1:
        raise ValueError(f"factor must be above 1, got {factor:g}: gains never agree exactly")
    known("trusted output", trusted, fit.outputs)
    modal, gains = _modes_of(scene, fit)
    base = fit.outputs.index(trusted)
    alike, opposite = (_alike(sign * fit.gains, gains, base, factor) for sign in (1, -1))
    matches = _match(fit.frequency, modal.frequency, alike, distance)
    found = matches >= 0
    if not found.any():
        raise ValueError(_no_match(fit.frequency, modal.frequency, alike, opposite, distance, factor))
    modes, before = matches[found], modal.damping.ratio
    ratios = before.copy()
    if unmeasured_damping_ratio is not None:
        ratios[:] = not_negative("unmeasured_damping_ratio", unmeasured_damping_ratio)
    ratios[modes] = fit.damping_ratio[found]
    n_free = np.count_nonzero(modal.rigid_modes)  # a scene counts its elastic modes only
    changes = [
        Change(f"damping ratio of mode {mode + 1 - n_free}", float(before[mode]), float(ratios[mode]), float(std))
        for mode, std in zip(modes, fit.damping_ratio_std[found], strict=True)
    ]
    within = (modal.frequency >= fit.recorded.frequency[0]) & (modal.frequency <= fit.recorded.frequency[-1])
    within[modes] = True
    identified = _static_responses("identified", fit.outputs, fit.gains, trusted)
    static_ratio = identified / _static_responses("scene's", fit.outputs, gains[:, within], trusted)
    scaled, factors, unwritten = _scale(scene, fit, static_ratio, base)
    report = UpdateReport(
        changes=(*changes, *factors),
        matches=matches,
        identified=fit.frequency,
        scene=np.where(found, modal.frequency[matches], 0.0),
        unmeasured={f"mode {k + 1 - n_free}": float(ratios[k]) for k in range(n_free, len(ratios)) if k not in modes},
        static_ratio=static_ratio,
        unwritten=unwritten,
    )
    _warn_of_unwritten(unwritten)
    return replace(scaled, damping_ratio=ratios[n_free:]), report


def _static_responses(whose: str, outputs: Sequence[str], gains: Array, trusted: str) -> Array:
    """Return the static responses of outputs, (outputs,), from the gains of their modes, (outputs, modes).

    A response is nan, with a warning, where gains nearly cancel: it then follows from errors of the modes, and of
    others.

    Raises:
        ValueError: for such gains at the trusted output.
    """
    responses, sizes = gains.sum(axis=1), np.abs(gains).sum(axis=1)
    for row in np.flatnonzero(np.abs(responses) <= CANCELLING * sizes).tolist():
        text = (
            f"the gains of the {whose} modes at output {outputs[row]!r} cancel, their sum is {responses[row]:.2g} of "
            f"{sizes[row]:.2g}, so its static response gives no factor"
        )
        if outputs[row] == trusted:
            raise ValueError(f"{text}: trust another output, or widen the band")
        warn(f"{text}, and that of its sensor stays as it is")
        responses[row] = np.nan
    return responses


def _warn_of_unwritten(factors: Mapping[str, tuple[float, float]]) -> None:
    """Warn of factors with their standard deviations, by name, for which parts have no field, where they matter."""
    lacking = [f"{name!r} {f:.4g}" for name, (f, std) in factors.items() if abs(f - 1) > SIGNIFICANT * std]
    if lacking:
        warn(
            f"factors of parts that have no field for one are not written into the scene: {', '.join(lacking)}; scale "
            "these signals of the record, or of the model"
        )


def _modes_of(scene: Scene, fit: ModalFit) -> tuple[ModalModel, Array]:
    """Return the modes of a scene, and their gains from the input of a fit to its outputs, (outputs, modes).

    Raises:
        ValueError: for unknown names, non-modal damping, and outputs that do not respond.
    """
    known("input", fit.input, scene.inputs)
    for output in fit.outputs:
        known("output", output, scene.outputs)
    if not scene.loops:
        scene = replace(scene, sensors=[sensor for sensor in scene.sensors if _gives(scene, sensor, fit.outputs)])
    assembly = assemble(scene)
    if not assembly.modes_uncoupled or scene.loops:
        raise ValueError(
            "damping ratios are written into a scene whose damping is all modal: take out bodies' own damping_ratio, "
            "dampers, resistances at ports, voice coils, bandwidths of amplifiers and sensors, loops and drives that "
            "follow inputs; outputs of the fit must be displacements, forces or voltages"
        )
    rows = [scene.outputs.index(output) for output in fit.outputs]
    gains = modal_gains(assembly)[rows, scene.inputs.index(fit.input)]
    for output, row in zip(fit.outputs, gains, strict=True):
        if not np.any(row):
            raise ValueError(f"output {output!r} of the scene does not respond to {fit.input!r}: leave it out")
    return assembly.modal, gains


def _gives(scene: Scene, sensor: Sensor, outputs: Collection[str]) -> bool:
    """Return whether a sensor gives one of the outputs, or none of its own, such as a part that adds to others'."""
    given = {term.name for term in sensor.terms(scene) if isinstance(term, (Output, SpringForce))}
    return not given or not given.isdisjoint(outputs)


def _alike(identified: Array, gains: Array, base: int, factor: float) -> Array:
    """Return whether the gains of an identified mode and of a mode of the scene agree, (identified, modes).

    identified: (outputs, identified); gains: (outputs, modes); base: row of the trusted output
    """
    share = np.abs(gains) / np.abs(gains).max(axis=1, keepdims=True)
    visible = share > VISIBLE
    row = np.where(visible[base], base, share.argmax(axis=0))
    columns = np.arange(gains.shape[1])
    size = np.abs(gains[row, columns])
    found = identified[row].T * np.sign(gains[row, columns])
    return visible.any(axis=0) & (found <= factor * size) & (size <= factor * found)


def _match(identified: Array, frequency: Array, alike: Array, distance: float) -> Array:
    """Return the index of the scene's mode for each identified mode, -1 for none; alike: (identified, modes)."""
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
    """Explain why no mode matches; alike, opposite: agreement of gains and of negative gains, (identified, modes)."""
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


def _scale(
    scene: Scene, fit: ModalFit, ratio: Array, base: int
) -> tuple[Scene, list[Change], dict[str, tuple[float, float]]]:
    """Scale actuators and sensors by the ratio of the fit's static responses to those of the scene, (outputs,).

    base: row of the trusted output

    Return the scene, the changes, and the factors that parts do not take, by signal.
    """
    n_outputs, n_modes = fit.gains.shape
    sums = np.where(np.isfinite(ratio), fit.gains.sum(axis=1), 1.0)
    summing = np.kron(np.eye(n_outputs), np.ones(n_modes)) / sums[:, None]
    covariance = summing @ fit.covariance[2 * n_modes :, 2 * n_modes :] @ summing.T  # of relative errors
    actuator = _with_std(ratio[base], covariance[base, base])
    acting = [part for part in scene.actuators if _acts_by(scene, part, fit.input)]
    drives = {part.name: actuator for part in acting}
    factors = {}
    for row, output in enumerate(fit.outputs):
        if row != base and np.isfinite(ratio[row]):
            variance = covariance[row, row] + covariance[base, base] - 2 * covariance[row, base]
            factors[output] = _with_std(ratio[row] / ratio[base], variance)
    changes: list[Change] = []
    actuators = tuple(_scaled(part, drives, changes) for part in scene.actuators)
    sensors = tuple(_scaled(part, factors, changes) for part in scene.sensors)
    takers = {part.name for part in scene.sensors if part.factor is not None}
    unwritten = {name: factor for name, factor in factors.items() if name not in takers}
    if not acting or any(part.factor is None for part in acting):
        unwritten = {fit.input: actuator, **unwritten}
    return replace(scene, actuators=actuators, sensors=sensors), changes, unwritten


def _with_std(factor: float, variance: float) -> tuple[float, float]:
    """Return a factor and its standard deviation from the variance of its relative error."""
    return float(factor), float(abs(factor) * np.sqrt(variance))


def _acts_by(scene: Scene, part: Actuator, name: str) -> bool:
    return any(isinstance(term, AppliedForce) and term.input == name for term in part.terms(scene))


def _scaled(part: Kind, factors: Mapping[str, tuple[float, float]], changes: list[Change]) -> Kind:
    """Return a part with its corrected factor, and append the change to `changes`; parts without a factor stay."""
    if part.name not in factors or part.factor is None:
        return part
    factor, std = factors[part.name]
    before = getattr(part, part.factor)
    changes.append(Change(f"{part.name}.{part.factor}", before, before * factor, abs(before * std)))
    return replace(part, **{part.factor: before * factor})
