"""Constraint solving that differs from MJX's own, for speed."""
