"""Joint estimation of state and parameters by Kalman filters and smoothers."""
