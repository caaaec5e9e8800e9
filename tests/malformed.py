"""Malformed input as a table: command lines, files of one's own, records, stores, and what is expected of each.

Regular lines are generated: a field of a command with every malformation of the kind of value it takes. The others are
written out. Each line must end with status 2 and one line on the error stream, which begins with the command, the field
and the value (its beginning where it is long), holds the words of the remedy, and comes before any work and any file.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass

LONG = "z" * 65_536
"""Longer than any name, and nearly as long as an argument may be."""
NUMBERS = ("", "abc", "nan", "-inf", "1e999", "0x1F", "1,5", "true", "9" * 400 + "x")
"""None of them is a finite number."""
WHOLE = ("", "abc", "2.5", "-1", "²", "9" * 5000)
"""None of them is a whole number; ``1e3`` is one where numbers are read as YAML has them."""
FLAGS = ("", "yes", "1", "maybe")
NAMES = ("", "nonsense", "../sdof", LONG, "\x1b[31mred", "\udcff")
TO_READ = ("", "missing", "file/below", LONG, "pipe")
"""Folders that are not there; ``file`` is one, and no folder."""
TO_WRITE = ("", "file/below", LONG, "/proc/nowhere", "pipe")
FILES = ("", "missing", "folder", "/dev/zero", "pipe", "empty", "random", LONG)
"""No file that can be read as what is wanted; each stands in the folder in which the command runs."""
TO_STREAM = ("", "folder", "file/below", "/proc/nowhere/x", LONG)
FILES_OUT = (*TO_STREAM, "pipe", "zero.yaml")


@dataclass(frozen=True)
class Malformed:
    """A command line that makes no sense, and what its one line must say.

    ``value`` is what stands behind the field's name (None: not checked), ``remedy`` a part of what would be right.
    """

    command: str
    arguments: tuple[str, ...]
    field: str
    value: str | None
    remedy: str = ""

    @property
    def name(self) -> str:
        """A name for the test, of letters that every terminal shows."""
        shown = " ".join(text if len(text) < 60 else f"{text[:40]}...{len(text)}" for text in self.arguments)
        return f"{self.command}: {shown.encode('ascii', 'backslashreplace').decode()}"


@dataclass(frozen=True)
class Field:
    """A field of a command with the kind of its values, and what must be said beside it for it to be looked at."""

    command: str
    name: str
    kind: tuple[str, ...]
    beside: str = ""


CELL = "method=prior replicates=2"
DECAY = "want=c_over_m:5% frequency=2 damping=0.02 noise=0.5mm"
NOMINAL = "nominal.m=1 nominal.c=1 nominal.k=1"
FORCE = f"{DECAY} force=optimal samples=100 duration=5 energy=1 mass=1"
TESTS = ("free_decay", "forced")
TEST = "samples=50 cycles=5 damping=0.02 snr=20"
FIELDS = (
    Field("bench", "method", NAMES),
    *(Field("bench", name, NUMBERS, CELL) for name in ("snr", "system.parameters.m")),
    *(Field("bench", name, ("abc", "nan", "0"), CELL) for name in ("timeout_s", "memory_mb")),
    *(Field("bench", name, WHOLE, "method=prior") for name in ("replicates", "system.samples")),
    *(Field("bench", name, ("abc", "-1"), "method=prior") for name in ("seed", "workers")),
    *(Field("bench", name, NAMES, CELL) for name in ("system", "prior", "disturbance", "initial_state", "format")),
    Field("bench", "dry_run", ("", "ja", "2"), CELL),
    Field("bench", "retry", NAMES, f"{CELL} dry_run=true"),
    Field("bench", "store", TO_WRITE, CELL),
    Field("bench", "archive", TO_READ, CELL),
    Field("bench", "data", FILES, "method=ls"),
    *(Field("bench", name, ("abc", "-1"), "method=ls data=good.csv") for name in ("rate", "decimate", "hold")),
    Field("tables", "store", TO_READ[1:]),
    Field("tables", "archive", TO_READ[1:], "store=store"),
    *(Field("tables", "out", TO_WRITE[1:], f"store=store what={what}") for what in ("tables", "figures")),
    Field("tables", "root", TO_READ[1:], "what=claims store=store"),
    Field("report", "out", TO_WRITE[1:], "store=store"),
    Field("status", "watch", ("soon", "nan", "0", "1e9"), "store=store method=ls"),
    Field("certify", "data", FILES[1:], "twins=0"),
    Field("certify", "out", TO_WRITE[1:], "data=good.csv twins=0 method=ls"),
    Field("certify", "method", NAMES[1:], "data=good.csv twins=0"),
    *(Field("design", name, ("1", "1kg", "1rad", "nan m", "-1mm"), DECAY) for name in ("noise", "amplitude")),
    Field("design", "want", ("c_over_m", "c_over_m:5", "c_over_m:0%", "mass:5%", "c_over_m:nan%"), DECAY),
    Field("design", "given", FILES[1:7]),
    Field("design", "samples", ("7", "501"), FORCE),
    Field("design", "out", FILES_OUT[1:], FORCE),
    Field("design", "atlas", FILES[1:], TEST),
    Field("identifiability", "measured", ("[9]", "[-1]", "[0.5]", "one", "[]", "[[0]]", "true"), "system=sdof"),
    Field("identifiability", "system", NAMES),
    Field("identifiability", "out", TO_WRITE[1:], "profile=true"),
    Field("track", "sensors", ("speed:0", "displacement:x", "displacement:9", ",", LONG)),
    Field("track", "limits", ("1", "nan:nan", "1:0", "a:b")),
    *(Field("track", name, ("x", "-1", "9", "0,0")) for name in ("forced", "ambient")),
    Field("track", "from", ("missing", "folder", "/dev/zero", LONG)),
    Field("track", "out", TO_STREAM[1:], "from=good.csv"),
    Field("track", "state", FILES_OUT[1:], "from=good.csv out=none"),
    Field("track", "state", FILES[1:], "resume=true"),
    Field("measured", "data_root", TO_READ[1:], "dry_run=true"),
    *(Field("measured", name, NAMES[1:], "dry_run=true") for name in ("set", "method")),
    *(Field("measured", name, TO_WRITE[1:], "fit=false set=airtrack") for name in ("store", "out")),
    *(Field("online", name, NAMES[1:], "dry_run=true") for name in ("scenario", "method", "system")),
    *(Field("online", name, TO_WRITE[1:], "fit=false") for name in ("store", "out")),
    *(Field("atlas", name, NAMES[1:], f"test={test} dry_run=true") for name in ("part", "method") for test in TESTS),
    Field("atlas", "shard", ("1", "0/4", "5/4", "1/x"), "dry_run=true"),
    *(Field("atlas", name, TO_WRITE[1:], "fit=false points=8 part=points method=ls") for name in ("store", "out")),
    Field("check", "method.bootstrap", ("abc", "nan", "1e999", "2.5", LONG), "package=ls"),
    Field("check", "system.n", ("two", "2.5", "0", "-1", "1e12", "1000000000", "nan"), "package=chain"),
    *(Field("petab", name, NAMES) for name in ("system", "prior", "disturbance", "initial_state")),
    Field("petab", "out", TO_WRITE[1:]),
    Field("notebook", "method", NAMES),
    Field("notebook", "out", FILES_OUT[1:], "method=ls"),
    Field("arviz", "store", TO_READ[1:], "cell=00"),
    Field("merge", "verify", ("0.09", "1.01"), "submission=store"),
    Field("merge", "store", TO_WRITE[1:], "submission=store"),
    Field("new", "out", (*TO_WRITE[1:], "filled_toml", "/dev/zero"), "method=my_method"),
    Field("publish", "archive", TO_WRITE[1:], "store=store"),
    Field("submit", "method", NAMES[1:], "store=store"),
    Field("submit", "experiment", NAMES[1:], "method=ls store=store"),
    Field("submit", "by", (LONG, "\x1b[31mred", "\udcff", "two\nlines"), "method=ls store=store"),
    Field("submit", "out", FILES_OUT[1:], "method=ls store=store"),
)


WRITTEN = """
# command | arguments | field | value | a part of what would be right
bench | method | verb | method | verbs
bench | certfy | verb | certfy | did you mean certify
bench | snr=20 | method | | choose one
bench | method=prior snr = 20 | argument | 'snr' | without spaces
bench | method=prior --snr=20 | option | --snr=20 | no dashes
bench | method=prior -x | option | -x | options are
bench | method=prior method=ls | method | ls | twice
bench | method=prior snr=true | snr | True | number
bench | method=prior system.duration=true | system.duration | True | number
bench | method=prior replicates=true | replicates | True | number
bench | method=prior timeout_s=false | timeout_s | False | number
bench | method=prior dry_run=3 | dry_run | 3 | true or false
bench | method=prior snr=[20] | snr | [20] | number
bench | method=prior snr={a:1} | snr | {'a': 1} | number
bench | method=prior system=[sdof] | system | ['sdof'] | known
bench | method=prior system={a:1} | system | {'a': 1} | known
bench | method=prior snr=1e308 | snr | 1e+308 | 300
bench | method=prior system.parameters.m=1e308 | system.parameters.m | 1e+308 | at most
bench | method=prior system.parameters.k=1e-300 | system.parameters.k | 1e-300 | at least
bench | method=prior system.duration=1e20 | system.duration | 1e+20 | at most
bench | method=prior system.duration=1e-200 | system.duration | 1e-200 | at least
bench | method=prior system.forecast=1e20 | system.forecast | 1e+20 | at most
bench | method=prior system.samples=1000000000000 | system.samples | 1000000000000 | 100000
bench | method=prior system=sdof_forced system.force.samples=1e12 | system.force.samples | 1000000000000.0 | at most
bench | method=prior system=sdof_forced system.force.tones=1000000000 | system.force.tones | 1000000000 | at most
bench | method=prior system=sdof_forced system.force.amplitude=1e308 | system.force.amplitude | 1e+308 | at most
bench | method=prior system=sdof_forced system.force.kind=square | system.force.kind | square | multisine
bench | method=prior system=sdof_forced system.force.noise_db=nan | system.force.noise_db | nan | finite
bench | method=prior system=sdof_forced system.force.noise_db=-1e308 | system.force.noise_db | -1e+308 | at most
bench | method=prior system=sdof_forced system.force.dof=7 | system.force.dof | 7 | 0
bench | method=prior system=sdof_forced system.force.file=missing system.force.kind=column | system.force |  |
bench | method=prior system.initial.displacement=[1e308] | system.initial | 1e+308 | at most
bench | method=prior system.initial.displacement=[1,2] | system.initial | [1.0, 2.0] | one a DOF
bench | method=prior system.initial=3 | system.initial | 3 | dictionary
bench | method=prior system.parameters=3 | system.parameters | 3 |
bench | method=prior system.parameters.m.x=3 | system.parameters.m | |
bench | method=prior system.kind=beam | system | beam | known
bench | method=prior system.measured=[7] | system.measured | [7] | DOFs
bench | method=prior system.measured=abc | system.measured | abc |
bench | method=prior system.added_mass=[-1] | system.added_mass | [-1.0] | none negative
bench | method=prior system=chain2 system.options.n=1000000 | system.options.n | 1000000 | at most
bench | method=prior system=chain2 system.options.n=two | system.options.n | two |
bench | method=prior system.options.zz=1 | system.options.zz | 1 |
bench | method=prior prior.draws=never | prior.draws | never | 'nominal' or 'truth'
bench | method=prior prior.sd_by_kind.mass=-1 | prior.sd_by_kind.mass | -1 | greater than 0
bench | method=prior prior.sd_by_kind.mass=1e300 | prior.sd_by_kind.mass | 1e+300 | at most
bench | method=prior prior.sd_by_kind.colour=1 | prior.sd_by_kind.colour | 1 | mass
bench | method=prior prior.wrong=maybe | prior.wrong | maybe | boolean
bench | method=prior prior.name=zz | prior.name | zz | prior=<name>
bench | method=prior method.name=shooting | method.name | shooting | method=<name>
bench | method=ls method.name=shooting | method.name | shooting | method=<name>
bench | method=prior method.zz=1 | method.zz | 1 | no such field
bench | method=pinn method.width=abc | method.width | abc | integer
bench | method=pinn method.width=-3 | method.width | -3 |
bench | method=prior nominal.zz=1 | nominal.zz | 1 | data=
bench | method=prior nominal.m=1 | nominal.m | 1 | data=
bench | method=prior nominal={m:1} | nominal | | data=
bench | method=prior fixed.m=1 | fixed.m | 1 | data=
bench | method=prior columns=t:0 | columns | t:0 | data=
bench | method=prior rate=5 | rate | 5 | data=
bench | method=prior from=1 | from | 1 | data=
bench | method=prior start=[1,0] | start | [1, 0] | data=
bench | method=prior detrend=true | detrend | True | data=
bench | -m method=prior seed=range(0,10,0) | seed | range(0,10,0) | step
bench | -m method=prior seed=range(0,1000000000000) | seed | range(0,1000000000000) | at most
bench | -m method=prior seed=range(0,1e300) | seed | range(0,1e300) | at most
bench | -m method=prior seed=range(0,1000) snr=range(0,1000) | | | at most
bench | -m method=prior seed=range(a,b) | seed | range(a,b) | not understood
bench | -m method=prior snr=interval(0,10) | snr | interval(0,10) | values
bench | -m method=prior snr=shuffle(interval(0,10)) | snr | |
bench | -m method=prior snr=choice() | snr | |
bench | -m method=prior snr=choice(20,abc) | snr | abc | number
bench | -m method=prior snr=tag(t,interval(1,2)) | snr | | values
bench | -m method=prior snr=glob(*) | snr | glob(*) | matches nothing
bench | -m method=prior snr=sort(3,2,1,reverse=5) | | |
bench | -m method=prior snr=20, | snr | 20, | not understood
bench | -m method=prior snr=int(abc) | snr | |
bench | -m method=prior snr=float(x) | snr | |
bench | -m method=prior snr=20,20,nan | snr | nan | finite
bench | -m experiment=table3 experiment=table4 | experiment | table4 | twice
bench | -m experiment=null method=prior,zz | method | zz | known
bench | -m experiment=table3 method=zz | method | zz | known
bench | -m experiment=table3 zz=1 | zz | 1 | not a field
bench | -m experiment=table3,table99 | experiment | table99 | known
bench | -m experiment=table3 system=beam | system | beam | known
bench | -m experiment=open system=open_999999 | system | open_999999 | known
bench | method=prior system=open_999 | system | open_999 | known
bench | method=prior hydra.launcher._target_=os.system | hydra.launcher._target_ | os.system | hydra/launcher=
bench | method=prior hydra/launcher=os.system | hydra/launcher | os.system | ray
bench | method=prior hydra/launcher=ray hydra.launcher.x._target_=os.system | hydra.launcher.x._target_ | os.system |
bench | method=prior hydra/sweeper=optuna | hydra/sweeper | optuna | hydra/launcher
bench | method=prior hydra.launcher.zz=1 | hydra.launcher.zz | 1 | hydra/launcher
bench | method=prior hydra.mode=MULTIRUN | hydra.mode | MULTIRUN | hydra.launcher
bench | method=prior cells_per_job=0 | cells_per_job | 0 |
bench | method=prior cells_per_job=3 | cells_per_job | 3 | hydra/launcher
bench | method=prior store=${oc.env:HOME} | store | ${oc.env:HOME} |
bench | method=prior snr=${snr} | snr | ${snr} |
bench | method=prior system.duration=${system.duration} | system.duration | ${system.duration} |
bench | method=prior system.label=${oc.env:HOME} | system.label | ${oc.env:HOME} |
bench | method=prior +system.zz=20 | system.zz | 20 | no such field
bench | method=prior ~system | ~system | | can be left out
bench | method=ls data=good.csv force_gain=0 | force_gain | 0 | no force
bench | -m method=prior workers=1,2 | workers | 1,2 | one value
bench | -m method=prior dry_run=false,true | dry_run | false,true | one value
bench | method=prior method@x=ls | method@x | ls | not a field
bench | method=prior system/zz=1 | system/zz | 1 |
bench | method=prior =5 | argument | '=5' | field=value
bench | method=prior .=5 | | |
bench | method=prior snr..x=5 | snr..x | 5 |
bench | method=prior snr.x=5 | snr.x | 5 | snr
bench | method=prior store.x=5 | store.x | 5 |
bench | method=prior disturbance=jitter disturbance.size=1e308 | disturbance.size | 1e+308 |
bench | method=prior disturbance=drift disturbance.size=1e308 | disturbance.size | 1e+308 | at most
bench | method=prior disturbance=bias disturbance.size=-1e308 | disturbance.size | -1e+308 | at
bench | method=prior disturbance.kind=jitter | disturbance | |
bench | method=prior disturbance.zz=1 | disturbance.zz | 1 | no such field
bench | method=prior replicates=1000001 | replicates | 1000001 | 1000000
bench | method=prior seed=9223372036854775808 | seed | 9223372036854775808 |
bench | method=prior seed=99999999999999999999999999999999999999999999 | seed | |
bench | method=prior memory_mb=1 | memory_mb | 1 | 100
bench | method=prior memory_mb=1e300 | memory_mb | 1e+300 |
bench | method=prior timeout_s=1e300 | timeout_s | 1e+300 |
bench | method=prior workers=100000 | workers | 100000 | 1024
bench | method=prior system=missing.yaml | system | missing.yaml | no such file
bench | method=prior system=folder.yaml | system | folder.yaml | file
bench | method=prior system=pipe.yaml | system | pipe.yaml | file
bench | method=prior system=zero.yaml | system | zero.yaml | file
bench | method=prior system=huge.yaml | system | huge.yaml | at most
bench | method=prior system=empty.yaml | system | empty.yaml | conf/system
bench | method=prior system=random.yaml | system | random.yaml | UTF-8
bench | method=prior system=list.yaml | system | list.yaml | conf/system
bench | method=prior system=number.yaml | system | number.yaml | conf/system
bench | method=prior system=tabs.yaml | system | tabs.yaml | YAML
bench | method=prior system=bomb.yaml | system | bomb.yaml | aliases
bench | method=prior system=cycle.yaml | system | cycle.yaml | aliases
bench | method=prior system=deep.yaml | system | deep.yaml | deep
bench | method=prior system=tag.yaml | system | tag.yaml | YAML
bench | method=prior system=twice.yaml | system | twice.yaml | twice
bench | method=prior system=numbers.yaml | system | numbers.yaml |
bench | method=prior system=unknown.yaml | system.colour | red |
bench | method=prior system=half.yaml | system.parameters | | needed
bench | method=prior system=nomass.yaml | system.parameters | | needed
bench | method=prior system=base.yaml | system | base.yaml | defaults
bench | method=prior system=basenumber.yaml | system | basenumber.yaml | defaults
bench | method=prior system=itself.yaml | system | itself.yaml | defaults
bench | method=prior system=other.yaml | system | other.yaml | defaults
bench | method=prior system=interpolated.yaml | system | interpolated.yaml | ${
bench | method=prior system=secret.yaml | system | secret.yaml | ${
bench | method=prior system=wrongprior.yaml | prior | zz | known
bench | method=prior system=nullparameters.yaml | system.parameters | |
bench | method=prior system=text.yaml | system.parameters.m | heavy | number
bench | method=prior system=flag.yaml | system.parameters.m | True | number
bench | method=prior system=infinite.yaml | system.parameters.m | inf | finite
bench | method=prior system=kind.yaml | system.kind | | string
bench | method=prior system=empty.yaml,sdof | system | | -m
bench | -m method=prior system=sdof,missing.yaml | system | missing.yaml | no such file
bench | method=ls data=good.csv prior=wrong | prior | wrong | simulated
bench | method=ls data=good.csv prior=nominal prior.draws=truth $NOMINAL | prior.draws | truth | simulated
bench | method=ls data=good.csv prior=nominal | nominal | | nominal.m
bench | method=ls data=good.csv nominal.m=1 | nominal.m | 1 | prior=
bench | method=ls data=good.csv prior=nominal $NOMINAL nominal.zz=1 | nominal | zz |
bench | method=ls data=good.csv snr=20 | snr | 20 | simulated
bench | method=ls data=good.csv seed=3 replicates=5 | replicates | 5 | simulated
bench | method=ls data=good.csv system=beam | system | beam | auto
bench | method=ls data=good.csv system=sdof+beam | system | sdof+beam |
bench | method=ls data=good.csv system=+ | system | + |
bench | method=ls data=good.csv system.duration=3 | system | | system.<field>
bench | method=ls data=good.csv columns=t | columns | t | role:value
bench | method=ls data=good.csv columns=t:0,t:1 | columns | t:0,t:1 | twice
bench | method=ls data=good.csv columns=q:0 | columns | q | roles
bench | method=ls data=good.csv columns=t:9,x:1 | | |
bench | method=ls data=good.csv columns=t:0,x:99999999999999999999 | | |
bench | method=ls data=good.csv columns=t:0,x:-1 | | |
bench | method=ls data=good.csv units=x:kg | units | |
bench | method=ls data=good.csv units=x:furlong | units | |
bench | method=ls data=good.csv rate=5 columns=x:1 rate=6 | rate | 6 | twice
bench | method=ls data=good.csv from=99 | from | 99 | runs from
bench | method=ls data=good.csv from=5 to=1 | from | 5 | before
bench | method=ls data=good.csv from=nan | from | nan | finite
bench | method=ls data=good.csv to=soon | to | soon | number
bench | method=ls data=good.csv decimate=9999 | decimate | 9999 |
bench | method=ls data=good.csv detrend=maybe | detrend | maybe | true or false
bench | method=ls data=good.csv force_gain=inf | force_gain | inf | finite
bench | method=ls data=good.csv fixed.zz=1 | fixed | zz |
bench | method=ls data=good.csv fixed.m=-1 | fixed.m | -1 |
bench | method=ls data=good.csv fixed.m=nan | fixed.m | nan | finite
bench | method=ls data=good.csv start=[1] initial_state=known | start | [1.0] |
bench | method=ls data=good.csv start=[1,0] | start | [1.0, 0.0] | initial_state=known
bench | method=ls data=good.csv,missing.csv | data | missing.csv | cannot be read
bench | method=ls data=, | data | , | name a
bench | method=ls data=[good.csv] | data | [good.csv] | cannot be read
bench | method=ls data=größe.csv | data | größe.csv | cannot be read
bench | method=ls data=~/nowhere/rows.csv | data | | cannot be read
bench | method=ls data=a=b.csv | data | a=b.csv | cannot be read
bench | method=ls data='two words.csv' | data | two words.csv | cannot be read
bench | method=ls data=back\\slash.csv | data | back\\slash.csv | cannot be read
bench | method=ls data=${oc.env:HOME} | data | ${oc.env:HOME} | write the value
bench | -m method=ls data=good.csv experiment=table3 | experiment | table3 |
bench | method=zz data=good.csv | method | zz | known
bench | method=all data=missing.csv | data | missing.csv | cannot be read
status | zz=1 | zz | 1 | not a field
status | store=store method=zz | method | zz | known
status | store=store snr=20 | method |  | choose one
status | store=store watch=true | watch | | name the sweep
status | store=store method=prior snr=interval(0,1) | snr | interval(0,1) | values
tables | what=clams | what | clams | did you mean claims
tables | store=empty archive=none | store | empty | no cell
tables | what=figures store=empty archive=none | store | empty | no cell
report | store=empty archive=none | store | empty | no cell
tables | what=reproduction store=empty archive=none | store | empty | no cell
tables | what=reproduction archive=none | store | outputs/rows | folder not found
reproduce | cell=zz | cell | zz | identity
reproduce | cell=00 store=store archive=none | cell | 00 | no such cell
publish | store=empty archive=out | store | empty | no cell
tables | what=claims store=store results=missing | results | missing | folder
design | want=c_over_m:5% frequency=2:x% damping=0.02 noise=0.5mm | frequency | 2:x% | percentage
design | want=c_over_m:5% frequency=2:1e9% damping=0.02 noise=0.5mm | frequency | 1e9 | at most
design | want=c_over_m:5% frequency=2 damping=2 noise=0.5mm | damping | 2 | below 1
design | want=c_over_m:1e-300% frequency=2 damping=0.02 noise=0.5mm | want | c_over_m:1e-300% | from
design | $DECAY samples=20 | duration | | of the test
design | $DECAY times=odd | times | odd | optimal
design | $DECAY times=optimal samples=20 duration=5 | amplitude | | needed
design | $DECAY energy=1 | energy | 1 | not a field
design | $FORCE times=optimal | times | optimal | not a field
design | $FORCE amplitude=1mm | amplitude | 1mm | not a field
design | given=good.csv frequency=2 | frequency | 2 | not a field
design | $TEST atlas=good.csv | atlas | good.csv | experiment=atlas
certify | clean.csv | argument | clean.csv | write data=clean.csv
certify | data=good.csv method=, | method | , |
identifiability | system=sdof,duffing | system | sdof,duffing | several values
identifiability | system.duration=-1 | system.duration | -1 | greater than 0
identifiability | seed=-1 | seed | -1 |
identifiability | prior.zz=1 | prior.zz | 1 | no such field
track | follow=true | follow | true | from=
track | resume=true | resume | true | state=
track | method.zz=1 | method.zz | 1 | settings of
track | method=ekf method.zz={ | method.zz | { |
track | method=window_ls length=150 | length | 150 | not a field
track | method=window_ls method.length=abc | method.length | abc |
track | state=state.json resume=true | state | state.json | not a state file
track | state=deep.json resume=true | state | deep.json | not a state file
track | state=otherstate.json resume=true | state | otherstate.json | not a state file
track | from=header.csv | stream |  | lines that read
track | from=random | stream |  | lines that read
track | from=empty | stream |  | lines that read
track | from=zeros | from | zeros | a line of
track | rate=1e-320 from=good.csv | rate | 1e-320 | positive
online | system=sdof scenario=ramp | scenario | ramp | left out
online | system.varying.k=step | system.varying.k | step | system=
online | system=sdof system.varying.zz=step dry_run=true | system.varying.zz | step | parameters of
online | system=sdof system.varying.k=jump dry_run=true | system.varying.k.kind | jump |
online | system=sdof system.varying.k={ dry_run=true | system.varying.k | { |
online | system=sdof system.varying.k=[ dry_run=true | system.varying.k | [ |
online | system=sdof 'system.varying.k={kind: step, change: nan}' dry_run=true | system.varying.k.change | nan | finite
online | system=sdof 'system.varying.k={kind: step, zz: 1}' dry_run=true | system.varying.k.zz | 1 |
online | system=sdof 'system.varying.k={kind: step, change: -5}' dry_run=true | system.varying.k | -5 |
online | system=sdof 'force={' dry_run=true | force | { |
online | system=sdof force=loud dry_run=true | force.kind | loud |
online | system=sdof 'force={kind: white, zz: 1}' dry_run=true | force.zz | 1 |
online | snr=20 | snr | 20 | with system=
online | system=sdof rate=-1 dry_run=true | rate | -1 | greater than 0
online | system=sdof samples=1e12 dry_run=true | samples | 1e12 |
online | system=sdof snr=1e300 dry_run=true | snr | 1e300 |
atlas | test=zz dry_run=true | test | zz |
check | package=nowhere | package | nowhere |
check | package=ls timeout_s=0 | timeout_s | 0 | positive
check | package=ls method.window={ | method.window | { | a number
petab | snr=nan | snr | nan | finite
petab | system=beam | system | beam | known
arviz | cell=zz | cell | zz | identity
arviz | cell=00 store=missing | store | missing | folder not found
notebook | snr=20 | method |  | choose one
merge | submission=random | submission | random |
merge | submission=empty | submission | empty |
merge | submission=plain.zip | submission | plain.zip |
merge | submission=good.csv verify=2 | verify | 2 | at most 1
merge | submission=pipe | submission | pipe | not a file
new | method=../x | method | ../x |
new | method=my_method out=file/below | out | file/below | cannot be written
new | method=class | method | class | small letters
new | method=a/b | method | a/b | small letters
new | method=.. | method | .. | small letters
new | method=_ | method | _ | small letters
new | method=größe | method | größe | small letters
new | method=Own | method | Own | small letters
new | method=2nd | method | 2nd | small letters
new | method=ls | method | ls | of that name
new | method=oracle | method | oracle | of that name
new | system=sdof | system | sdof | of that name
new | method=numpy | method | numpy | Python has a module
new | method=os | method | os | Python has a module
new | method=bench | method | bench | Python has a module
new | method=$LONG | method | zzzz | at most 60 letters
check | package=raising.py | package | raising.py | RuntimeError: no
check | package=leaving.py | package | leaving.py | neither end its process
check | package=ending.py | package | ending.py | neither end its process
check | package=interrupting.py | package | interrupting.py | neither end its process
check | package=dying.py | package | dying.py | SIGKILL
check | package=printing.py | package | printing.py | File too large
check | package=looping.py timeout_s=1 | package | looping.py | limit of 1 s
check | package=sleeping.py timeout_s=1 | package | sleeping.py | limit of 1 s
check | package=recursing.py | package | recursing.py | RecursionError
check | package=syntax.py | package | syntax.py | SyntaxError
check | package=nested.py | package | nested.py | SyntaxError
check | package=minus.py | package | minus.py | cannot be imported
check | package=latin.py | package | latin.py | utf-8
check | package=nul.py | package | nul.py | null bytes
check | package=binary.py | package | binary.py | cannot be imported
check | package=nothing.py | package | nothing.py | subclasses
check | package=lacking.py | package | lacking.py | not_installed_anywhere
check | package=abstract.py | package | abstract.py | subclasses
check | package='two words.py' | package | two words.py | can be imported
check | package=missing.py | package | missing.py | no such file
check | package=pipe.py | package | pipe.py | it is no file
check | package=zero.py | package | zero.py | it is no file
check | package=folder | package | folder | pyproject.toml
check | package=.. | package | .. | pyproject.toml
check | package=$LONG | package | zzzz | a file, a folder
check | package=$LONG.py | package | zzzz | no such file
check | package=numpy.zz | package | numpy.zz | cannot be imported
check | package=bench.commands.main | package | bench.commands.main | subclasses
check | package=os | package | os | subclasses
check | package=prior | package | prior | registered
check | package=notoml | package | notoml/pyproject.toml | cannot be read
check | package=random_toml | package | random_toml/pyproject.toml | cannot be read
check | package=nul_toml | package | nul_toml/pyproject.toml | cannot be read
check | package=deep_toml | package | deep_toml/pyproject.toml | cannot be read
check | package=number_toml | package | number_toml/pyproject.toml | register a class
check | package=points_toml | package | points_toml/pyproject.toml | register a class
check | package=group_toml | package | group_toml/pyproject.toml | register a class
check | package=value_toml | package | value_toml/pyproject.toml | <class>
check | package=word_toml | package | word_toml/pyproject.toml | <class>
check | package=lines_toml | package | lines_toml/pyproject.toml | letters
check | package=gone_toml | method | own | not_there
check | package=other_toml | method | own | subclasses
check | package=lacks_toml | method | own | attribute
check | package=raises_toml | method | own | ZeroDivisionError
check | package=taken_toml | method | ls | of that name
check | package=system_toml | system | own | ZeroDivisionError
check | package=sdof method.x=1 | method.x | 1 | no method
check | package=ls system.zz=1 | system.zz | 1 | no system
check | package=chain system.n=true | system.n | True | whole number
check | package=ls method.zz=1 | method.zz | 1 | settings of ls
check | package=ls method.bootstrap=1 method.bootstrap=2 | method.bootstrap | 2 | twice
petab | snr=10,20 | snr | 10,20 | several
petab | method=ls | method | ls | not a field
petab | system=sdof_forced | system.force | known | free vibration
petab | zz=1 | zz | 1 | not a field
petab | system.samples=1e12 | system.samples | 1000000000000.0 | at most
petab | system.duration=1e20 | system.duration | 1e+20 | at most
petab | out=file | out | file | name another folder
arviz |  | cell |  | identity
arviz | cell=.. | cell | .. | identity
arviz | cell=$LONG | cell | zzzz | identity
arviz | cell=00 store=store archive=none | cell | 00 | no such cell
arviz | cell=00 out= | out |  | give a value
notebook | method=ls,ekf | method | ls,ekf | several
notebook | method=ls zz=1 | zz | 1 | not a field
notebook | method=ls hydra/launcher=ray | hydra/launcher | ray | not a field
merge | submission=$LONG | submission | zzzz | file not found
merge | submission=store store=store | store | store | with itself
merge | submission=folder | submission | folder | no cell
merge | submission=gigabyte | submission | gigabyte | not a whole submission
merge | submission=bomb.zip | submission | bomb.zip | would unpack to more
merge | submission=cut.zip | submission | cut.zip | not a whole submission
merge | submission=list.submission | submission | list.submission | not a whole submission
merge | submission=deep.submission | submission | deep.submission | not a whole submission
merge | submission=latin.submission | submission | latin.submission | not a whole submission
merge | submission=later.submission | submission | later.submission | of format 99
merge | submission=nothing.submission | submission | nothing.submission | holds no cell
merge | submission=files.submission | submission | files.submission | not a whole submission
merge | submission=digest.submission | submission | digest.submission | damaged
merge | submission=lacking.submission | submission | lacking.submission | not a whole submission
merge | submission=more.submission | submission | more.submission | not a whole submission
merge | submission=above.submission | submission | above.submission | belongs in none
merge | submission=absolute.submission | submission | absolute.submission | belongs in none
merge | submission=backslash.submission | submission | backslash.submission | belongs in none
merge | submission=nameless.submission | submission | nameless.submission | belongs in none
merge | submission=folder.submission | submission | folder.submission | belongs in none
merge | submission=below.submission | submission | below.submission | belongs in none
merge | submission=bound.submission | submission | bound.submission | belongs in none
merge | submission=longname.submission | submission | longname.submission | belongs in none
merge | submission=double.submission | submission | double.submission | not a whole submission
merge | submission=link.submission | submission | link.submission | damaged
merge | submission=encrypted.submission | submission | encrypted.submission | not a whole submission
merge | submission=implode.submission | submission | implode.submission | not a whole submission
merge | submission=stored.submission | submission | stored.submission | not a whole submission
merge | submission=tight.submission | submission | tight.submission | more than 64 MB
merge | submission=manifest.submission | submission | manifest.submission | more than 64 MB
merge | submission=huge.submission | submission | huge.submission | more than 64 MB
merge | submission=arrays.submission | submission | arrays.submission | damaged
merge | submission=long.submission | submission | long.submission | by in its manifest
merge | submission=number.submission | submission | number.submission | by in its manifest
merge | submission=bell.submission | submission | bell.submission | by in its manifest
merge | submission=methodless.submission | submission | methodless.submission | method in its manifest
merge | submission=vacant.submission | submission | vacant.submission | damaged
merge | submission=json.submission | submission | json.submission | damaged
merge | submission=identity.submission | submission | identity.submission | damaged
merge | submission=elsewhere.submission | submission | elsewhere.submission | damaged
report | store=store out=file | out | file | new, empty
report | store=store out=store | out | store | new, empty
report | store=store out=. | out | . | new, empty
submit | method=oracle store=store | method | oracle | one of
atlas | test=free_decay,forced dry_run=true | test | free_decay,forced | or forced
atlas | test=forced part=phase dry_run=true | part | phase | some of
atlas | test=forced method=shooting dry_run=true | method | shooting | some of
atlas | method=ls, dry_run=true | method | ls, | comma
atlas | shard=1/0 dry_run=true | shard | 1/0 | 3/10
atlas | shard=1/2/3 dry_run=true | shard | 1/2/3 | 3/10
atlas | points=999999999999 dry_run=true | points | 999999999999 | from 1
atlas | fit=false points=8 part=points method=ls store=folder | store | folder | finished blocks
submit | method=zz | method | zz | one of
submit | method=ls store=missing | store | missing | folder not found
submit | method=ls store=store | method | ls | no cell
submit | method=ls store=store experiment=zz | experiment | zz | known
"""

RECORDS = """
# a record that is no record | a part of what is said of it
empty | empty
random | binary
nuls | empty
gigabyte | MiB
long.csv | rows
wide.csv | columns
oneline | columns
onecell | columns
quoted.csv |
header.csv | no rows of numbers
words.txt | no rows of numbers
onerow.csv |
onecolumn.csv | rate=
backwards.csv | time goes back
standing.csv | rate=
notimes.csv |
novalues.csv |
hugevalues.csv | in SI
tinyvalues.csv | in SI
hugetimes.csv | in SI
infinite.csv |
ragged.csv | numbers are needed
brokenrow.csv | numbers are needed
dates.csv |
thousands.csv | thousands
commas.csv | decimal
samenames.csv |
kilograms.csv |
nulinside.csv | binary
bell.csv | binary
halfutf16.csv |
page.html |
list.json |
picture.png | binary
cut.gz | gzip
bomb.gz | MiB
plain.zip | zip
bomb.zip | MiB
cut.zip | damaged
bomb.xlsx | MiB
sheetless.xlsx | damaged
cut.npy |
objects.npy | objects
hugeshape.npy | rows
manydimensions.npy |
badheader.npy | damaged
negative.npy |
words.npy |
pickled.npz | objects
cut.parquet | damaged
words.parquet |
old.xls | xls
new.mat | 7.3
cut.mat |
cut.tdms | damaged
cut.uff |
other.uff | 58
"""


TRACKS = ("measured", "online", "atlas")
"""Commands that are experiments of ``python -m bench``."""


SHARED = ("submit", "merge", "publish")
FORMS = ("petab", "arviz", "notebook")


def entry(command: str) -> list[str]:
    """Return the words that come first on the line of a command."""
    if command in TRACKS:
        return ["-m", f"experiment={command}"]
    if command in FORMS:
        return ["share", "action=export", f"form={command}"]
    return ["share", f"action={command}"] if command in SHARED else [] if command == "bench" else [command]


def all_malformed() -> list[Malformed]:
    """The whole table, each line once."""
    found = [*_generated(), *_written(), *_records()]
    return list({(one.command, one.arguments): one for one in found}.values())


def _generated() -> Iterator[Malformed]:
    for one in FIELDS:
        beside = [word for word in one.beside.split() if not word.startswith(f"{one.name}=")]
        for value in one.kind:
            yield Malformed(one.command, (*beside, f"{one.name}={value}"), one.name, value)


def _rows(table: str) -> Iterator[list[str]]:
    for line in table.strip().splitlines():
        if not line.startswith("#"):
            yield [cell.strip() for cell in line.split("|")]


def _filled(line: str) -> str:
    """A written line with the words that stand for others."""
    words = {"$FORCE": FORCE, "$DECAY": DECAY, "$TEST": TEST, "$NOMINAL": NOMINAL, "$LONG": LONG}
    for name, text in words.items():
        line = line.replace(name, text)
    return line


def _written() -> Iterator[Malformed]:
    for row in _rows(WRITTEN):
        command, line, field, value, remedy = row
        words = re.findall(r"(?:'[^']*'|[^\s'])+", _filled(line))
        yield Malformed(command, tuple(word.replace("'", "") for word in words), field, value or None, remedy)


def _records() -> Iterator[Malformed]:
    for name, said in _rows(RECORDS):
        yield Malformed("bench", ("method=ls", f"data={name}"), "data", name, said)
