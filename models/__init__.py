"""Concrete solids and scenes: all numbers of real devices live here."""
