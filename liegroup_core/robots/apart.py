# SPDX-License-Identifier: Apache-2.0
"""Tools that expand or compile a file, each in a confined process with bounded time and memory.

    python -m liegroup_core.robots.apart FOLDERS xacro FILE [NAME:=VALUE ...]   prints the expanded XML
    python -m liegroup_core.robots.apart FOLDERS mjcf FILE                      prints the compiled model as JSON
    python -m liegroup_core.robots.apart FOLDERS meshes FILE                    prints triangles as JSON

Besides Python itself, the process may read only FOLDERS, separated by colons (confined.py). A wrong or
hostile file can neither crash the calling process nor do other harm. If a tool fails, it prints its message
to stderr, and the place "file:line", if known, to stdout.
"""

import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from contextlib import suppress
from itertools import count
from pathlib import Path
from xml.dom import expatbuilder, minidom

from liegroup_core.errors import MissingFileError, SceneError
from liegroup_core.fields.values import suggestion

from .access import outside, trees
from .confined import Unconfined, confine
from .description import refusal
from .expressions import evaluate
from .resources import find_package, packages_around

SECONDS = 60
BYTES = 2**30  # in memory; the largest models of dm_control take 0.5 GB
ADDRESSES = 8 * 2**30  # mapped; MuJoCo maps 3.4 GB for dm_control's rodent and uses 0.1 GB of it
LOOK = 0.02  # s between checks of the memory of a tool
LARGEST_OUTPUT = 32 * 2**20  # bytes; large models have 1 MB, and ten times as much when they are parsed
MISSING = 3  # exit code: the package of the tool is not installed
ADVISED = 4  # exit code: the message says what to do
ABSENT = 5  # exit code: the message says what to do about a missing file
FORBIDDEN = 6  # exit code: the message is the name of a file that may not be read
UNSAFE = 7  # exit code: the process cannot be confined
# Folders of the system's libraries, and the cache file that the loader reads.
LIBRARIES = ("/usr/lib", "/usr/lib64", "/lib", "/lib64", "/usr/local/lib", "/etc/ld.so.cache")
# Texts in the tools' messages that indicate a lack of memory.
NO_MEMORY = ("MemoryError", "bad_alloc", "Could not allocate memory", "unknown exception")
REFLECTING = ("vars", "type")  # of xacro's namespace `python`
MOST_CALLS = 20_000  # of macros, 10 s; the largest robots have hundreds
PACKAGES = {"xacro": "xacro", "mjcf": "mujoco", "meshes": "trimesh"}


def run_apart(tool, path, arguments=(), folders=None):
    """Text that a tool prints for a file. Raises SceneError with the tool's own message.

    folders : folders that the tool may read; None: those of access.trees
    """
    readable = os.pathsep.join(map(str, trees(path) if folders is None else folders))
    command = [sys.executable, "-P", "-m", __name__, readable, tool]
    command += [str(Path(path).resolve()), *arguments]
    folders = [str(Path(__file__).resolve().parents[2]), os.environ.get("PYTHONPATH", "")]
    # MuJoCo writes a log into the working folder.
    with tempfile.TemporaryDirectory() as folder:
        texts = [Path(folder, name) for name in ("output", "errors")]
        with texts[0].open("wb") as output, texts[1].open("wb") as errors:
            returncode = _ended(
                command,
                cwd=folder,
                env=os.environ
                | {"PYTHONPATH": os.pathsep.join(filter(None, folders))}
                | {"OPENBLAS_NUM_THREADS": "1"},  # OpenBLAS allocates a buffer for each thread
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=errors,
            )
        found, problems = (_head(text) for text in texts)
    if returncode is None:
        raise refusal(path, 0, f"{tool} did not end within {SECONDS} s: make the file smaller")
    if len(found) >= LARGEST_OUTPUT:
        raise refusal(path, 0, f"{tool} wrote more than {LARGEST_OUTPUT >> 20} MiB: make the file smaller")
    if returncode == 0:
        return found.decode(errors="replace")
    if returncode == MISSING:
        package = PACKAGES[tool]
        raise refusal(path, 0, f"is read by the package {package}, which is not installed: pip install {package}")
    text = [line for line in problems.decode(errors="replace").splitlines() if line.strip()]
    if returncode == FORBIDDEN:
        raise refusal(path, 0, f"{tool}: {text[-1][-400:]} is not read: {outside(path)}")
    if returncode == UNSAFE:
        raise refusal(path, 0, f"{tool} is not run, because it cannot be confined: {' '.join(text)[-400:]}")
    if returncode < 0 or any(sign in line for sign in NO_MEMORY for line in text):
        raise refusal(path, 0, f"{tool} needs more than {BYTES >> 30} GiB of memory, or crashes: simplify the file")
    file, _, line = found.decode(errors="replace").strip().rpartition(":")
    if not line.isdecimal() or file == str(Path(path).resolve()):
        file = path
    line = int(line) if line.isdecimal() else 0
    advice = "" if returncode in (ADVISED, ABSENT) else "; correct the file"
    kind = MissingFileError if returncode == ABSENT else SceneError
    raise refusal(file, line, f"{tool}: {(' '.join(text) or 'failed')[-400:]}{advice}", kind)


def triangulated(order, folders):
    """Dict that the tool meshes finds for an order, see meshes.py. Raises SceneError with the tool's own message."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "shapes.json")
        path.write_text(json.dumps(order))
        return json.loads(run_apart("meshes", path, folders=[*folders, folder]))


def _ended(command, **options):
    """Exit code of a command, or None if it was killed after SECONDS.

    A command with more than BYTES in memory is killed as well; its exit code is that of the signal.
    """
    end, page, late = time.monotonic() + SECONDS, resource.getpagesize(), False
    with subprocess.Popen(command, **options) as process:
        try:
            while process.poll() is None and not late:
                late = time.monotonic() > end
                if late or _pages(process.pid) * page > BYTES:
                    process.kill()
                    process.wait()
                else:
                    with suppress(subprocess.TimeoutExpired):
                        process.wait(LOOK)
        finally:
            process.kill()  # no effect if it has ended
    return None if late else process.returncode


def _pages(number):
    """Number of pages that a process has in memory."""
    try:
        return int(Path(f"/proc/{number}/statm").read_text().split()[1])
    except (OSError, IndexError):  # it has just ended, or the system has no /proc
        return 0


def _head(path):
    """First LARGEST_OUTPUT bytes of a file; _bound limits the output of a tool to this size."""
    with path.open("rb") as file:
        return file.read(LARGEST_OUTPUT)


def _bound():
    """Limit memory, time and output of this process."""
    for kind, limit in (
        (resource.RLIMIT_AS, ADDRESSES),
        (resource.RLIMIT_CPU, SECONDS),
        (resource.RLIMIT_FSIZE, LARGEST_OUTPUT),
    ):
        hard = resource.getrlimit(kind)[1]
        limit = limit if hard == resource.RLIM_INFINITY else min(limit, hard)
        resource.setrlimit(kind, (limit, hard))


def _confine(folders):
    """Give up all rights except reading below these folders and Python's own folders."""
    own = [*sys.path, sys.prefix, sys.base_prefix, *LIBRARIES]
    confine([*folders, *filter(None, own)])


def _expand(folders, path, *arguments):
    """Expanded XML of a xacro file; arguments: NAME:=VALUE, as for the command xacro."""
    import xacro
    from xacro import substitution_args

    def of_eval(text, context):
        """Value of $(eval ...), where names are those of arguments and of a few functions."""
        names = substitution_args._DictWrapper(context["arg"], substitution_args._eval_dict)
        return str(evaluate(text, names, ()))

    around = packages_around(path)

    def find(name):
        return str(find_package(name, path, around))

    substitution_args._eval_find = substitution_args._eval_dict["find"] = find
    # These functions give access to the internals of objects.
    for name in REFLECTING:
        xacro._global_symbols["python"].pop(name, None)
    spaces = (xacro.NameSpace, xacro.YamlDictWrapper)
    xacro.safe_eval = lambda text, symbols, more=None: evaluate(text, more or symbols, spaces)
    substitution_args._eval = of_eval
    expand, calls = xacro.handle_macro_call, count()

    def bounded(*given):
        if next(calls) > MOST_CALLS:
            raise SceneError(f"macros are called more than {MOST_CALLS} times: make the file smaller")
        return expand(*given)

    xacro.handle_macro_call = bounded
    _confine(folders)
    expatbuilder.ExpatBuilderNS = _PlacedBuilder  # minidom builds its elements with this class
    given = _Arguments(text.split(":=", 1) for text in arguments)
    names = set(given)
    expanded = xacro.process_file(path, mappings=given)
    for name in sorted(names - given.asked):
        known = sorted(given.asked)
        hint = suggestion(name, known) if known else "it has none"
        raise SceneError(f"argument {name!r:.60} is not used by the file; {hint}")
    return expanded.toprettyxml(indent="  ")


class _Arguments(dict):
    """Arguments of a xacro file; asked: names that the file declares or uses."""

    def __init__(self, given):
        super().__init__(given)
        self.asked = set()

    def __contains__(self, name):
        self.asked.add(name)
        return super().__contains__(name)

    def __getitem__(self, name):
        self.asked.add(name)
        return super().__getitem__(name)


class _PlacedBuilder(expatbuilder.ExpatBuilderNS):
    """Builder of elements with the attribute `place`, "file:line"."""

    def parseFile(self, file):
        self.file = Path(file.name).resolve()
        return super().parseFile(file)

    def start_element_handler(self, *arguments):
        super().start_element_handler(*arguments)
        self.curNode.place = f"{self.file}:{self.getParser().CurrentLineNumber}"


def _place(error):
    """Place of the element that was being processed when the error was raised; "" if unknown."""
    place, trace = "", error.__traceback__
    while trace is not None:
        for value in trace.tb_frame.f_locals.values():
            place = getattr(value, "place", place) if isinstance(value, minidom.Node) else place
        trace = trace.tb_next
    return place


def _compile(folders, path):
    """Compiled MJCF as JSON."""
    from .mjcf_model import arrays_of

    _confine(folders)
    return json.dumps(arrays_of(path))


def _triangulate(folders, path):
    """Triangles of the shapes of a robot, or hulls, as JSON."""
    from .meshes import hulls_of, triangles_of

    order = json.loads(Path(path).read_text())
    if any(asset >= 0 for *_, asset in order.get("hulls") or order["shapes"]):
        from . import mjcf_model  # noqa: F401  a confined process cannot load MuJoCo
    _confine(folders)
    return json.dumps(hulls_of(order) if "hulls" in order else triangles_of(order))


def main(folders, tool, *arguments):
    """Print the result, or the reason of failure in one line; returns the exit code."""
    _bound()
    tools = {"xacro": _expand, "mjcf": _compile, "meshes": _triangulate}
    try:
        print(tools[tool](folders.split(os.pathsep), *arguments))
    except Unconfined as error:
        print(error, file=sys.stderr)
        return UNSAFE
    except ModuleNotFoundError as error:
        if error.name == PACKAGES[tool]:
            return MISSING
        print(f"{type(error).__name__}: {error}", file=sys.stderr)
        return 1
    except SystemExit:
        return 1
    except SceneError as error:
        print(error, file=sys.stderr)
        return ABSENT if isinstance(error, MissingFileError) else ADVISED
    except RecursionError:
        print("it contains itself, or is nested too deep", file=sys.stderr)
        return 1
    except Exception as error:  # tools raise errors of any type; their text is the message
        forbidden = _forbidden(error)
        if forbidden:
            print(forbidden, file=sys.stderr)
            return FORBIDDEN
        print(_place(error))
        print(_reason(error), file=sys.stderr)
        return ADVISED if isinstance(_cause(error), SceneError) else 1
    return 0


def _forbidden(error):
    """Name of the file that caused an error because it may not be read, else None."""
    while error is not None:
        if isinstance(error, PermissionError) and error.filename:
            return error.filename
        error = getattr(error, "exc", None) or error.__cause__ or error.__context__
    return None


def _cause(error):
    """Error that errors of xacro repeat, or contain."""
    while getattr(error, "exc", None) is not None:
        error = error.exc
    return error


def _reason(error):
    """Text of an error in one line. Errors of xacro repeat their cause, or contain only its type."""
    cause = _cause(error)
    text = " ".join(str(cause).split()) or type(cause).__name__
    around = " ".join(str(error).split()).replace(f"{type(cause)}: ", "")
    head, *rest = around.split(text)
    if not rest:
        return f"{text} {around}"
    return " ".join(filter(None, (part.strip() for part in (head, text, *rest))))


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
