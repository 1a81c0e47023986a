"""Concrete solids and scenes: all numbers of real devices live here.

`apa300ml` is the actuator by finite elements, `two_mass` the same as three springs, `bench` its test bench, whose
figures `bench_figures` compares; `strut` puts it between flexible joints, `nano_hexapod` stands on six struts, with
the geometry of one of the published `hexapods`, and `nass` is the end-station below it, with loops in `nass_loops`.
"""
