"""The site: Markdown pages and their data from stored cells and the files beside their store, built by mkdocs.

:mod:`bench.reporting.page.reading` reads the store, :mod:`bench.reporting.page.situations` says
what is advised; the modules named after a part make that part's data, and
:mod:`bench.reporting.page.site` puts them into the templates beside it. ``static`` holds the site's own scripts and
style, and in two folders the libraries that they use; ``mkdocs.yml`` and ``hooks.py`` what every site has.
"""
