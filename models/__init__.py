"""Concrete parts and scenes: all numbers of real devices live here."""
