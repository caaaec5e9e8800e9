"""The commands, one module per verb; :mod:`bench.commands.main` reads the command line."""
