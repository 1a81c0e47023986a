"""Exudyn's side of a simulation: `system` from bodies, `items` from words, `state` while it lives, `solver` to run it.

To realise a new word in large motion, open `items`.
"""
