"""The site of results: Markdown pages and their data from stored cells, tables and figures, built by mkdocs.

:mod:`bench.reporting.page.reading` reads the store, :mod:`bench.reporting.page.situations` ranks the methods of each
situation, and :mod:`bench.reporting.page.site` fills in the templates. ``static`` has scripts, style and the libraries
that they use; ``mkdocs.yml`` and ``hooks.py`` configure every site.
"""
