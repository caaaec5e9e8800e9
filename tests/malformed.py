"""Malformed command lines as a table, one row a cause, with the line that each must end with.

A row holds the words behind ``python -m bench``, the beginning of the error (field and value), and a part of what would
be right. Each ends with status 2 and that one line on the error stream, before any work and any file. What the type of
a field excludes is tested where types are read (``tests/bench/commands/test_declaration.py``), and stands here once.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

LONG = "z" * 65_536
"""Longer than any name, and nearly as long as an argument may be."""
SHORTHANDS = {
    "$CELL": "method=prior replicates=2",
    "$RECORD": "method=ls data=good.csv",
    "$DECAY": "want=c_over_m:5% frequency=2 damping=0.02 noise=0.5mm",
    "$FORCE": "want=c_over_m:5% frequency=2 damping=0.03 noise=0.5mm force=optimal",
    "$TEST": "samples=50 cycles=5 damping=0.02 snr=20",
    "$EXPORT": "share action=export",
    "$MERGE": "share action=merge",
    "$SUBMIT": "share action=submit",
    "$LONG": LONG,
}


@dataclass(frozen=True)
class Malformed:
    """A command line that makes no sense, the beginning of its one line, and a part of what would be right."""

    words: tuple[str, ...]
    start: str
    remedy: str

    @property
    def name(self) -> str:
        """A name for the test, of letters that every terminal shows."""
        shown = " ".join(text if len(text) < 60 else f"{text[:40]}...{len(text)}" for text in self.words)
        return shown.encode("ascii", "backslashreplace").decode()


TABLE = r"""
# ---- words and fields
method                                            | verb=method                      | verbs
certfy                                            | verb=certfy                      | did you mean certify
snr=20                                            | method=                          | choose one
method=prior snr = 20                             | argument='snr'                   | without spaces
method=prior --snr=20                             | option=--snr                     | no dashes
method=prior method=ls                            | method=ls                        | twice
method=prior metod=ls                             | metod=ls                         | did you mean method
method=prior method.name=ls                       | method.name=ls                   | method=<name>
method=prior ~system                              | ~system=                         | can be removed
method=sl                                         | method=sl                        | did you mean ls
ls                                                | verb=ls                          | did you mean method=ls
method=$LONG                                      | method=zzz                       | known
# ---- values of a run
$CELL snr=abc                                     | snr=abc                          | number
$CELL snr=nan                                     | snr=nan                          | finite
$CELL snr=true                                    | snr=True                         | number
$CELL snr=[20]                                    | snr=[20]                         | number
$CELL snr=1e308                                   | snr=1e+308                       | 300
$CELL dry_run=3                                   | dry_run=3                        | boolean
$CELL retry=../sdof                               | retry=../sdof                    |
$CELL store=${oc.env:HOME}                        | store=${oc.env:HOME}             | the value
$CELL store=file/below                            | store=file/below                 |
$CELL archive=missing                             | archive=missing                  | folder
$CELL columns=t:0                                 | columns=t:0                      | data=
$CELL nominal.m=1                                 | nominal.m=1                      | data=
# ---- sweeps
method=ls,rls                                     | method=ls,rls                    | -m
-m $CELL workers=1,2                              | workers=1,2                      | one value
-m $CELL dry_run=false,true                       | dry_run=false,true               | one value
-m method=prior snr=20,                           | snr=20,                          | not understood
-m method=prior snr=20,20,nan                     | snr=nan                          | finite
-m method=prior snr=interval(0,10)                | snr=interval(0,10)               | values
-m method=prior snr=glob(*)                       | snr=glob(*)                      | no value
-m method=prior seed=range(0,10,0)                | seed=range(0,10,0)               |
-m method=prior seed=range(0,1e300)               | seed=range(0,1e300)              | more than
-m method=prior seed=range(0,1000) snr=range(0,1000) |                               | at most
-m experiment=table3 experiment=table4            | experiment=table4                | twice
-m experiment=open system=open_999999             | system=open_999999               | known
# ---- scenarios
$CELL system.parameters.m=1e-300                  | system.parameters.m=1e-300       | at least
$CELL system.parameters.m=-1                      | system.parameters.m=-1           | greater than 0
$CELL system.samples=1000000000000                | system.samples=1000000000000     | at most
$CELL system.duration=true                        | system.duration=True             | number
$CELL system.initial.displacement=[1,2]           | system.initial=[1.0, 2.0]        | one a DOF
$CELL system.colour=red                           | system.colour=red                | not a field
$CELL system=chain2 system.options.n=1000000      | system.options.n=1000000         | at most
$CELL system=sdof_forced system.force.kind=square | system.force.kind=square         | multisine
$CELL disturbance=drift disturbance.size=1e308    | disturbance.size=1e+308          | at most
method=pinn method.width=abc                      | method.width=abc                 | integer
method=ls method.zz=1                             | method.zz=1                      |
# ---- scenarios in files
$CELL system=missing.yaml                         | system=missing.yaml              | not found
$CELL system=pipe.yaml                            | system=pipe.yaml                 | file
$CELL system=huge.yaml                            | system=huge.yaml                 | at most
$CELL system=random.yaml                          | system=random.yaml               | UTF-8
$CELL system=list.yaml                            | system=list.yaml                 | conf/system
$CELL system=nothing.yaml                         | system=nothing.yaml              | conf/system
$CELL system=open.yaml                            | system=open.yaml                 | not plain YAML
$CELL system=typo.yaml                            | system.samplez=3                 | did you mean samples
$CELL system=bomb.yaml                            | system=bomb.yaml                 | alias
$CELL system=deep.yaml                            | system=deep.yaml                 |
$CELL system=tag.yaml                             | system=tag.yaml                  | YAML
$CELL system=twice.yaml                           | system=twice.yaml                | duplicate
$CELL system=half.yaml                            | system.parameters=               | needed
$CELL system=base.yaml                            | system=base.yaml                 | defaults contains nowhere
$CELL system=secret.yaml                          | system=secret.yaml               | ${
$CELL system=wrongprior.yaml                      | prior=zz                         | known
# ---- Hydra's own fields
$CELL hydra/launcher=os.system                    | hydra/launcher=os.system         | ray
$CELL hydra/launcher=ray hydra.launcher.x._target_=os.system | hydra.launcher.x._target_=os.system |
$CELL hydra.launcher.zz=1                         | hydra.launcher.zz=1              | hydra/launcher
$CELL hydra.mode=MULTIRUN                         | hydra.mode=MULTIRUN              | hydra.launcher
# ---- measured records
$RECORD snr=20                                    | snr=20                           | simulated
$RECORD prior=nominal                             | nominal=                         | nominal.m
$RECORD prior=nominal nominal.m=1                 | nominal={'m': 1.0}               | nominal.k=
$RECORD nominal.m=1                               | nominal.m=1                      | nominal values need prior=
$RECORD initial_state=known                       | start=None                       | initial_state=known needs start=
$RECORD initial_state=known start=[1]             | start=[1.0]                      | start=[displacement,velocity]
$RECORD replicates=3                              | replicates=3                     | simulated
$RECORD disturbance=bias                          | disturbance=bias                 | simulated
$RECORD seed=1,2                                  | seed=1,2                         | use a single value
$RECORD system=nonsense                           | system=nonsense                  | conf/system
$RECORD system=sdof+coulomb system.samples=20     | system=sdof+coulomb              | omit system.<field>
$RECORD system=auto fixed.l=1                     | fixed={'l': 1.0}                 | not supported with system=auto
$RECORD fixed.m=0                                 | fixed.m=0.0                      | a positive mass
$RECORD fixed.q=1                                 | fixed.q=1.0                      | parameters of these terms: c, k
$RECORD fixed.k=9                                 | fixed={'k': 9.0}                 | only ratios to the mass
$RECORD fixed.m=1 prior=nominal nominal.m=1 nominal.c=1 nominal.k=9 | fixed.m=1.0    | determined by the force
$RECORD hold=step                                 | hold=step                        | zero_order
$RECORD from=100                                  | from=100                         | runs from 0 to 5.9 s
$RECORD band=1:4                                  | band=1:4                         | modes only
$RECORD system=sdof+beam                          | system=sdof+beam                 |
$RECORD columns=t                                 | columns=t                        | role:value
$RECORD columns=x:0,x:1                           | columns=x:0,x:1                  | x occurs twice
$RECORD force_gain=0                              | force_gain=0                     | no force
$RECORD from=5 to=1                               | from=5                           | less than
method=ls data=missing                            | data=missing                     | cannot be read
method=ls data=missing picture=fit.png            | picture=fit.png                  | ends in .svg
method=ls data=missing plot=always format=json    | plot=always                      | format=table
method=oracle data=good.csv                       | method=oracle                    | true values
data=good.csv modes=0                             | modes=0                          | auto or a number from 1 to 10
data=good.csv modes=eleven                        | modes=eleven                     | auto or a number from 1 to 10
data=good.csv modes=2 band=4:1                    | band=4:1                         | lower:upper in Hz
data=good.csv modes=2 band=1:20                   | band=1:20                        | frequency of good.csv is 5 Hz
data=good.csv modes=2 system=duffing              | system=duffing                   | modes=
data=good.csv modes=2 method=pinn                 | method=pinn                      | takes modal methods
data=good.csv modes=2 to=0.5                      | data=good.csv                    | at least 32 are needed for modes
method=ls data=folder                             | data=folder                      |
method=ls data=/dev/zero                          | data=/dev/zero                   |
method=ls data=pipe                               | data=pipe                        |
method=ls data=empty                              | data=empty                       | empty
method=ls data=random                             | data=random                      | binary
method=ls data=gigabyte                           | data=gigabyte                    | MiB
method=ls data=header.csv                         | data=header.csv                  | no rows
method=ls data=backwards.csv                      | data=backwards.csv               | time decreases
method=ls data=hugevalues.csv                     | data=hugevalues.csv              | in SI
method=ls data=ragged.csv                         | data=ragged.csv                  | numbers are needed
method=ls data=bomb.gz                            | data=bomb.gz                     | MiB
method=ls data=bomb.zip                           | data=bomb.zip                    | MiB
# ---- verbs
design want=c_over_m:5% frequency=2 damping=0.02 noise=0.5mm amplitude=1rad | amplitude=1rad | length
design want=mass:5% frequency=2 damping=0.02 noise=0.5mm | want=mass:5%                | k_over_m
design want=c_over_m:5 frequency=2 damping=0.02 noise=0.5mm | want=c_over_m:5        | a percentage
design want=c_over_m:5% frequency=-1 damping=0.02 noise=0.5mm | frequency=-1         | greater
design want=c_over_m:5% frequency=2 damping=0.02:x% noise=0.5mm | damping=0.02:x%    | number
design want=c_over_m:5% frequency=2 damping=0.02 noise=0.5 | noise=0.5               | with its unit
design want=c_over_m:5% frequency=2 damping=0.02 noise=0.5s | noise=0.5s             | with its unit
design samples=50 cycles=5 damping=-2% snr=20     | damping=-2%                      | greater
design $DECAY amplitude=ten                       | amplitude=ten                    | with its unit
design $DECAY method=shoting verify=2             | method=shoting                   | did you mean shooting
design $DECAY force=best                          | force=best                       | one of optimal
design $FORCE samples=60 duration=4 mass=2        | energy=                          | needed
design $FORCE samples=60 duration=4 energy=4      | mass=                            | needed
design $FORCE samples=60 energy=4 mass=2          | duration=                        | needed
design $FORCE duration=4 energy=4 mass=2          | samples=                         | needed
design $FORCE samples=8 duration=4 energy=4 mass=2 | samples=8                       | at least 21
design $FORCE samples=60 duration=0.1 energy=4 mass=2 | duration=0.1                 | at least 3 lines
design $FORCE samples=60 duration=4 energy=4 mass=2 times=optimal | times=optimal    | not a field
design $FORCE samples=60 duration=4 energy=4 mass=2 out=file/f.csv | out=file/f.csv  | another folder
design $DECAY samples=20                          | duration=                        | describe the test
design $TEST atlas=good.csv                       | atlas=good.csv                   | experiment=atlas
identifiability measured=[1]                      | measured=[1]                     | a list of DOFs
identifiability measured=first                    | measured=first                   | such as [0,1]
identifiability method=pinn                       | method=pinn                      | not a field
identifiability system=sdfo                       | system=sdfo                      | did you mean sdof
identifiability snr=10,20                         | snr=10,20                        | several values
tables what=clams                                 | what=clams                       | did you mean claims
run method=ls data=nowhere.csv                    | data=nowhere.csv                 | cannot be read
identify method=ls data=nowhere.csv               | data=nowhere.csv                 | cannot be read
tables store=empty archive=none                   | store=empty                      | no cell
report store=store out=.                          | out=.                            | new, empty
reproduce cell=zz                                 | cell=zz                          | identity
track forced=9                                    | forced=9                         |
track follow=true                                 | follow=true                      | from=
track method=efk                                  | method=efk                       | did you mean ekf
track from=nowhere.csv                            | from=nowhere.csv                 | file or pipe not found
track method=rls columns=t                        | columns=t                        | role:value
track method=rls ambient=0                        | method=rls                       | requires a known force
track method=rls limits=3                         | limits=3                         | lo:hi
track method=rls method.factor=2                  | method.factor=2                  | less than or equal to 1
track resume=true                                 | resume=true                      | with state=<file>
track method=rls from=random forced=0 rate=20     | stream=                          | no line of the form t, x1, f1
track state=state.json resume=true                | state=state.json                 | not a state file
-m experiment=measured set=nonsense               | set=nonsense                     | one of
-m experiment=online system=sdof scenario=ramp,ramp | scenario=ramp                  | once
-m experiment=online system=sdof system.varying.k=jump dry_run=true | system.varying.k.kind=jump |
-m experiment=online system=sdof system.varying.q=step dry_run=true | system.varying.q=q | one of m, c, k
-m experiment=online system.varying.k=step dry_run=true | system.varying.k=          | system=<name>
-m experiment=online system=sdof force=loud dry_run=true | force.kind=loud          | coloured
-m experiment=online scenario=rmap dry_run=true   | scenario=rmap                    | did you mean ramp
-m experiment=online method=efk dry_run=true      | method=efk                       | did you mean ekf
-m experiment=modal scenario=two_mode dry_run=true | scenario=two_mode                | two_modes
-m experiment=modal method=wavs dry_run=true      | method=wavs                      | waves
-m experiment=atlas part=phases dry_run=true     | part=phases                      | one of points
-m experiment=atlas method=shoting                | method=shoting                   | did you mean shooting
-m experiment=atlas points=0                      | points=0                         | greater than or equal to 1
-m experiment=atlas fit=maybe                     | fit=maybe                        | boolean
-m experiment=atlas snr=3                         | snr=3                            | not a field
# ---- the kit
check package=missing.py                          | package=missing.py               | no such file
check package=folder                              | package=folder                   | pyproject.toml
check package=dying.py                            | package=dying.py                 | SIGKILL
check package=looping.py timeout_s=1              | package=looping.py               | limit of 1 s
check package=syntax.py                           | package=syntax.py                | SyntaxError
check package=lines_toml                          | package=lines_toml/pyproject.toml | letters
check package=ls method.bootstrap=2.5             | method.bootstrap=2.5             |
new method=true                                   | method=                          |
new method=../x                                   | method=../x                      | small letters
new method=slow_fit out=a/slow_fit                | out=a/slow_fit                   | hides the module
new method=numpy                                  | method=numpy                     | a module of Python
share                                             | action=                          | what to do
$EXPORT                                           | form=                            | petab, arviz or notebook
$EXPORT form=word                                 | form=word                        | one of petab
$EXPORT form=petab system=sdof_forced             | system.force=known               | free vibration
$EXPORT form=petab snr=10,20                      | snr=10,20                        | several
$EXPORT form=arviz cell=00 store=store archive=none | cell=00                        | no such cell
$SUBMIT method=ls store=store                     | method=ls                        | no cell
$MERGE submission=store store=store               | store=store                      | with itself
$MERGE submission=good.csv verify=2               | verify=2                         |
$MERGE submission=random                          | submission=random                | not a whole submission
$MERGE submission=later.submission                | submission=later.submission      | of format 99
$MERGE submission=lacking.submission              | submission=lacking.submission    | not a whole submission
$MERGE submission=huge.submission                 | submission=huge.submission       | 64 MB
$MERGE submission=arrays.submission               | submission=arrays.submission     | not a whole submission
score                                             | predictions=                     | needed
round                                             | action=                          | needed
round nwe                                         | action=nwe                       | did you mean new
round new scenarios=6                             | out=                             | needed
round new scenarios=0 out=r                       | scenarios=0                      | greater
round new scenarios=6 out=folder                  | out=folder                       | does not exist yet
round new scenarios=6 out=r secret=r/s            | secret=r/s                       | outside
round solve nowhere method=ls out=p.csv           | round=nowhere                    | folder not found
round solve round=folder method=ls out=p.csv            | round=folder                     | no problems
round solve round=folder method=sl out=p.csv            | method=sl                        | did you mean ls
round open round=folder secret=nowhere                  | secret=nowhere                   | folder not found
round open round=folder secret=folder                   | round=folder                     | no round.json
round verify nowhere                              | round=nowhere                    | folder not found
round verify round=folder                               | round=folder                     | round.json
$MERGE submission=x fresh=-1                      | fresh=-1                         | greater
score good.csv                                    | round=                           | needed
score good.csv r                                  | round=r                          | folder not found
score good.csv round=folder                       | round=folder                     | no predictions_template.csv
audit                                             | claim=                           | needed
audit missing.yaml                                | claim=missing.yaml               | not found
audit list.yaml                                   | claim=list.yaml                  | a claim is wanted
audit twice.yaml                                  | claim=twice.yaml                 | duplicate
tables what=audits claims=missing                 | claims=missing                   | folder not found
"""


def all_malformed() -> list[Malformed]:
    """Return the rows of the table."""
    rows = (line.split("|") for line in TABLE.strip().splitlines() if not line.startswith("#"))
    return [Malformed(words_of(line), start.strip(), remedy.strip()) for line, start, remedy in rows]


def words_of(line: str) -> tuple[str, ...]:
    """Return the words of a line, with what its shorthands stand for."""
    for name, text in SHORTHANDS.items():
        line = line.replace(name, text)
    return tuple(re.findall(r"\S+", line))
