"""Design of vibration tests: expected accuracy of a test, and the smallest test for a required accuracy."""
