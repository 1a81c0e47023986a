"""Coordinates, bodies' equations, measures on coordinates, constraints, damping, trimming: a scene's model."""
