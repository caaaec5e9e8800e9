"""State and parameters together, by Kalman filters and smoothers."""
