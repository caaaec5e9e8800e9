"""The files that malformed input names: records, scenarios, states; each is made where a test first asks for it."""

from __future__ import annotations

import gzip
import io
import json
import os
import pickle
import stat
import warnings
import zipfile
import zlib
from collections.abc import Callable
from hashlib import sha256
from pathlib import Path

import numpy as np

from bench.store.seal import sealed

DECAY = [(0.1 * i, np.exp(-0.1 * i) * np.cos(2.0 * i)) for i in range(60)]
SDOF = """label: own
kind: sdof
options: {}
parameters: {m: 1.0, c: 0.4, k: 8.0}
initial: {displacement: [1.0], velocity: [0.0]}
duration: 10.0
samples: 25
force: null
"""
GOOD = "t (s),x (m)\n" + "".join(f"{t:.1f},{x:.6f}\n" for t, x in DECAY)


def rows(change: Callable[[int, float, float], str], header: str = "t (s),x (m)") -> bytes:
    """The good record with each of its rows changed."""
    return "\n".join([header, *(change(i, t, x) for i, (t, x) in enumerate(DECAY)), ""]).encode()


def npy(array: np.ndarray) -> bytes:
    """An array as a file; objects are pickled."""
    file = io.BytesIO()
    np.save(file, array, allow_pickle=True)
    return file.getvalue()


def npy_header(header: str) -> bytes:
    """A file of arrays with a header of one's own and eight bytes of data."""
    text = header.encode().ljust(118) + b"\n"
    return b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text + b"\0" * 8


def zipped(**members: bytes) -> bytes:
    """A zip file."""
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in members.items():
            archive.writestr(name.replace("__", "/").replace("_dot_", "."), content)
    return file.getvalue()


def gzip_bomb(size: int) -> bytes:
    """So many zeros, packed."""
    packer = zlib.compressobj(9, zlib.DEFLATED, 31)
    block = b"0" * 2**20
    return b"".join([*(packer.compress(block) for _ in range(size // len(block))), packer.flush()])


def zip_bomb(name: str) -> bytes:
    """A zip file that says of its one member that it unpacks to 4 GB."""
    data = bytearray(zipped(**{name: b"0" * 1000}))
    for mark, offset in ((b"PK\x03\x04", 22), (b"PK\x01\x02", 24)):
        place = data.index(mark) + offset
        data[place : place + 4] = (2**32 - 2).to_bytes(4, "little")
    return bytes(data)


IDENTITY = "0123456789abcdef0123"


def submission(*members: tuple[str, bytes], **stated: object) -> bytes:
    """A submission of files by name, each with its checksum in the manifest."""
    manifest = {"format": 1, "method": "ls", "files": {name: sha256(one).hexdigest() for name, one in members}}
    return archive(("manifest.json", json.dumps({**manifest, **stated}).encode()), *members)


def archive(*members: tuple[str, bytes], method: int = zipfile.ZIP_DEFLATED, link: bool = False) -> bytes:
    """A zip file of any names, some of them twice; ``link``: each says that it is a symbolic one."""
    file = io.BytesIO()
    with warnings.catch_warnings(), zipfile.ZipFile(file, "w", method) as found:
        warnings.simplefilter("ignore")
        for name, content in members:
            info = zipfile.ZipInfo(name)
            info.compress_type = method
            info.external_attr = (stat.S_IFLNK | 0o777) << 16 if link and name != "manifest.json" else 0
            found.writestr(info, content)
    return file.getvalue()


def with_flags(content: bytes, bits: int = 0, method: int = 8) -> bytes:
    """A zip file whose members state these flags and this method of compression."""
    data = bytearray(content)
    for mark, offset in ((b"PK\x03\x04", 6), (b"PK\x01\x02", 8)):
        place = -1
        while (place := data.find(mark, place + 1)) >= 0:
            data[place + offset : place + offset + 4] = bits.to_bytes(2, "little") + method.to_bytes(2, "little")
    return bytes(data)


def cell(**changes: object) -> tuple[str, bytes]:
    """A sealed file of a cell that states almost nothing, and what is to be changed of it."""
    rows = {name: [0] for name in ("replicate", "evaluations", "wall_s", "cpu_s", "peak_memory_mb")}
    content: dict[str, object] = {
        "identity": IDENTITY, "cell": {"method": "ls", "label": "ls", "system": "sdof", "snr_db": 20.0},
        "rows": {**rows, "status": ["ok"], "message": [""], "data": [""], "scores": {"rmse": [0.1]}},
        "summary": {}, "prior_share": {}, "identifiable": {}, "wall_s": 0.0, "provenance": {}, "version": {},
        "arrays": "",
    }  # fmt: skip
    return f"rows/{IDENTITY}.json", sealed(3, json.dumps({**content, **changes}))


def arrays_bomb() -> tuple[tuple[str, bytes], tuple[str, bytes]]:
    """A cell with arrays that unpack to 4 GB."""
    content = zip_bomb("times.npy")
    name = f"{IDENTITY}.{sha256(content).hexdigest()[:16]}.npz"
    return cell(arrays=name), (f"rows/{name}", content)


def parquet(columns: dict[str, list[object]]) -> bytes:
    """A Parquet file of columns."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    sink = io.BytesIO()
    pq.write_table(pa.table(columns), sink)
    return sink.getvalue()


def mat() -> bytes:
    """A MATLAB file with a record."""
    from scipy.io import savemat

    file = io.BytesIO()
    savemat(file, {"t": np.arange(60.0), "x": np.arange(60.0)}, do_compression=True)
    return file.getvalue()


def uff(kind: int) -> bytes:
    """A universal file with the beginning of a data set of a kind."""
    return f"    -1\n{kind:6d}\nNONE\nNONE\nNONE\nNONE\n    -1\n".encode()


def aliases(levels: int) -> str:
    """A scenario of nine to the power of ``levels`` words, by aliases."""
    lines = ["a0: &a0 [x, x, x, x, x, x, x, x, x]"]
    lines += [f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]" for i in range(1, levels)]
    return SDOF + "\n".join(lines) + "\n"


def words(text: str) -> Callable[[], bytes]:
    """A maker of a text."""
    return lambda: text.encode()


FILES: dict[str, Callable[[], bytes]] = {
    "good.csv": words(GOOD),
    "file": words("precious\n"),
    "empty": words(""),
    "random": lambda: np.random.default_rng(0).bytes(4096),
    "zeros": lambda: bytes(100_000),
    "nuls": lambda: bytes(2**20),
    "long.csv": lambda: b"t,x\n" + b"1,2\n" * 1_100_000,
    "wide.csv": lambda: b"\n".join([b"1," * 20_000] * 30),
    "oneline": lambda: b"1 " * 2_000_000,
    "onecell": lambda: b"1" * 2_000_000,
    "quoted.csv": lambda: b't,x\n1,"' + b"2\n" * 100_000,
    "header.csv": words("t (s),x (m)\n"),
    "words.txt": words("nothing but words\nand more of them\n"),
    "onerow.csv": words("t (s),x (m)\n0,1\n"),
    "fewrows.csv": words("t (s),x (m)\n0,1\n1,2\n2,1\n"),
    "onecolumn.csv": lambda: rows(lambda i, t, x: f"{x:.4f}", "x (m)"),
    "backwards.csv": lambda: rows(lambda i, t, x: f"{-t:.1f},{x:.4f}"),
    "standing.csv": lambda: rows(lambda i, t, x: f"1.0,{x:.4f}"),
    "notimes.csv": lambda: rows(lambda i, t, x: f"nan,{x:.4f}"),
    "novalues.csv": lambda: rows(lambda i, t, x: f"{t:.1f},nan"),
    "constant.csv": lambda: rows(lambda i, t, x: f"{t:.1f},1.0"),
    "hugevalues.csv": lambda: rows(lambda i, t, x: f"{t:.1f},{x * 1e300:.4e}"),
    "tinyvalues.csv": lambda: rows(lambda i, t, x: f"{t:.1f},{x * 1e-300:.4e}"),
    "hugetimes.csv": lambda: rows(lambda i, t, x: f"{t * 1e300:.4e},{x:.4f}"),
    "infinite.csv": lambda: rows(lambda i, t, x: f"{t:.1f},inf"),
    "ragged.csv": lambda: rows(lambda i, t, x: f"{t:.1f},{x:.4f}" + ",1" * (i % 3 == 1)),
    "brokenrow.csv": lambda: rows(lambda i, t, x: f"{t:.1f},{'oops' if i == 30 else x}"),
    "dates.csv": lambda: rows(lambda i, t, x: f"2026-11-{i % 28 + 1:02d} 10:00,{x:.4f}"),
    "thousands.csv": lambda: rows(lambda i, t, x: f"{i};1,{i + 100}", "t;x"),
    "commas.csv": lambda: rows(lambda i, t, x: f"{i % 7},{i * 37 % 100}", ""),
    "samenames.csv": lambda: rows(lambda i, t, x: f"{t:.1f},{x:.4f},{x:.4f}", "t (s),t (s),t (s)"),
    "kilograms.csv": lambda: rows(lambda i, t, x: f"{t:.1f},{x:.4f}", "t (s),x (kg)"),
    "nulinside.csv": lambda: GOOD.encode().replace(b"0.5", b"0\0005", 1),
    "bell.csv": lambda: GOOD.encode().replace(b"0.5", b"0\x075", 1),
    "halfutf16.csv": lambda: GOOD.encode("utf-16")[:-1],
    "page.html": words("<html><body><table><tr><td>1</td><td>2</td></tr></table></body></html>\n" * 20),
    "list.json": words("[" + ", ".join(f"[{t}, {x}]" for t, x in DECAY) + "]"),
    "picture.png": lambda: b"\x89PNG\r\n\x1a\n" + np.random.default_rng(1).bytes(2000),
    "cut.gz": lambda: gzip.compress(GOOD.encode())[:-20],
    "bomb.gz": lambda: gzip_bomb(300 * 2**20),
    "plain.zip": lambda: zipped(record_dot_csv=GOOD.encode()),
    "bomb.zip": lambda: zip_bomb("record.csv"),
    "cut.zip": lambda: zipped(record_dot_csv=GOOD.encode())[:-30],
    "bomb.xlsx": lambda: zip_bomb("xl/workbook.xml"),
    "sheetless.xlsx": lambda: zipped(xl__workbook_dot_xml=b"<workbook/>"),
    "cut.npy": lambda: npy(np.arange(200.0).reshape(-1, 2))[:-100],
    "objects.npy": lambda: npy(np.array([[1, "x"]] * 30, dtype=object)),
    "hugeshape.npy": lambda: npy_header("{'descr': '<f8', 'fortran_order': False, 'shape': (1000000000000,)}"),
    "manydimensions.npy": lambda: npy(np.zeros((5, 5, 5))),
    "badheader.npy": lambda: npy_header("{'descr': __import__('os').system('true')}"),
    "negative.npy": lambda: npy_header("{'descr': '<f8', 'fortran_order': False, 'shape': (-60, 2)}"),
    "words.npy": lambda: npy(np.array(["a", "b"] * 30)),
    "pickled.npz": lambda: zipped(x_dot_npy=npy(np.array([pickle, "x"] * 30, dtype=str).astype(object))),
    "cut.parquet": lambda: parquet({"t": list(range(60)), "x": list(range(60))})[:-40],
    "words.parquet": lambda: parquet({"t": ["a"] * 60, "x": ["b"] * 60}),
    "old.xls": lambda: b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1" + bytes(600),
    "new.mat": lambda: b"MATLAB 7.3 MAT-file".ljust(600),
    "cut.mat": lambda: mat()[:-60],
    "cut.tdms": lambda: b"TDSm" + bytes(40),
    "cut.uff": lambda: uff(58),
    "other.uff": lambda: uff(15),
    "empty.yaml": words(""),
    "random.yaml": lambda: np.random.default_rng(2).bytes(4096),
    "list.yaml": words("[1, 2]\n"),
    "number.yaml": words("3\n"),
    "tabs.yaml": words("label:\n\t- x: [\n"),
    "bomb.yaml": lambda: aliases(9).encode(),
    "cycle.yaml": words(SDOF.replace("{}", "&o {again: *o}")),
    "deep.yaml": words(SDOF.replace("{}", "{a: " + "[" * 20_000 + "]" * 20_000 + "}")),
    "tag.yaml": words("!!python/object/apply:os.system ['true']\n"),
    "twice.yaml": words(SDOF + "label: again\n"),
    "numbers.yaml": words("1: 2\n3.5: 4\nnull: 5\n"),
    "unknown.yaml": words(SDOF + "colour: red\n"),
    "half.yaml": words(SDOF.replace("c: 0.4, ", "")),
    "nomass.yaml": words(SDOF.replace("m: 1.0, ", "q: 1.0, ")),
    "base.yaml": words("defaults: [nowhere]\n" + SDOF),
    "basenumber.yaml": words("defaults: 3\n" + SDOF),
    "itself.yaml": words("defaults: [itself]\n" + SDOF),
    "other.yaml": words("defaults: [/method: pinn]\n" + SDOF),
    "interpolated.yaml": words(SDOF.replace("own", "${nowhere}")),
    "secret.yaml": words(SDOF.replace("own", "${oc.env:HOME}")),
    "wrongprior.yaml": words(SDOF + "default_prior: zz\n"),
    "nullparameters.yaml": words(SDOF.replace("{m: 1.0, c: 0.4, k: 8.0}", "null")),
    "text.yaml": words(SDOF.replace("m: 1.0", "m: heavy")),
    "flag.yaml": words(SDOF.replace("m: 1.0", "m: true")),
    "infinite.yaml": words(SDOF.replace("m: 1.0", "m: .inf")),
    "kind.yaml": words(SDOF.replace("kind: sdof", "kind: [sdof]")),
    "list.submission": lambda: archive(("manifest.json", b"[1]")),
    "deep.submission": lambda: archive(("manifest.json", b"[" * 100_000)),
    "latin.submission": lambda: archive(("manifest.json", b"\xf6")),
    "later.submission": lambda: submission(format=99),
    "nothing.submission": lambda: submission(),
    "files.submission": lambda: submission(files=3),
    "digest.submission": lambda: submission(cell(), files={cell()[0]: 3}),
    "lacking.submission": lambda: submission(files={cell()[0]: "0" * 64}),
    "more.submission": lambda: archive(("manifest.json", b'{"format": 1, "files": {}}'), cell()),
    "above.submission": lambda: submission(("rows/../../above.json", b"{}")),
    "absolute.submission": lambda: submission(("/tmp/absolute.json", b"{}")),
    "backslash.submission": lambda: submission(("rows\\..\\above.json", b"{}")),
    "nameless.submission": lambda: submission(("", b"{}")),
    "folder.submission": lambda: submission(("rows/", b"")),
    "below.submission": lambda: submission((f"rows/bounds/{IDENTITY}.json", b"{}")),
    "bound.submission": lambda: submission((f"rows/{IDENTITY}.bound", b"{}")),
    "longname.submission": lambda: submission((f"rows/{'0' * 60_000}.json", b"{}")),
    "double.submission": lambda: submission(cell(), cell()),
    "link.submission": lambda: archive(
        ("manifest.json", json.dumps({"format": 1, "files": {cell()[0]: sha256(b"/etc/passwd").hexdigest()}}).encode()),
        (cell()[0], b"/etc/passwd"),
        link=True,
    ),
    "encrypted.submission": lambda: with_flags(submission(cell()), bits=1),
    "implode.submission": lambda: with_flags(submission(cell()), method=6),
    "stored.submission": lambda: with_flags(submission(cell()), method=0),
    "tight.submission": lambda: submission((f"rows/{IDENTITY}.json", bytes(100 * 2**20))),
    "manifest.submission": lambda: archive(("manifest.json", bytes(100 * 2**20))),
    "huge.submission": lambda: zip_bomb("manifest.json"),
    "arrays.submission": lambda: submission(*arrays_bomb()),
    "long.submission": lambda: submission(cell(), by="z" * 65_536),
    "number.submission": lambda: submission(cell(), by=3),
    "bell.submission": lambda: submission(cell(), by="a\x07group"),
    "vacant.submission": lambda: submission((cell()[0], b"")),
    "json.submission": lambda: submission((cell()[0], b"{}")),
    "identity.submission": lambda: submission(cell(identity="0" * 20)),
    "mcmc.submission": lambda: submission(cell(), method="mcmc"),
    "methodless.submission": lambda: submission(cell(), method=None),
    "odd.submission": lambda: submission(cell()),
    "elsewhere.submission": lambda: submission(cell(arrays="../precious.npz")),
    "raising.py": words("raise RuntimeError('no')\n"),
    "leaving.py": words("import sys\nsys.exit(0)\n"),
    "ending.py": words("import os\nos._exit(0)\n"),
    "interrupting.py": words("raise KeyboardInterrupt\n"),
    "printing.py": words("for _ in range(100):\n    print('x' * 2**20)\nraise RuntimeError('no')\n"),
    "sleeping.py": words("import time\ntime.sleep(600)\n"),
    "looping.py": words("while True:\n    pass\n"),
    "recursing.py": words("import recursing\ndef f():\n    f()\nf()\n"),
    "dying.py": words("import os\nos.kill(os.getpid(), 9)\n"),
    "syntax.py": words("class Own(:\n"),
    "nested.py": words("x = " + "(" * 5000 + ")" * 5000 + "\n"),
    "minus.py": words("x = " + "-" * 1_000_000 + "1\n"),
    "latin.py": lambda: "x = 'größe'\n".encode("latin-1"),
    "nul.py": lambda: b"x = 1\n\0\n",
    "binary.py": lambda: np.random.default_rng(3).bytes(4096),
    "nothing.py": words(""),
    "lacking.py": words("import not_installed_anywhere\n"),
    "abstract.py": words("import bench\nclass Own(bench.Identifier):\n    pass\n"),
    "two words.py": words(""),
    "state.json": words("[1, 2]"),
    "deep.json": words("[" * 100_000),
    "otherstate.json": words('{"format": 1, "of": 3, "interval": "x", "samples": [], "tracker": 5}'),
}


def project(content: str | bytes) -> dict[str, bytes]:
    """A package's folder, with a module beside its ``pyproject.toml``."""
    return {"pyproject.toml": content.encode() if isinstance(content, str) else content, "raising.py": b"1 / 0\n"}


TREES: dict[str, dict[str, bytes]] = {
    "filled_toml": project(""),
    "notoml": project("[project\n"),
    "random_toml": project(np.random.default_rng(4).bytes(4096)),
    "number_toml": project("project = 3\n"),
    "points_toml": project("[project]\nentry-points = 3\n"),
    "group_toml": project("[project.entry-points]\n'bench.methods' = 3\n"),
    "value_toml": project("[project.entry-points.'bench.methods']\nown = 3\n"),
    "word_toml": project("[project.entry-points.'bench.methods']\nown = 'nothing'\n"),
    "gone_toml": project("[project.entry-points.'bench.methods']\nown = 'not_there:Own'\n"),
    "other_toml": project("[project.entry-points.'bench.methods']\nown = 'os:system'\n"),
    "lacks_toml": project("[project.entry-points.'bench.methods']\nown = 'os:Own'\n"),
    "raises_toml": project("[project.entry-points.'bench.methods']\nown = 'raising:Own'\n"),
    "taken_toml": project("[project.entry-points.'bench.methods']\nls = 'raising:Own'\n"),
    "system_toml": project("[project.entry-points.'bench.systems']\nown = 'raising:Own'\n"),
    "lines_toml": project("[project.entry-points.'bench.methods']\n\"own = os:system\\nx\" = 'raising:Own'\n"),
    "deep_toml": project("x = " + "[" * 20_000),
    "nul_toml": project(b"[project]\nname = '\0'\n"),
}
FOLDERS = ("folder", "store", "empty", "folder.yaml")
PIPES = ("pipe", "pipe.yaml", "pipe.py")
DEVICES = {"zero.yaml": "/dev/zero", "zero.py": "/dev/zero"}
SPARSE = {"gigabyte": 2**30, "huge.yaml": 2**30}
"""Files of zeros that take no room."""


class Shelf:
    """A folder in which the files are made once, and from which they are linked to where a command runs."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def lay_out(self, place: Path, named: str, store: Path) -> None:
        """Put what a command line names into a folder; ``store`` is one with a cell."""
        for name in {*FILES, *FOLDERS, *TREES, *PIPES, *DEVICES, *SPARSE}:
            if name in named and not (name == "empty" and "store=empty" not in named and "archive=empty" not in named):
                self._put(place / name, store)
        if "empty" in named and not (place / "empty").exists():
            (place / "empty").touch()

    def _put(self, path: Path, store: Path) -> None:
        name = path.name
        if name == "store":
            path.symlink_to(store)
        elif name in FOLDERS:
            path.mkdir()
        elif name in TREES:
            path.mkdir()
            for own, content in TREES[name].items():
                (path / own).write_bytes(content)
        elif name in PIPES:
            os.mkfifo(path)
        elif name in DEVICES:
            path.symlink_to(DEVICES[name])
        elif name in SPARSE:
            with open(path, "wb") as file:
                file.truncate(SPARSE[name])
        else:
            made = self.folder / name
            if not made.exists():
                made.write_bytes(FILES[name]())
            path.symlink_to(made)
