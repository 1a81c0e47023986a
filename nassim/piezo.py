"""Piezoelectric stacks, described by their data sheet."""

from dataclasses import dataclass, fields

from nassim.checks import freeze, positive


@dataclass(frozen=True)
class PiezoStack:
    """A multilayer piezo stack as its data sheet gives it.

    free_stroke: elongation without load over the whole voltage range [m]
    blocked_force: force at zero elongation over the whole voltage range [N]
    voltage_range: range that stroke and force refer to [V]
    stiffness: mechanical stiffness [N/m]
    capacitance: capacitance of the unloaded stack [F]
    length, area: length [m] and cross-section [m2] of the ceramic

    Sign convention: a positive voltage lengthens the stack, forces are positive in tension.
    """

    free_stroke: float
    blocked_force: float
    voltage_range: float
    stiffness: float
    capacitance: float
    length: float
    area: float

    def __post_init__(self) -> None:
        freeze(self, **{f.name: positive(f"piezo stack: {f.name}", getattr(self, f.name)) for f in fields(self)})

    @property
    def force_per_volt(self) -> float:
        """Actuator constant g_a: blocked force per volt [N/V].

        A stack obeys F = k (dl - d V) with d = free_stroke / voltage_range [m/V]. Held at dl = 0 it
        pushes outwards with g_a V, g_a = k d = blocked_force / voltage_range. Stacks of one kind that
        stand in line and share one voltage act on the ends of the line with the same g_a V.
        """
        return self.blocked_force / self.voltage_range

    @property
    def voltage_per_elongation(self) -> float:
        """Sensor constant g_s of the open-circuit stack [V/m]; the sensor's voltage is -g_s dl.

        The charge is Q = d F + C V with C the capacitance of the unloaded stack. Open circuit (Q = 0)
        gives V = -d F / C, so compression (F < 0) gives a positive voltage. With F = k dl, where k is the
        stiffness of the open-circuit stack, g_s = d k / C = g_a / C: the figure that d33 / (eps_T s_D n)
        [V/m] of the piezo literature also expresses. A data sheet does not say whether its stiffness is
        that of the open or of the shorted stack, so expect an uncertainty of some 20 %.
        """
        return self.force_per_volt / self.capacitance
