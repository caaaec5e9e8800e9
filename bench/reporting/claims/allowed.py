"""Numbers that prose may type: what this project does not measure, as patterns by what they are."""

from __future__ import annotations

from pathlib import PurePosixPath

NOISE = r"\d+(?: dB)?(?:, \d+)?(?: to \d+| and \d+)? dB\b"
ALLOWED = (
    # names
    r"Python 3\.\d+",
    r"\b(?:Tables?|Figures?) \d+(?: (?:to|and) \d+)?(?!\d)",
    r"Karkadakattil 2026\b",
    r"doi[: ]10\.25082/RIMA\.2026\.02\.002",
    r"Schoukens, 2013",
    r"k1 k2/\(m1 m2\)",
    # noise levels, which are set, and what is set beside them
    NOISE,
    r"noise of 30 dB",
    r"25 samples(?: over 10 s)?",
    r"about four and a half cycles",
    r"damping ratio 6\.7 to 7\.0 %",
    r"(?:with )?2\.2 samples a cycle",
    r"records with 1\.6",
    r"Two modes 1\.5 % apart",
    r"500 cycles at 0\.1 % damping",
    r"half a kilogram added",
    r"a 0\.2 s pulse",
    r"springs of 12 and 9 N/m, or of 20\.25 and 5\.33",
    r"a mass weighed to 2 %",
    r"jitter of 2 % of a step",
    r"a drift of 5 and 10 % of the signal",
    r"start (?:is )?told 20 ms too early",
    r"k/m 0\.5 to 40, c/m 0\.05 to 2\)",
    r"with 1 to 20 masses",
    r"to 4,096 training samples",
    # definitions: a level, a limit, what a bound is, what a number of replicates gives by itself
    r"95 % intervals?",
    r"within 1 % of the minimum",
    r"has an excess above 5 in",
    r"beyond five times the bound",
    r"more than twice the least",
    r"over the bound \(1 is the best",
    r"1 is the best an unbiased method can do; with 100 replicates it is itself uncertain by about 7 %",
    r"can be below 1 where the noise is large",
    r"rises towards c = 0",
    r"a change that hits 5 % of the replicates",
    r"bound above 100 %",
    r"DOFs counted from 0",
    r"not 1 and 0\.",
    # what commands and studies are asked to do
    r"at most 1,000 steps of L-BFGS",
    r"200 scenarios that nobody chose",
    r"two real poles, ten thousand samples or five",
    r"every 2 s, every ten",
    r"200 cells, driver killed \(-9\)",
    r"20 kinds of misbehaving",
    r"5,000 cells that take no time; cells of 0\.5 s, on two cores",
    r"killed \(-9\)",
    r"nothing twice",
    r"none twice",
)
"""A number within one of these is no result."""
ALLOWED_IN = {
    "docs/how_to/clusters.md": (
        # what the studies are asked to do
        r"200 cells, jobs of 5",
        r"for a worker at 20 %",
        r"a whole node at 50 %",
        r"two stores of 20 cells in jobs of 2",
        r"million such cells take on one, ten and a hundred nodes",
        r"At 20 cells a job, a million cells are 50,000 configurations",
        # defaults and versions of others
        r"exit status \d",
        r"\((?:1 if absent|60|0|256)\)",
        r"\(1001 unless",
        r"Slurm 22\.05",
        r"NFS 4",
        r"90 s by default",
        r"some sixteen a cell",
        r"\(not measured here\) one NFS server takes some 10³ a second and a good parallel file system some 10⁴",
    ),
    "docs/how_to/kit.md": (
        r"exit status is \d where all pass, \d where one fails, and \d for bad input",
        r"exit status is \d,",
    ),
    "docs/how_to/run_sweeps.md": (r"exit status 130, 143, 129",),
    "docs/how_to/read_published_results.md": (
        r"the 20 dB of table 5 are those of table 3",
        r"Do intervals of 95 % cover",
    ),
    # definitions
    "docs/explanation/intervals.md": (
        r"holds the truth in 95 of 100",
        r"both of 95 %",
        r"(?:Mandel|Spiegelhalter|Cheung|Raftery),? (?:1982|2007|2009|2010)",
        r"is half of that of k/m",
        r"at most 0\.4",
        r"once in a thousand",
        r"ideal interval, 1 where",
        r"amplitudes differ by 20 %",
        r"a prior of 0\.2 % of a stiffness and 4 % of a damping",
    ),
    "docs/explanation/measured.md": (r"records of 33 kinds",),
    "docs/how_to/measured_record.md": (r"At most a million rows of 64 columns", r"at most 0\.4"),
    "docs/explanation/paper.md": (r"against the replicates of the same method here, twice:",),
    "docs/reference/commands.md": (r"exit status is 0 .*? and 129 for",),
    "docs/reference/file_formats.md": (
        r"UTF-8",
        r"SHA-256",
        r"median, 99 %, largest",
        r"levels below 1e-38 are 0",
        r"1 where the interval covers the true value, else 0",
        r"interval score \(95 %\)",
    ),
    # defaults and limits, which tests/docs/test_reference_pages.py holds against the configuration and the code
    "docs/reference/configuration.md": (
        r"\| \d+(?:, none)? \|",
        r"from 0\b",
        r"\b(?:60|300) s\b",
        r"\b(?:64|4096) MB\b",
    ),
    "results/README.md": (r"\[table1[01]\.md",),
    # what the reader of a tutorial is given, asks for, and is shown by blocks that tests/docs/test_tutorials.py runs
    "docs/tutorials/first_cell.md": (r"It should be near 95",),
    "docs/tutorials/own_record.md": (
        r"vibrates at 2 Hz with a damping ratio of 2 %",
        r"The truth, 2 Hz and 2 %,",
        r"200 simulated replicas",
    ),
    "docs/tutorials/plan_test.md": (
        r"want c/m to 5 %",
        r"reaches the 5 %",
        r"roughly: (?:2 Hz|0\.02)",
        r"standard deviation of 0\.5 mm",
        r"pull the mass: 1 cm",
        r"simulates the test 200 times",
        r"should be near 95: .*? within 1\.96 times the wanted one",
    ),
    "docs/tutorials/track_stream.md": (
        r"A mass of 1 kg",
        r"loses a quarter of its stiffness",
        r"k is near 8 N/m, at the end near 6\b",
    ),
}
"""Likewise in one document, beside the others."""


def allowed_in(path: PurePosixPath) -> tuple[str, ...]:
    """The patterns for a document, by its path below the folder that holds ``results``."""
    return (*ALLOWED, *ALLOWED_IN.get(str(path), ()))
