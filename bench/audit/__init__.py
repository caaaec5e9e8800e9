"""Audits of published claims: the bound of their data, the errors of an efficient estimator, and the comparison."""
