"""``python -m bench.report [store=...] [out=results/report.html]``: the results as one page, without network.

Only ever run, never imported: ``bench.report`` is also a public function of the contract (:mod:`bench.checkpoint`), and
importing this module would put itself in that function's place. What it runs is :mod:`bench.pages`.
"""

from __future__ import annotations

import sys

from bench.pages.page import main

if __name__ == "__main__":
    sys.exit(main())
