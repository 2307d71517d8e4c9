"""Physics that differs from MJX's, for speed: contacts and joint limits, linear systems, and loops without scatters."""
