"""One controller on a family of plants: machines with several payloads, at several speeds."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from nassim.base.checks import freeze
from nassim.base.field_types import ArrayLike
from nassim.base.short_repr import short_repr
from nassim.systems.controllers import Controller
from nassim.systems.feedback import close_loop, loop_at_a_time, loop_response
from nassim.systems.linear_model import (
    LinearModel,
    Names,
    UnstablePole,
    frequency_response,
    names,
    sampled,
    unstable_poles,
)
from nassim.systems.noise_budgets import band_of, near_poles
from nassim.systems.stability_margins import Margins, margins


@dataclass(frozen=True)
class FamilyMargins:
    """Margins of every loop on every plant of a family.

    Attributes:
        margins: margins by plant and measured signal, each with the other loops closed, of the plants on which the
            loops are stable: where the others are unstable, a loop has no margin.
        unstable: fastest growing motion of the closed loops by plant, for the plants on which they are unstable.
    """

    margins: Mapping[str, Mapping[str, Margins]]
    unstable: Mapping[str, UnstablePole]
    __repr__ = short_repr

    def __post_init__(self) -> None:
        freeze(self, margins=self.margins, unstable=self.unstable)

    @property
    def stable(self) -> bool:
        """Whether the loops are stable on all plants."""
        return not self.unstable

    @property
    def worst(self) -> Mapping[str, tuple[str, Margins]]:
        """Plant with the least modulus margin and its margins, by measured signal, of the plants with stable loops."""
        signals = next(iter(self.margins.values()), {})
        worst = {name: min(self.margins, key=lambda case: self.margins[case][name].modulus_margin) for name in signals}
        return {name: (case, self.margins[case][name]) for name, case in worst.items()}

    def __str__(self) -> str:
        """Return a table of the worst margins of each loop, and the plants on which the loops are unstable."""
        lines = [f"{'loop':<20} {'worst plant':<20} {'gain [-]':>9} {'phase [deg]':>12} {'modulus [-]':>12}"]
        for name, (case, m) in self.worst.items():
            lines.append(
                f"{name:<20} {case:<20} {m.gain_margin:>9.3g} {m.phase_margin:>12.3g} {m.modulus_margin:>12.3g}"
            )
        lines += [f"unstable on {case!r}: {pole}" for case, pole in self.unstable.items()]
        return "\n".join(lines)


def family_margins(
    plants: Mapping[str, LinearModel],
    controller: Controller | Mapping[str, Controller],
    frequency: ArrayLike,
    *,
    measured: Names,
    driven: Names,
    gain: float = 1.0,
) -> FamilyMargins:
    """Compute the margins of loops on each plant of a family on which they are stable, at the controller's sample rate.

    Args:
        plants: continuous models by name.
        controller: controller of all plants, or one for each plant by name (a schedule).
        frequency: frequencies of the margins, up to half the sample rate, (n,) [Hz]; see `margins`. Points are
            added where these are too coarse for resonances of the plants and of the closed loops.
        measured: see `close_loop`.
        driven: see `close_loop`.
        gain: see `close_loop`.

    Raises:
        ValueError: without a plant, for a schedule without a controller for a plant, and for frequencies that do not
            ascend or go beyond half the sample rate.
    """
    if not plants:
        raise ValueError("give at least one plant")
    schedule = controller if isinstance(controller, Mapping) else dict.fromkeys(plants, controller)
    if gaps := [name for name in plants if name not in schedule]:
        raise ValueError(
            f"the schedule has no controller for {', '.join(map(repr, gaps))}; it has {', '.join(schedule)}"
        )
    found, unstable = {}, {}
    for case, plant in plants.items():
        own = schedule[case]
        model = sampled(plant, own.sample_rate)
        given = band_of(frequency, model.time_step)
        closed = close_loop(model, own, measured=measured, driven=driven, gain=gain)
        if growing := unstable_poles(closed):
            unstable[case] = growing[0]
            continue
        response = frequency_response(model, near_poles(np.concatenate([model.poles(), closed.poles()]), given))
        loop = loop_response(response, own, measured=measured, driven=driven, gain=gain, hold=False)
        found[case] = {name: margins(loop_at_a_time(loop, name)) for name in names("measured signal", measured)}
    return FamilyMargins(found, unstable)
