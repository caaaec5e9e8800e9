"""The report: one self-contained HTML file from stored cells and the files beside their store.

:mod:`bench.reporting.page.reading` reads the store, :mod:`bench.reporting.page.standing` says who is best where, the
modules named after a part of the page make that part's data, and :mod:`bench.reporting.page.page` puts them into the
template beside it.
"""
