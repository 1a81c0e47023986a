"""What several scripts share: arguments, reports, costs, machines and pictures."""
