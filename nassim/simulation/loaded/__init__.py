"""Loaded states of a scene: geometric stiffness, spin, rotor and stator."""
