"""Equation-error regressions: derivatives of samples, the regression, its bootstrap; LS, RLS, SINDy."""
