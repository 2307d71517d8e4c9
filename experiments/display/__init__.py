"""All that a person sees: the terminal, plots, pictures and pages."""
