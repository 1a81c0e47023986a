"""Functions that several scripts use: arguments, reports, costs, machines and pictures."""
