"""The online track: parameters that change, samples one by one, the bound along the path, and how trackers score."""
