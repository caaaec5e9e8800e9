"""Configuration: command lines and YAML files are composed and validated into cells."""
