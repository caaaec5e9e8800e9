"""From a command line and YAML files to validated cells."""
