"""The commands, one module a verb: ``python -m bench.<verb>``, and ``python -m bench`` in
:mod:`bench.commands.main`."""
