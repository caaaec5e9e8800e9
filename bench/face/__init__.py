"""The benchmark from Python: ``bench.run``, ``bench.identify``, ``bench.experiment``; as on the command line."""
