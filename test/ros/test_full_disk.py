# SPDX-License-Identifier: Apache-2.0
"""Outputs of commands that do not fit on the disk: one line, exit code 2, and nothing that looks complete."""

import contextlib
import resource

import pytest
from scene_files import text_of

from liegroup_sim_ros.commands.main import main
from liegroup_sim_ros.commands.run import EXIT_LOST
from liegroup_sim_ros.recording import write_run

LIMIT = 3000  # bytes; a larger file is refused as by a full disk
RUN = ("run", "heavy_top", "--method", "rkmk4", "--duration", "1.5")
DRIVEN = text_of("turned.yaml")


@contextlib.contextmanager
def full_disk():
    """No file may become larger than LIMIT; Python ignores the signal that this raises."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (LIMIT, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    """Recording of a run; its kernels are compiled, which would write to the disk."""
    folder = tmp_path_factory.mktemp("log")
    assert main([*RUN, "--out", str(folder / "run.mcap")]) == 0
    assert main([*RUN, "--reactions", "--out", str(folder / "run.npz")]) == 0
    (folder / "driven.yaml").write_text(DRIVEN)
    driven = ["run", str(folder / "driven.yaml"), "--method", "rkmk4", "--duration", "1.5"]
    assert main([*driven, "--torques", str(folder / "torques.csv")]) == 0
    return folder / "run.mcap"


@pytest.fixture
def folder(tmp_path, log):
    """An empty folder."""
    return tmp_path


def refused(capsys, arguments, name):
    """Run a command on a full disk; it ends with one line that names the file."""
    capsys.readouterr()
    with full_disk():
        code = main(list(map(str, arguments)))
    err = capsys.readouterr().err
    last = err.splitlines()[-1]
    assert code == 2 and last.startswith("liegroup_sim: ") and "File too large" in last, err
    assert name in last and err.count("File too large") == 1 and "Traceback" not in err


@pytest.mark.parametrize("name", ["run.npz", "run.csv", "run.mcap"])
@pytest.mark.turn(3)
def test_a_run_leaves_no_file(folder, capsys, name):
    refused(capsys, [*RUN, "--out", folder / name], name)
    assert list(folder.iterdir()) == []


def test_neither_of_two_tables_is_left(folder, log, capsys):
    run = ["run", log.parent / "driven.yaml", "--method", "rkmk4", "--duration", "1.5"]
    files = ["--out", folder / "run.csv", "--torques", folder / "torques.csv"]
    refused(capsys, [*run, *files], ".csv")
    assert list(folder.iterdir()) == []


def test_a_sweep_leaves_no_folder_and_keeps_finished_runs(folder, capsys):
    sweep = ["sweep", "heavy_top", "--method", "rkmk4", "--duration", "0.01", "--samples", "4"]
    sweep += ["--vary", "bodies.top.mass=1:2", "--workers", "1", "--out", folder / "a.parquet"]
    refused(capsys, sweep, "a.parquet")
    assert list(folder.iterdir()) == []
    assert main(list(map(str, sweep))) == 0 and len(list((folder / "a.parquet").iterdir())) > 0


@pytest.mark.parametrize("name", ["a.html", "a.json", "a.png"])
@pytest.mark.volume(1)
def test_a_report_of_before_is_kept(folder, log, capsys, name):
    """Without one there is no file."""
    kind = "--" + name.partition(".")[2]
    analyze = ["analyze", log, "--no-reference", kind, folder / name]
    refused(capsys, analyze, name)
    assert list(folder.iterdir()) == []
    (folder / name).write_text("precious")
    (folder / name).chmod(0o640)
    refused(capsys, analyze, name)
    assert [each.read_text() for each in folder.iterdir()] == ["precious"]
    assert main(list(map(str, analyze))) == 0
    assert (folder / name).stat().st_size > LIMIT and (folder / name).stat().st_mode & 0o777 == 0o640


def test_what_is_no_file_is_written_directly(log, capsys):
    analyze = ["analyze", str(log), "--no-reference", "--json"]
    assert main([*analyze, "/dev/null"]) == 0
    assert main([*analyze, "/dev/full"]) == 2
    assert "/dev/full: cannot be written: No space left on device" in capsys.readouterr().err


def test_a_run_whose_recording_is_removed_says_so(folder, capsys, monkeypatch):
    """Exit code 1 and one line; the run ends when the loss is known."""
    path, sample = folder / "run.mcap", write_run.LogFile.sample

    def removing(self, one):
        sample(self, one)
        path.unlink(missing_ok=True)

    monkeypatch.setattr(write_run.LogFile, "sample", removing)
    assert main([*RUN, "--out", str(path)]) == EXIT_LOST == 1
    err = capsys.readouterr().err
    assert err.count("the file was removed or renamed") == 1 and "Traceback" not in err
    assert str(path) in err and "continues" not in err and not path.exists()
