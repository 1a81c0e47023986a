"""Exudyn's side of a simulation: `system` from bodies, `items` from words, `state` while it lives, `solver` to run it.

A scene in small motion has one system for all, in `modal`. In large motion `springs` connect, `readings` and `tensions`
read, `filtering` passes on what sensors let through, `watch` looks at runs, and `turning` finds the start of what turns
at constant speed. To realise a new word in large motion, open `items`.
"""
