"""Equation-error regressions: least squares, recursive least squares, SINDy and instrumental variables."""
