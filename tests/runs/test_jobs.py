import os
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from offairl_lite.runs import jobs
from offairl_lite.runs.jobs import execute

STEPS = 40

# What a job of these tests runs in the place of the worker: it writes the same files, ten steps at
# a time, goes on where it was, and gets into trouble as it is told.
WORK = """
import json, os, signal, sys, time
from pathlib import Path

folder, trouble = Path(sys.argv[1]), sys.argv[2]
curve, attempts = folder / "curve.csv", folder / "attempts"
def note(state):
    (folder / "part").write_text(json.dumps({"state": state, "step": step}))
    (folder / "part").replace(folder / "run.json")

with open(attempts, "a") as file:
    file.write(f"{os.getpid()} {os.environ['OMP_NUM_THREADS']} {time.monotonic()}\\n")
first = len(attempts.read_text().splitlines()) == 1
if not curve.exists():
    curve.write_text("seed,step,mean_return\\n")
step = max([0, *(int(line.split(",")[1]) for line in curve.read_text().splitlines()[1:])])
print("from step", step, flush=True)
while step < 40:
    step += 10
    with open(curve, "a") as file:
        file.writelines(f"{seed},{step},{-step / 10 - seed}\\n" for seed in (0, 3))
    if step == 20 and trouble == "slow":
        try:
            note("running")
            time.sleep(60)
        except KeyboardInterrupt:
            sys.exit("stopped")
    if step >= 20 and (trouble == "broken" or trouble == "hiccup" and first):
        print("out of luck")
        sys.exit(3)
    if step == 20 and trouble == "killed" and first:
        os.kill(os.getpid(), signal.SIGKILL)
    note("running")
    time.sleep(0.02)
with open(attempts, "a") as file:
    file.write(f"end {time.monotonic()}\\n")
note("finished")
"""


@pytest.fixture
def prepare(tmp_path, monkeypatch):
    """Make run folders, and have them worked on by the script."""
    script = tmp_path / "work.py"
    script.write_text(WORK)

    def make(**troubles):
        for name in troubles:
            (tmp_path / name).mkdir()
            (tmp_path / name / "run.json").write_text('{"state": "waiting", "step": 0}')
            about = f'{{"seeds": [0, 3], "config": {{"total_steps": {STEPS}}}}}'
            (tmp_path / name / "config.json").write_text(about)

        def command(folder):
            return [sys.executable, str(script), str(folder), troubles[folder.name]]

        monkeypatch.setattr(jobs, "command", command)
        return [tmp_path / name for name in troubles]

    return make


@pytest.fixture(scope="module")
def cluster():
    """A Ray of two cores on this machine."""
    ray = pytest.importorskip("ray", reason="Ray is not installed")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("RAY_USAGE_STATS_ENABLED", "0")
        ray.init("local", num_cpus=2, include_dashboard=False, log_to_driver=False)
        yield
        ray.shutdown()


@pytest.fixture(params=["processes", "ray"])
def engine(request, monkeypatch):
    monkeypatch.setattr(jobs, "POLL_S", 0.02)
    if request.param == "ray":
        request.getfixturevalue("cluster")
    return request.param


def attempts(folder):
    """Process id of each attempt."""
    lines = (folder / "attempts").read_text().splitlines()
    return [int(line.split()[0]) for line in lines if not line.startswith("end")]


def curve(folder):
    return (folder / "curve.csv").read_text()


def lives(pid):
    if sys.platform == "linux":  # It may lack `ps`.
        try:
            return Path(f"/proc/{pid}/stat").read_text().rsplit(")")[1].split()[0] != "Z"
        except FileNotFoundError:
            return False
    command = ["ps", "-o", "stat=", "-p", str(pid)]
    state = subprocess.run(command, capture_output=True, text=True).stdout
    return bool(state.strip()) and not state.startswith("Z")


def wait_for(condition, seconds=60):
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.05)


def test_a_job_trains_one_run_folder_on_the_task_that_it_is_told(tmp_path):
    (tmp_path / "config.json").write_text('{"config": {"env_id": "my_robot:Arm-v0"}}')
    told = ["-m", "offairl_lite.runs.folders", str(tmp_path), "my_robot:Arm-v0"]
    assert jobs.command(tmp_path)[1:] == told


def test_all_is_done(engine, prepare, capsys):
    todo = prepare(one="", two="", three="")
    assert execute(todo, engine, 2) == []
    err = capsys.readouterr().err
    assert "120/120" in err
    assert "3 done, 0 failed" in err
    assert all((folder / "attempts").read_text().split()[1] == "1" for folder in todo)


def test_a_log_file_has_a_line_for_each_change_and_not_for_each_glance(
    prepare, capsys, monkeypatch
):
    monkeypatch.setattr(jobs, "POLL_S", 0.001)
    todo = prepare(one="")
    assert execute(todo, "processes", 1) == []
    # The bar, one job running, four steps of its curve (each may draw twice), done, and closed.
    assert capsys.readouterr().err.count("\r") <= 12


def test_a_failure_is_tried_once_more_then_reported(engine, prepare, capsys):
    todo = prepare(fine="", hiccup="hiccup", broken="broken")
    (failure,) = execute(todo, engine, 2)
    assert failure.startswith(f"{todo[2]}: exit status 3\n{jobs.log_of(todo[2])}:\n")
    assert failure.endswith("from step 20\nout of luck")
    assert [len(attempts(folder)) for folder in todo] == [1, 2, 2]
    # From where it was.
    assert "from step 20" in jobs.log_of(todo[1]).read_text()
    assert curve(todo[0]) == curve(todo[1])
    err = capsys.readouterr().err
    assert "hiccup: exit status 3; it is tried once more" in err
    assert "2 done, 1 failed" in err


def test_a_job_that_is_killed_is_gone_on_with(engine, prepare, capsys):
    todo = prepare(killed="killed", fine="")
    assert execute(todo, engine, 2) == []
    assert "killed by SIGKILL (out of memory?)" in capsys.readouterr().err
    assert [len(attempts(folder)) for folder in todo] == [2, 1]
    assert curve(todo[0]) == curve(todo[1])


@pytest.mark.parametrize("workers", [1, 2])
def test_no_more_work_at_a_time_than_allowed(engine, workers, prepare):
    todo = prepare(a="", b="", c="", d="")
    assert execute(todo, engine, workers) == []
    events = []
    for folder in todo:
        start, end = (folder / "attempts").read_text().splitlines()
        events += [(float(start.split()[-1]), 1), (float(end.split()[-1]), -1)]
    running = peak = 0
    for _, change in sorted(events):
        running += change
        peak = max(peak, running)
    assert peak <= workers


def test_both_engines_leave_the_same_folders(cluster, prepare, tmp_path, monkeypatch):
    monkeypatch.setattr(jobs, "POLL_S", 0.02)
    todo = prepare(processes="hiccup", ray="hiccup")
    for folder in todo:
        assert execute([folder], folder.name) == []
    found = [
        {
            path.relative_to(folder): path.read_text()
            for path in folder.rglob("*")
            if path.is_file() and path.name != "attempts"
        }
        for folder in todo
    ]
    logs = [files.pop(Path("checkpoint/log.txt")).splitlines() for files in found]
    assert found[0] == found[1]
    assert next([line for line in log if line[0] != "#"] for log in logs) == [
        *("from step 0", "out of luck", "from step 20")
    ]
    assert len(logs[0]) == len(logs[1])


def test_a_folder_that_a_node_does_not_see_ends_it_all(engine, prepare, monkeypatch):
    todo = prepare(slow="slow")
    slow = jobs.command(todo[0])
    monkeypatch.setattr(jobs, "command", lambda _: slow)
    lost = todo[0].with_name("elsewhere")
    with pytest.raises(ValueError, match=r"does not see .*elsewhere: put runs on a file system"):
        execute([*todo, lost], engine, 2)
    if (todo[0] / "attempts").exists():
        assert not any(map(lives, attempts(todo[0])))


@pytest.mark.parametrize("engine", ["processes", "ray"])
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupt_leaves_nobody_behind(number, engine, prepare, tmp_path):
    if engine == "ray":
        pytest.importorskip("ray", reason="Ray is not installed")
    todo = prepare(slow="slow", alike="slow", later="")
    main = tmp_path / "main.py"
    main.write_text(
        "from pathlib import Path\n"
        "from offairl_lite.runs import jobs\n"
        f"commands = {[(str(folder), jobs.command(folder)) for folder in todo]!r}\n"
        "jobs.command = lambda folder: dict(commands)[str(folder)]\n"
        f"jobs.execute([Path(folder) for folder, _ in commands], {engine!r}, 2)\n"
    )
    with open(tmp_path / "said", "w") as said:
        process = subprocess.Popen([sys.executable, str(main)], stderr=said)
    try:
        wait_for(
            lambda: all(jobs._from(folder / "run.json").get("step") == 20 for folder in todo[:2])
        )
        pids = [pid for folder in todo[:2] for pid in attempts(folder)]
        assert all(map(lives, pids))
        process.send_signal(number)
        assert process.wait(30) != 0
    finally:
        process.kill()
        process.wait()
    assert "KeyboardInterrupt" in (tmp_path / "said").read_text()
    wait_for(lambda: not any(map(lives, pids)), 5)
    assert all(jobs.log_of(path).read_text().endswith("stopped\n") for path in todo[:2])
    assert not (todo[2] / "attempts").exists()


def test_a_process_that_does_not_want_to_end_is_killed(prepare, monkeypatch):
    monkeypatch.setattr(jobs, "GRACE_S", 0.2)
    todo = prepare(deaf="")
    deaf = "import signal, time; signal.signal(2, signal.SIG_IGN); print(1, flush=True); "
    command, stop = [sys.executable, "-c", deaf + "time.sleep(60)"], threading.Event()
    with ThreadPoolExecutor() as pool:
        outcome = pool.submit(jobs._child, todo[0], command, stop)
        log = jobs.log_of(todo[0])
        wait_for(lambda: log.exists() and log.read_text().endswith("1\n"))
        stop.set()
        assert outcome.result().startswith("killed by SIGKILL")


def test_as_many_at_a_time_as_there_are_cores():
    assert 1 <= jobs.cores() <= os.cpu_count()


def test_an_address_is_a_ray_clusters():
    with pytest.raises(ValueError, match="address 'auto' is a Ray cluster's: give the engine ray"):
        execute([], address="auto")


def test_without_ray_it_is_said_how_to_get_it(prepare, monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    todo = prepare(one="")
    with pytest.raises(ValueError, match=r"Ray is not installed: pip install -e '\.\[ray\]"):
        execute(todo, "ray")
