"""The commands give what the command line gives, hear Ctrl-C, and show their progress."""

import os
import signal
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

import eupnea
from eupnea.commands import run


def test_a_recording_is_a_frame_of_pandas_and_of_polars(recording):
    pandas, polars = recording.pandas(), recording.polars()
    assert len(recording) == len(pandas) == len(polars)
    np.testing.assert_array_equal(pandas["pressure"].to_numpy(), recording["pressure"])
    np.testing.assert_array_equal(polars["u_in"].to_numpy(), recording["u_in"])
    assert recording.provenance["plant"] == "R20C20"
    with pytest.raises(KeyError, match="pressure_true"):
        recording["nonsense"]


@pytest.mark.parametrize("package", ["pandas", "polars"])
def test_a_missing_package_of_frames_is_named_with_the_extra_that_installs_it(recording, package, monkeypatch):
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(ImportError, match=rf"{package}: pip install '\./python\[frames\]'"):
        getattr(recording, package)()


def test_the_same_seed_gives_the_same_files_and_a_recording_needs_no_file(recording, tmp_path):
    again = eupnea.collect(breaths=12, seed=3)
    assert not again.path.exists()
    for path in (tmp_path / "again.parquet", str(tmp_path / "string.parquet")):
        assert again.file(path).read_bytes() == recording.path.read_bytes()
    assert eupnea.export(again, tmp_path / "again.jsonl")["rows"] == len(again)
    assert eupnea.judge(again)["pass"]
    assert eupnea.fit(again, epochs=1)["open_loop"] > 0


def test_fit_train_and_evaluate_follow_one_another(recording, simulator, tmp_path):
    fitted = eupnea.fit([recording, recording.path], epochs=2)
    assert fitted["open_loop"] > 0
    trained = eupnea.train(tmp_path / "run", simulator=simulator, gains=(6.5, 265, 0.13), iterations=3, batch=16)
    result = eupnea.evaluate(trained["controller"], pips=[20], breaths=1)
    assert result["mean"]["learned"]["score"] > 0 and result["gains"] == {"p": 6.5, "i": 265.0, "d": 0.13}


def test_a_bench_stands_for_its_description():
    bench = eupnea.Bench.from_toml('name = "mine"\n[valve]\nlag_ms = 40.0')
    slow = eupnea.evaluate(bench=bench, gains=(3, 30), pips=[20], breaths=1)
    usual = eupnea.evaluate(bench="R20C20", gains=(3, 30), pips=[20], breaths=1)
    assert slow["mean"]["pid"]["score"] != usual["mean"]["pid"]["score"]


def test_a_mapping_is_names_with_values():
    usual, other = (eupnea.evaluate(pips=[20], breaths=1, settings=settings) for settings in (None, {"peep": 8, "rate": 15}))
    assert usual["mean"]["pid"]["score"] != other["mean"]["pid"]["score"]
    with pytest.raises(ValueError, match="there is no setting peeep"):
        eupnea.evaluate(settings={"peeep": 8})


def test_bound_judge_and_robust_return_their_json(recording):
    assert eupnea.bound(pips=[20])["lungs"][0]["mean"]["score"] > 0.3
    assert eupnea.judge(recording)["pass"]
    assert not eupnea.judge(recording, overshoot=0.0)["pass"]
    robust = eupnea.robust("adult", plants=3, subset=0, breaths=1)
    assert robust["plants"] == 3


def test_any_command_with_json_can_be_run():
    result = run("margins", bench="R20C20", gains=(3, 30))
    assert result["seed"] == 1


def test_wrong_options_files_and_failures_are_exceptions_of_the_right_type(tmp_path):
    with pytest.raises(ValueError, match="choose from"):
        eupnea.evaluate(gain=1)
    with pytest.raises(ValueError, match="'much'"):
        eupnea.evaluate(gains="much")
    with pytest.raises(ValueError, match="no command"):
        run("nonsense")
    with pytest.raises(FileNotFoundError):
        eupnea.evaluate(tmp_path / "nowhere.bin")
    with pytest.raises(FileNotFoundError, match="nowhere"):
        eupnea.Recording(tmp_path / "nowhere.parquet")
    (tmp_path / "foreign.parquet").write_bytes(b"PAR1 is not enough PAR1")
    with pytest.raises(ValueError, match="not a recording"):
        eupnea.Recording(tmp_path / "foreign.parquet")
    with pytest.raises((RuntimeError, ValueError)):
        eupnea.fit(tmp_path / "foreign.parquet")


def test_progress_is_heard():
    heard = []
    eupnea.robust("adult", plants=40, subset=0, breaths=2, progress=lambda *event: heard.append(event))
    stages = {stage for stage, _, _ in heard}
    assert stages and all(0 <= done <= total for _, done, total in heard)


#: Some seconds of breaths.
BREATHS = 3000


@pytest.fixture
def interruptible():
    """A test run in the background ignores Ctrl-C, and Python leaves it so."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def test_ctrl_c_stops_a_command_and_keeps_its_results(tmp_path, interruptible):
    out = tmp_path / "recording.parquet"
    begun = []

    def interrupt(stage, done, total):
        if done > 2 and not begun:
            begun.append(time.monotonic())
            threading.Timer(0.0, os.kill, (os.getpid(), signal.SIGINT)).start()

    with pytest.raises(KeyboardInterrupt):
        eupnea.collect(out=out, breaths=BREATHS, progress=interrupt)
    assert begun and time.monotonic() - begun[0] < 60
    assert 0 < len(set(eupnea.Recording(out)["breath"])) < BREATHS
    # The next command is not stopped.
    assert eupnea.evaluate(gains=(3, 30), pips=[20], breaths=1)["mean"]["pid"]["score"] > 0


def test_commands_run_side_by_side_and_one_stops_without_the_other(tmp_path):
    class EnoughError(Exception):
        pass

    begun, evaluated = threading.Event(), threading.Event()

    def stop_after_the_other(stage, done, total):
        begun.set()
        if evaluated.is_set():
            raise EnoughError

    def collect():
        with pytest.raises(EnoughError):
            eupnea.collect(out=tmp_path / "stopped.parquet", breaths=20 * BREATHS, progress=stop_after_the_other)

    alone = [eupnea.evaluate(gains=(3, 30), pips=[pip], breaths=1) for pip in (15, 20)]
    with ThreadPoolExecutor() as pool:
        stopped = pool.submit(collect)
        assert begun.wait(60)
        together = [pool.submit(eupnea.evaluate, gains=(3, 30), pips=[pip], breaths=1) for pip in (15, 20)]
        assert [result.result() for result in together] == alone
        assert not stopped.done()
        evaluated.set()
        stopped.result()
    assert alone[0] != alone[1]


def test_an_exception_of_the_progress_stops_the_command():
    def fail(stage, done, total):
        raise LookupError(stage)

    with pytest.raises(LookupError):
        eupnea.robust("adult", plants=100_000, subset=0, breaths=2, progress=fail)


def test_the_documentation_has_the_help_of_the_command_line():
    assert "--breaths-of-learning" in eupnea.evaluate.__doc__
    assert "--check" in eupnea.export.__doc__
