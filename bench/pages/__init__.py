"""The report: one self-contained HTML file from stored cells and the files beside it.

:mod:`bench.pages.gather` reads the store, :mod:`bench.pages.standing` says who is best where, the modules named after
a part of the page make that part's data, and :mod:`bench.pages.page` puts them into the template beside it.
"""
