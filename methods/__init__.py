"""The methods: one identifier a file, each registered by an entry point in the group ``bench.methods``."""
