"""States that bear loads: geometric stiffness, spin, rotor and stator."""
