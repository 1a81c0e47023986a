"""Runs in time: checks before, stepping, warnings after."""
