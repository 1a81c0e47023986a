"""Published Stewart platforms.

Source of all values: the Stewart platform model of T. Dehaeze and others (MIT licence), its default set, and its set
for the nano-hexapod with encoders at the struts. Struts 0 and 1 begin near the x axis, the others 120 and 240 degrees
further.
"""

from nassim.kinematics import StewartPlatform

DEFAULT_PLATFORM = StewartPlatform.from_angles(
    height=90e-3,
    base_radius=115e-3,
    base_angles=(-10, 10, 110, 130, 230, 250),
    base_height=15e-3,
    platform_radius=90e-3,
    platform_angles=(-50, 50, 70, 170, 190, -70),
    platform_depth=15e-3,
    point=(0, 0, 45e-3),
)
"""The default set; its point of interest is 45 mm above the underside of the top plate."""

NANO_HEXAPOD = StewartPlatform.from_angles(
    height=95e-3,
    base_radius=114e-3,
    base_angles=(-11, 11, 109, 131, 229, 251),
    base_height=22.5e-3,
    platform_radius=110e-3,
    platform_angles=(-45, 45, 75, 165, 195, -75),
    platform_depth=22.5e-3,
)
"""The nano-hexapod with joint centres 82.5 mm apart; its point of interest is M, on the underside of the top plate."""
