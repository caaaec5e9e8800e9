"""Numbers that prose may type: what this project does not measure, as patterns by what they are."""

from __future__ import annotations

NOISE = r"\d+(?: dB)?(?:, \d+)?(?: to \d+| and \d+)? dB\b"
ALLOWED = (
    # names
    r"Python 3\.\d+",
    r"\bTables? \d+(?: (?:to|and) \d+)?(?!\d)",
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
    r"20 workers killed \(-9\)",
    r"1,000 cells that take no time; 200 cells of 0\.5 s",
    r"a store of 100,000 cells",
    r"nothing twice",
    r"none twice",
)
"""A number within one of these is no result."""
