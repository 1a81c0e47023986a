"""Linear models: linearisation, exact steps, sampled closed loops."""
