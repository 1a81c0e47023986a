"""The model of a scene: coordinates, bodies' equations, measures on coordinates, constraints, damping, trimming."""
