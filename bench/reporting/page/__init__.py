"""The report: a folder of HTML pages and data files from stored cells and the files beside their store.

:mod:`bench.reporting.page.reading` reads the store, :mod:`bench.reporting.page.standing` says who is best where,
:mod:`bench.reporting.page.situations` what is advised; the modules named after a part make that part's data, and
:mod:`bench.reporting.page.site` puts them into the templates beside it. ``static`` holds the site's own scripts and
styles, ``vendor`` the libraries that they use.
"""
