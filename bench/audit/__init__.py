"""Audits of published claims: what their data allow, what an efficient estimator scores, where a number falls."""
