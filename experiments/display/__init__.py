"""Everything that a person sees: the terminal, plots, pictures and pages. Nothing here imports other experiments."""
